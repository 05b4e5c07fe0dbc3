"""Fig. 10: the distribution of estimated VRPs beside what Theorem 2 and Corollary 1 claim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.evaluation.picture_style import AGENT, ANCHOR, DASHES, STYLE, WALL, tidy
from estimator.experiments.catalogue import Entry, Request
from estimator.experiments.ranging import PAPER_GRID
from estimator.experiments.report import Report, Row, figure_text
from estimator.sensing.linefit import fit_lines
from estimator.sensing.ranges import EchoLaw, variance_published
from estimator.sensing.uncertainty import average_pairs

__all__ = ["reproduce"]

Array = NDArray[np.float64]

_AZIMUTH_RAD = np.deg2rad([0.0, -30.0, 30.0])  # of the three RSPs; 0 is the wall's normal
_BATCH = 1000


@dataclass(frozen=True)
class _Wall:
    """A wall at a distance, and the law by which the SNR falls from 0 dB at 10 m."""

    distance_m: float
    exponent: float

    @property
    def name(self) -> str:
        return f"{self.distance_m:g} m, d^-{self.exponent:g}"

    @property
    def ranges_m(self) -> Array:
        """True distances of the RSPs."""
        return np.asarray(self.distance_m / np.cos(_AZIMUTH_RAD))

    @property
    def stds_m(self) -> Array:
        """Their standard deviations by Theorem 1, cross section ``cos^(2 eta)`` with eta = 0.2."""
        law = EchoLaw(snr=1.0, reference_m=10.0, exponent=self.exponent, eta=0.2)
        return np.sqrt(variance_published(PAPER_GRID, law.at(self.ranges_m, _AZIMUTH_RAD)))


_WALLS = (_Wall(50.0, 2.0), _Wall(1000.0, 2.0), _Wall(50.0, 4.0))


@dataclass(frozen=True)
class _Batch:
    wall: _Wall
    seeds: range


def reproduce(name: str, entry: Entry, request: Request) -> Report:
    """Estimate every wall from noisy ranges in all runs, as published and by maximum likelihood."""
    runs = request.runs or entry.runs
    last = request.seed + runs
    tasks = [
        _Batch(wall, range(first, min(first + _BATCH, last)))
        for wall in _WALLS
        for first in range(request.seed, last, _BATCH)
    ]
    parts = request.map(_estimates, tasks)
    per_wall = len(parts) // len(_WALLS)
    summary: dict[str, Any] = {}
    rows: list[Row] = []
    estimates: dict[str, Array] = {}
    for number, wall in enumerate(_WALLS):
        found = np.concatenate(parts[number * per_wall : (number + 1) * per_wall], axis=1)
        estimates[wall.name] = found
        summary[wall.name] = numbers = _describe(wall, found)
        rows += _rows(wall, numbers)
    return Report(
        name,
        entry.title,
        summary,
        {
            key: {"published_m": found[0].tolist(), "likeliest_m": found[1].tolist()}
            for key, found in estimates.items()
        },
        rows,
        _picture(estimates, summary),
        (
            "Ranges are Gaussian with (16); RSPs at 0 and +-30 degrees from the wall's normal (x axis).",
            "The paper's law (7), d^-4, would leave a range error of 1.7 km on a wall 1 km away; its figure "
            "needs d^-2, with which the first two walls are computed.",
            "(26) is diagonal where x and y of an RSP share one range error, and counts RSP 1 as if each "
            "pair had one of its own; `full` propagates the range errors through the same estimate.",
        ),
        {"runs": runs, "seed": request.seed},
    )


def _estimates(batch: _Batch) -> Array:
    """VRPs (2, runs, 2): averaged pairs (25), and the likeliest lines."""
    wall = batch.wall
    noise = np.array([np.random.default_rng(seed).normal(size=_AZIMUTH_RAD.size) for seed in batch.seeds])
    ranges = np.maximum(wall.ranges_m + wall.stds_m * noise, 1e-3 * wall.distance_m)
    published, _ = average_pairs(ranges, wall.stds_m, _AZIMUTH_RAD)
    return np.stack([published, fit_lines(ranges, wall.stds_m, _AZIMUTH_RAD).mean_m])


def _describe(wall: _Wall, found: Array) -> dict[str, Any]:
    """Means, standard deviations (x, y) and claims; the claims are at the true ranges."""
    arguments = (wall.ranges_m, wall.stds_m, _AZIMUTH_RAD)
    mean, published = average_pairs(*arguments, covariance="published")
    full = average_pairs(*arguments, covariance="full")[1]
    bound = fit_lines(*arguments).covariance_m2
    runs = found.shape[1]
    share = 1.0 / np.sqrt(2.0 * max(runs - 1, 1))
    spread = found.std(axis=1, ddof=1) if runs > 1 else np.full((2, 2), np.nan)
    numbers: dict[str, Any] = {
        "runs": runs,
        "range_std_m": wall.stds_m.tolist(),
        "vrp_m": mean.tolist(),
        "mean_published_m": found[0].mean(axis=0).tolist(),
        "mean_likeliest_m": found[1].mean(axis=0).tolist(),
        "std_claimed_m": np.sqrt(np.diag(published)).tolist(),
        "std_full_m": np.sqrt(np.diag(full)).tolist(),
        "std_bound_m": np.sqrt(np.diag(bound)).tolist(),
    }
    if runs > 1:
        numbers |= {
            "std_published_m": spread[0].tolist(),
            "std_published_m_se": (share * spread[0]).tolist(),
            "std_likeliest_m": spread[1].tolist(),
            "std_likeliest_m_se": (share * spread[1]).tolist(),
        }
    return numbers


def _rows(wall: _Wall, numbers: dict[str, Any]) -> list[Row]:
    rows = [Row(f"wall at {wall.name}", "")]
    nothing = [None, None]
    for axis, letter in enumerate("xy"):
        bound = figure_text(numbers["std_bound_m"][axis], digits=2)
        actual, error = (numbers.get(f"std_published_m{end}", nothing)[axis] for end in ("", "_se"))
        likeliest, error_ = (numbers.get(f"std_likeliest_m{end}", nothing)[axis] for end in ("", "_se"))
        rows += [
            Row(
                f"  mean {letter} (true {numbers['vrp_m'][axis]:.0f}), m",
                figure_text(numbers["mean_published_m"][axis], digits=2),
            ),
            Row(
                f"  deviation {letter}, claimed by (26), m",
                figure_text(numbers["std_claimed_m"][axis], digits=2),
            ),
            Row(
                f"  deviation {letter}, full covariance, m",
                figure_text(numbers["std_full_m"][axis], digits=2),
            ),
            Row(
                f"  deviation {letter}, actual of (25), m", figure_text(actual, error, 2), "as claimed", bound
            ),
            Row(f"  deviation {letter}, likeliest line, m", figure_text(likeliest, error_, 2), "", bound),
        ]
    return rows


def _picture(estimates: dict[str, Array], summary: dict[str, Any]) -> Figure:
    """A column for each wall, x above y: histograms of both estimators, and what is claimed."""
    from scipy.stats import norm

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 5.4), dpi=150, facecolor="white", layout="constrained")
        for column, (key, found) in zip(figure.subplots(2, len(estimates)).T, estimates.items(), strict=True):
            numbers = summary[key]
            for axis, axes in enumerate(column):
                centre, claimed = numbers["vrp_m"][axis], numbers["std_claimed_m"][axis]
                x = np.linspace(-4.0, 4.0, 401) * max(claimed, numbers["std_full_m"][axis]) + centre
                for values, colour, label in (
                    (found[0], AGENT, "averaged pairs, (25)"),
                    (found[1], WALL, "likeliest line"),
                ):
                    edges = np.linspace(x[0], x[-1], 61)
                    counts = np.histogram(values[:, axis], edges)[0]
                    density = counts / (len(values) * np.diff(edges))
                    axes.stairs(density, edges, fill=True, color=colour, alpha=0.3, label=label)
                axes.plot(x, norm.pdf(x, centre, claimed), color=ANCHOR, label="claimed by (26)")
                full = norm.pdf(x, centre, numbers["std_full_m"][axis])
                axes.plot(x, full, color=ANCHOR, linestyle=DASHES, label="full covariance")
                axes.set(xlabel=f"{'xy'[axis]} of the VRP, m", yticks=[])
                tidy(axes)
            column[0].set(title=f"wall at {key}")
        figure.axes[0].legend(frameon=False, loc="upper left", fontsize=7.0)
        figure.draw_without_rendering()
    return figure
