"""Fig. 8: RMSE of the distance over the SNR beside its bound."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.evaluation.picture_style import AGENT, DASHES, MUTED, STYLE, logarithmic, tidy
from estimator.experiments.catalogue import Entry, Request
from estimator.experiments.ranging import PAPER_GRID, range_errors
from estimator.experiments.report import Report, Row, figure_text
from estimator.experiments.summary import rms_of
from estimator.sensing.ranges import variance_honest

__all__ = ["reproduce"]

Array = NDArray[np.float64]

_DISTANCE_M = 20.0
_SNR_DB = tuple(float(snr) for snr in range(-16, 22, 2))
_EFFICIENT = 1.05  # of the bound
_SHOWN_DB = (-12.0, -10.0, -8.0, 0.0, 10.0, 20.0)


def reproduce(name: str, entry: Entry, request: Request) -> Report:
    """Estimate a distance of 20 m in all runs at every SNR."""
    runs = request.runs or entry.runs
    errors = range_errors(request, _DISTANCE_M, _SNR_DB, runs)
    bound = np.sqrt(variance_honest(PAPER_GRID, 10.0 ** (0.1 * np.array(_SNR_DB))))
    points = [rms_of(row) for row in errors]
    rmse = np.array([value if value is not None else np.inf for value, _ in points])
    threshold = _threshold(rmse / bound)
    summary: dict[str, Any] = {
        "runs": runs,
        "snr_db": list(_SNR_DB),
        "rmse_m": [value for value, _ in points],
        "rmse_m_se": [error for _, error in points],
        "not_found": [int(np.sum(np.isnan(row))) for row in errors],
        "bound_m": bound.tolist(),
        "efficient_from_db": threshold,
    }
    rows = [
        Row(f"RMSE at {snr:g} dB, m", figure_text(*points[i], digits=4), "", f"{bound[i]:.4f}")
        for i, snr in enumerate(_SNR_DB)
        if snr in _SHOWN_DB
    ]
    rows.append(Row("RMSE <= 1.05 bound from, dB", "-" if threshold is None else f"{threshold:g}", "0"))
    return Report(
        name,
        entry.title,
        summary,
        {},
        rows,
        _picture(points, bound),
        (
            "The bound is that of an unknown complex gain: (16) over 1 - 1/N^2.",
            "SNR is that of one subcarrier; run i has the same noise at every SNR.",
        ),
        {"runs": runs, "seed": request.seed, "distance_m": _DISTANCE_M},
    )


def _threshold(ratio: Array) -> float | None:
    """Lowest SNR from which on the RMSE is at most 1.05 times the bound."""
    bad = np.flatnonzero(~(ratio <= _EFFICIENT))
    first = 0 if bad.size == 0 else int(bad[-1]) + 1
    return _SNR_DB[first] if first < len(_SNR_DB) else None


def _picture(points: list[tuple[float | None, float | None]], bound: Array) -> Figure:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.4), dpi=150, facecolor="white", layout="constrained")
        axes = figure.subplots()
        rmse = [np.nan if value is None else value for value, _ in points]
        bars = [0.0 if error is None else 2.0 * error for _, error in points]
        style: dict[str, Any] = {"color": AGENT, "marker": "o", "markersize": 3.5, "linewidth": 1.4}
        axes.errorbar(_SNR_DB, rmse, bars, label="NOMP (bars: 2 standard errors)", **style)
        axes.plot(_SNR_DB, bound, color=MUTED, linestyle=DASHES, label="bound, (16)")
        axes.set(xlabel="SNR per subcarrier, dB", ylabel="RMSE of the distance, m")
        logarithmic(axes)
        tidy(axes)
        axes.legend(frameon=False)
        figure.draw_without_rendering()
    return figure
