"""Fig. 9: how much Theorem 1 gives away, (16) beside the exact bound (15)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.evaluation.picture_style import AGENT, ANCHOR, DASHES, STYLE, WALL, logarithmic, tidy
from estimator.experiments.catalogue import Entry, Request
from estimator.experiments.ranging import PAPER_GRID
from estimator.experiments.report import Report, Row
from estimator.sensing.ranges import EchoLaw, variance_exact, variance_honest, variance_published

__all__ = ["reproduce"]

Array = NDArray[np.float64]

_WIDE = replace(PAPER_GRID, subcarriers=1000)
_DISTANCE_M, _SNR_DB = 10.0, 0.0


def reproduce(name: str, entry: Entry, request: Request) -> Report:
    """Compute the bounds over distance, subcarriers and SNR; nothing is random."""
    law = EchoLaw(snr=1.0, reference_m=_DISTANCE_M)
    distance = np.linspace(5.0, 50.0, 91)
    tones = np.arange(200, 1001, 50)
    snr_db = np.linspace(-10.0, 20.0, 61)
    grids = [replace(PAPER_GRID, subcarriers=int(count)) for count in tones]
    panels = {
        "distance_m": _sweep(distance, [(_WIDE, d, float(law.at(d))) for d in distance]),
        "subcarriers": _sweep(tones, [(grid, _DISTANCE_M, 1.0) for grid in grids]),
        "snr_db": _sweep(snr_db, [(_WIDE, _DISTANCE_M, float(10.0 ** (0.1 * s))) for s in snr_db]),
    }
    excess = {
        f"{count}": float(panels["subcarriers"]["published"][i] / panels["subcarriers"]["exact"][i] - 1.0)
        for i, count in enumerate(tones)
        if count in (200, 400, 1000)
    }
    rows = [
        Row(
            f"(16) over (15), {count} subcarriers, 10 m",
            f"+{share:.1%}",
            "" if count == "200" else "negligible",
        )
        for count, share in excess.items()
    ]
    summary: dict[str, Any] = {"published_over_exact": excess}
    return Report(
        name,
        entry.title,
        summary,
        {name_: {key: line.tolist() for key, line in lines.items()} for name_, lines in panels.items()},
        rows,
        _picture(panels),
        (
            "(15) takes the amplitude's dependence on the distance for known, which an unknown cross section "
            "forbids; that, not the number of subcarriers, is what (16) leaves out: 3 c^2 / (pi^2 d^2 B^2).",
            "The bound that holds for an unknown complex gain is (16) over 1 - 1/N^2.",
            "Over the distance: SNR 0 dB at 10 m, power falls as d^-4, (7).",
        ),
    )


def _sweep(at: NDArray[Any], points: list[tuple[Any, float, float]]) -> dict[str, Array]:
    """The three bounds, square metres, at (grid, distance, SNR)."""
    return {
        "at": np.asarray(at, dtype=np.float64),
        "exact": np.array([float(variance_exact(grid, d, snr)) for grid, d, snr in points]),
        "published": np.array([float(variance_published(grid, snr)) for grid, _, snr in points]),
        "unknown_gain": np.array([float(variance_honest(grid, snr)) for grid, _, snr in points]),
    }


def _picture(panels: dict[str, dict[str, Array]]) -> Figure:
    labels = {"distance_m": "distance, m", "subcarriers": "subcarriers", "snr_db": "SNR per subcarrier, dB"}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 3.6), dpi=150, facecolor="white", layout="constrained")
        for axes, (name, lines) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
            axes.plot(lines["at"], lines["exact"], color=AGENT, label="exact, (15)")
            axes.plot(
                lines["at"], lines["published"], color=ANCHOR, linestyle=DASHES, label="Theorem 1, (16)"
            )
            axes.plot(lines["at"], lines["unknown_gain"], color=WALL, linestyle=":", label="unknown gain")
            axes.set(xlabel=labels[name])
            logarithmic(axes)
            tidy(axes)
        figure.axes[0].set(ylabel="variance of the distance, m$^2$")
        figure.axes[0].legend(frameon=False)
        figure.draw_without_rendering()
    return figure
