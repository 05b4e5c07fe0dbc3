"""The data card: a page that tells people what a dataset is, how it was made, and how good it is.

It says no more than the manifest does: neither where walls and anchors are nor the track.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from raytrace.dataset.croissant import card_head

__all__ = ["CARD", "data_card"]

CARD = "CARD.md"

_CONTENT = {
    "cfr": "frequency responses (`cfr_re`, `cfr_im`)",
    "cir": "impulse responses (`cir_re`, `cir_im`)",
    "both": "frequency and impulse responses (`cfr_re`, `cfr_im`, `cir_re`, `cir_im`)",
}


def data_card(manifest: Mapping[str, Any], shards: Sequence[Mapping[str, Any]]) -> str:
    """The card as Markdown.

    Parameters
    ----------
    manifest : mapping
        What the manifest says, its ``statistics`` included.
    shards : sequence of mapping
        Its entries.
    """
    radio, echo, output = manifest["radio"], manifest["echo"], manifest["output"]
    passive, returns = manifest["statistics"]["passive"], manifest["statistics"]["echo"]
    sweeps = any(entry["kind"] == "echo" for entry in shards)
    rows = {
        "scene": f"{manifest['scene']['name']}, SHA-256 `{manifest['scene']['sha256']}`",
        "epochs": f"{manifest['epochs']}, in shards of at most {output['shard_epochs']}",
        "anchors": ", ".join(manifest["anchors"]),
        "size": f"{sum(entry['bytes'] for entry in shards) / 1e6:.1f} MB in {len(shards)} files",
        "seed": str(manifest["seed"]),
        "versions": ", ".join(f"{name} {version}" for name, version in manifest["versions"].items()),
        "licence": output["licence"] or "not stated by its maker",
    }
    files = [
        ("`passive-*.nc`", f"noisy channels from every anchor: {_CONTENT[output['content']]}"),
        *([("`echo-*.nc`", f"noisy sweeps of {echo['beams']['beams']} beams")] if sweeps else []),
        ("`paths-*.nc`", "the specular paths behind them, without noise"),
        ("`truth.nc`", "floor plan, anchors, track: to evaluate with, not to estimate from"),
        ("`manifest.json`", "configuration, and size and SHA-256 of every file"),
    ]
    signals = [("passive", radio, f"{radio['eirp_dbm']:g} dBm EIRP")]
    if sweeps:
        signals.append(("echo", echo, f"{echo['tx_power_dbm']:g} dBm, {echo['model']}"))
    counts = [("passive", passive), *([("echo", returns)] if "expected" in returns else [])]
    snr = passive["los_snr_db_median"]
    return "\n".join(
        [
            *card_head(manifest),
            "",
            f"# {manifest['name']}",
            "",
            "Ray-traced radio channels between fixed anchors and a moving agent, and echoes that the agent",
            "hears of its own beams, made by hapslam for simultaneous localisation and mapping.",
            "",
            *_table(("", ""), rows.items()),
            "",
            "## Files",
            "",
            *_table(("file", "holds"), files),
            "",
            "netCDF-4; complex numbers are pairs `_re`, `_im`; every variable has CF `units`. Angles and",
            f"positions that an estimator sees: {manifest['frame']}.",
            "",
            "## Signals",
            "",
            *_table(
                ("link", "carrier", "bandwidth", "tones", "symbols", "power", "noise variance per tone"),
                [
                    (
                        name,
                        f"{link['carrier_hz'] / 1e9:g} GHz",
                        f"{link['subcarriers'] * link['subcarrier_spacing_hz'] / 1e6:.4g} MHz",
                        str(link["subcarriers"] // link["comb"]),
                        str(link["symbols"]),
                        power,
                        f"{link['noise_variance']:.4g}",
                    )
                    for name, link, power in signals
                ],
            ),
            "",
            "## Completeness",
            "",
            f"Specular paths of up to {manifest['tracing']['depth']} bounces were compared, path by path,",
            "with an independent image method; `hapslam verify` repeats that on the files.",
            "",
            *_table(
                ("link", "expected", "found", "missing", "extra", "diffuse"),
                [
                    (name, *(str(c[key]) for key in ("expected", "found", "missing", "extra", "diffuse")))
                    for name, c in counts
                ],
            ),
            "",
            *_unchecked(passive),
            "Median SNR of the line of sight over all tones: "
            + ("none" if snr is None else f"{snr:g} dB")
            + ".",
            "",
        ]
    )


def _unchecked(passive: Mapping[str, Any]) -> list[str]:
    """What is told of paths that the image method does not know."""
    if "refracted" not in passive:
        return []
    return [
        f"Besides, {passive['refracted']} paths through walls and {passive['diffracted']} around corners",
        f"were found. Of the {passive.get('bent_once', 0)} that bend once,"
        f" {passive.get('bent_once_missing', 0)} are missing;",
        "of the others nothing tells whether there are more.",
        "",
    ]


def _table(head: Sequence[str], rows: Any) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines]
