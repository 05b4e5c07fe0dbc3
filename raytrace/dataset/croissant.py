"""What machines are told of a dataset: Croissant metadata (version 1.0), and the head of the data card.

``croissant.json`` lists every file with its size and SHA-256 (JSON-LD, as dataset search engines and
loaders of MLCommons read it). The card begins with the YAML that hubs of datasets ask for: copied
to ``README.md``, it is a page there. Neither says more than the manifest does.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["CROISSANT", "card_head", "croissant"]

CROISSANT = "croissant.json"

_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
}
_KINDS = {
    "passive": "noisy channels from every anchor",
    "echo": "noisy beam sweeps of the agent's own echo",
    "paths": "the paths behind the channels, without noise",
    "truth": "floor plan, anchors and track",
}
_TAGS = ("radio", "channel", "localization", "slam", "sensing", "ray-tracing", "ofdm")


def croissant(manifest: Mapping[str, Any], shards: Sequence[Mapping[str, Any]]) -> str:
    """Croissant metadata of a dataset, as JSON.

    Parameters
    ----------
    manifest : mapping
        What the manifest says.
    shards : sequence of mapping
        Its entries.
    """
    licence = manifest["output"]["licence"]
    files = [
        {
            "@type": "cr:FileObject",
            "@id": entry["file"],
            "name": entry["file"],
            "description": _KINDS.get(entry["kind"], entry["kind"]),
            "contentUrl": entry["file"],
            "contentSize": f"{entry['bytes']} B",
            "encodingFormat": "application/x-netcdf",
            "sha256": entry["sha256"],
        }
        for entry in shards
    ]
    facts = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": manifest["name"],
        "description": _description(manifest),
        **({"license": licence} if licence else {}),
        "keywords": list(_TAGS),
        "measurementTechnique": "ray tracing, checked path by path against the image method",
        "distribution": files,
    }
    return json.dumps(facts, indent=2) + "\n"


def card_head(manifest: Mapping[str, Any]) -> list[str]:
    """The YAML at the head of a card: licence, name and tags."""
    licence = manifest["output"]["licence"]
    known = licence.lower() if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.+-]*", licence) else "other"
    named = [f"license_name: {json.dumps(licence)}"] if known == "other" and licence else []
    return [
        "---",
        f"license: {known if licence else 'unknown'}",
        *named,
        f"pretty_name: {json.dumps(manifest['name'])}",
        "tags:",
        *(f"- {tag}" for tag in _TAGS),
        "---",
    ]


def _description(manifest: Mapping[str, Any]) -> str:
    radio = manifest["radio"]
    bandwidth = radio["subcarriers"] * radio["subcarrier_spacing_hz"] / 1e6
    return (
        f"Ray-traced radio channels between {len(manifest['anchors'])} fixed anchors and a moving agent at "
        f"{manifest['epochs']} epochs, {radio['carrier_hz'] / 1e9:g} GHz, {bandwidth:.4g} MHz, "
        "with the echoes of its own beams where it sweeps them, made by hapslam."
    )
