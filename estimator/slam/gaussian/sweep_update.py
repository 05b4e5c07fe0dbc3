"""Beam sweeps on the way: flashes are matched to walls, correct the hypotheses, and show new walls.

A wall seen for the first time enters all hypotheses and waits for its confirmation as every new wall does.
Time is that of the hypotheses times flashes times walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam.gaussian.polar_correction import correct_along_circles
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.directions import wrapped
from estimator.slam.models.hypotheses import Hypotheses, log_sum_exp
from estimator.slam.models.kalman import projected, scalar_update
from estimator.slam.models.settings import Settings, positive
from estimator.slam.models.state_vector import THETA, Layout
from estimator.slam.models.sweeps import flash_of
from estimator.slam.models.visibility import Visibility

__all__ = ["SweepMatching", "take_sweep"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_ANY_HEADING_RAD2 = (2.0 * np.pi) ** 2 / 12.0  # variance of an angle of which nothing is known
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class SweepMatching(Settings):
    """How flashes and walls are matched.

    Parameters
    ----------
    flash_gate_sigma : float
        A flash farther from every wall than this many standard deviations is none of theirs.
    unlike_gates : float
        A flash nearer to a known wall than so many gates is that wall's, though a bad one, and no new wall.
    new_flash_density : float
        Density of flashes of walls not yet known, per metre of range and radian of bearing: half a flash a
        sweep, anywhere within 20 m.
    heading_scale_m : float
        Distances between flashes and walls that a common heading explains, beside their noise, metres.
    """

    flash_gate_sigma: float = positive(4.0)
    unlike_gates: float = positive(1.5)
    new_flash_density: float = positive(0.5 / (20.0 * 2.0 * np.pi))
    heading_scale_m: float = positive(0.5)


@compiled
def _heading(
    layout: Layout, mean: Array, present: NDArray[np.bool_], seen: Array, noise: Array, scale_m: float
) -> float:
    """The turn of the agent's axes that fits a sweep best: each pairing proposes, distances vote."""
    index, value = np.empty(5, dtype=np.int64), np.empty((2, 5))
    flash = np.empty((layout.slots, 2))
    for i in range(layout.slots):
        x, y = flash_of(layout, mean, i, index, value)
        flash[i, 0], flash[i, 1] = x, y
    best, least = 0.0, np.inf
    for a in range(seen.shape[0]):
        for b in range(layout.slots):
            if not present[b]:
                continue
            turn = np.arctan2(seen[a, 1], seen[a, 0]) - np.arctan2(flash[b, 1], flash[b, 0])
            c, s = np.cos(turn), np.sin(turn)
            score = 0.0
            for j in range(seen.shape[0]):
                x, y = c * seen[j, 0] + s * seen[j, 1], c * seen[j, 1] - s * seen[j, 0]
                nearest = np.inf
                for i in range(layout.slots):
                    if present[i]:
                        nearest = min(nearest, np.hypot(x - flash[i, 0], y - flash[i, 1]))
                scale = np.sqrt(0.5 * (noise[j, 0, 0] + noise[j, 1, 1])) + scale_m
                score += min((nearest / scale) ** 2, 16.0)
            if score < least:
                best, least = turn, score
    return wrapped(best)


@compiled
def _cost(
    layout: Layout,
    mean: Array,
    covariance: Array,
    slot: int,
    x: float,
    y: float,
    noise: Array,
    index: Index,
    value: Array,
    first: Array,
    second: Array,
) -> tuple[float, float]:
    """Squared distance of a flash from a wall in standard deviations, and its negative log density."""
    fx, fy = flash_of(layout, mean, slot, index, value)
    xx = projected(covariance, index, value[0], 5, first)
    yy = projected(covariance, index, value[1], 5, second)
    xy = 0.0
    for e in range(5):
        xy += value[1, e] * first[index[e]]
    a, b, c = xx + noise[0, 0], xy + noise[0, 1], yy + noise[1, 1]
    dx, dy = x - fx, y - fy
    determinant = a * c - b * b
    square = (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / determinant
    return square, 0.5 * (square + np.log(determinant)) + np.log(2.0 * np.pi)


@compiled
def _take(
    layout: Layout,
    mean: Array,
    covariance: Array,
    slot: int,
    x: float,
    y: float,
    noise: Array,
    heading_variance: float,
) -> float:
    """Correct a Gaussian, whose last state is the heading, in place by one flash; its log density."""
    n = mean.size - 1
    index, value = np.empty(6, dtype=np.int64), np.empty((2, 6))
    fx, fy = flash_of(layout, mean, slot, index[:5], value[:, :5])
    index[5], value[0, 5], value[1, 5] = n, -fy, fx
    entries = 6 if heading_variance > 0.0 else 5
    fx, fy = fx - mean[n] * fy, fy + mean[n] * fx
    root = np.sqrt(noise[0, 0])  # Cholesky factor of the noise: whitened coordinates
    low = noise[0, 1] / root
    rest = np.sqrt(noise[1, 1] - low * low)
    white, cross = np.empty((2, 6)), np.empty(n + 1)
    for e in range(6):
        white[0, e] = value[0, e] / root
        white[1, e] = (value[1, e] - low * value[0, e] / root) / rest
    gap = (x - fx) / root
    other = (y - fy - low * (x - fx) / root) / rest
    log_density = -np.log(root * rest)
    before = np.empty(6)
    for e in range(entries):
        before[e] = mean[index[e]]
    log_density += scalar_update(mean, covariance, index, white[0], entries, gap, 1.0, cross)
    for e in range(entries):
        other -= white[1, e] * (mean[index[e]] - before[e])
    return float(log_density) + scalar_update(mean, covariance, index, white[1], entries, other, 1.0, cross)


@compiled
def _match(
    layout: Layout,
    mean: Array,
    covariance: Array,
    present: NDArray[np.bool_],
    seen: Array,
    noise: Array,
    heading_variance: float,
    gate_sigma: float,
    new_density: float,
    slot: Index,
    nearest: Array,
) -> float:
    """Match flashes with walls, the best pair first, each taken at once; the log density of all.

    What a flash tells of the agent makes the next pair surer. A flash is matched where that is likelier than
    a new wall.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean, covariance : ndarray, shapes (n + 1,) and (n + 1, n + 1)
        The Gaussian, the unknown heading last; corrected in place.
    present : ndarray of bool, shape (L,)
        Walls that there are.
    seen, noise : ndarray, shapes (J, 2) and (J, 2, 2)
        Flashes and their covariances.
    heading_variance : float
        Of the heading; 0 where it is held.
    gate_sigma, new_density : float
        Gate, and density of flashes of walls not yet known, per metre of range and radian.
    slot : ndarray of int64, shape (J,)
        Takes the wall of each flash, -1 for none.
    nearest : ndarray, shape (J,)
        Takes how far off the nearest wall is after all corrections: a squared distance.
    """
    flashes, slots = seen.shape[0], layout.slots
    index, value = np.empty(5, dtype=np.int64), np.empty((2, 5))
    first, second = np.empty(mean.size), np.empty(mean.size)
    slot[:] = -1
    used = np.zeros(slots, dtype=np.bool_)
    total = 0.0
    for _ in range(flashes):
        best, flash, wall = np.inf, -1, -1
        for j in range(flashes):
            if slot[j] >= 0:
                continue
            reach = max(np.hypot(seen[j, 0], seen[j, 1]), 1e-3)
            none = -np.log(new_density / reach)
            for i in range(slots):
                if not present[i] or used[i]:
                    continue
                square, cost = _cost(
                    layout, mean, covariance, i, seen[j, 0], seen[j, 1], noise[j], index, value, first, second
                )
                if square < gate_sigma**2 and cost < none and cost - none < best:
                    best, flash, wall = cost - none, j, i
        if flash < 0:
            break
        slot[flash] = wall
        used[wall] = True
        total += _take(
            layout, mean, covariance, wall, seen[flash, 0], seen[flash, 1], noise[flash], heading_variance
        )
    for j in range(flashes):
        nearest[j] = 0.0
        if slot[j] >= 0:
            continue
        nearest[j] = np.inf
        total += np.log(new_density / max(np.hypot(seen[j, 0], seen[j, 1]), 1e-3))
        for i in range(slots):
            if present[i]:
                square, _ = _cost(
                    layout, mean, covariance, i, seen[j, 0], seen[j, 1], noise[j], index, value, first, second
                )
                nearest[j] = min(nearest[j], square)
    return total


@compiled
def _update(
    layout: Layout,
    hypotheses: Hypotheses,
    seen: Array,
    noise: Array,
    held: bool,
    gate_sigma: float,
    new_density: float,
    scale_m: float,
    most_turn_rad: float,
) -> Array:
    """Correct all hypotheses in place; how far off (R, J) the nearest wall of each is for each flash."""
    count, flashes = hypotheses.log_weight.size, seen.shape[0]
    nearest = np.empty((count, flashes))
    back, spread = np.empty(seen.shape), np.empty(noise.shape)
    slot = np.empty(flashes, dtype=np.int64)
    n = hypotheses.mean.shape[1]
    for r in range(count):
        mean, covariance = hypotheses.mean[r], hypotheses.covariance[r]
        turn = 0.0
        if not held:
            turn = _heading(layout, mean, hypotheses.present[r], seen, noise, scale_m)
        c, s = np.cos(turn), np.sin(turn)
        for j in range(flashes):
            back[j, 0] = c * seen[j, 0] + s * seen[j, 1]
            back[j, 1] = c * seen[j, 1] - s * seen[j, 0]
            xx, xy, yy = noise[j, 0, 0], noise[j, 0, 1], noise[j, 1, 1]
            spread[j, 0, 0] = c * c * xx + 2.0 * c * s * xy + s * s * yy
            spread[j, 1, 1] = s * s * xx - 2.0 * c * s * xy + c * c * yy
            spread[j, 0, 1] = c * s * (yy - xx) + (c * c - s * s) * xy
            spread[j, 1, 0] = spread[j, 0, 1]
        wide_mean, wide = np.zeros(n + 1), np.zeros((n + 1, n + 1))
        wide_mean[:n] = mean
        wide[:n, :n] = covariance
        heading_variance = 0.0 if held else _ANY_HEADING_RAD2
        wide[n, n] = heading_variance
        hypotheses.log_weight[r] += _match(
            layout,
            wide_mean,
            wide,
            hypotheses.present[r],
            back,
            spread,
            heading_variance,
            gate_sigma,
            new_density,
            slot,
            nearest[r],
        )
        before = mean.copy()
        mean[:] = wide_mean[:n]
        covariance[:, :] = wide[:n, :n]
        for j in range(flashes):
            if slot[j] >= 0:
                hypotheses.support[r, slot[j]] += 1
        if most_turn_rad > 0.0:
            correct_along_circles(layout, before, mean, covariance, hypotheses.located[r], most_turn_rad)
    return nearest


def take_sweep(
    state: GaussianState,
    sweep: Sequence[GaussianVrp],
    heading_held: bool,
    model: SweepMatching,
    most_turn_rad: float,
    visibility: Visibility,
) -> GaussianState:
    """Take the flashes of a sweep into all hypotheses.

    Parameters
    ----------
    state : GaussianState
        State with predicted hypotheses.
    sweep : sequence of GaussianVrp
        The agent's mirror images relative to the agent, in its axes.
    heading_held : bool
        Whether these axes are those of the start.
    model : SweepMatching
        Gates.
    most_turn_rad : float
        As in :class:`estimator.slam.gaussian.update.UpdateModel`.
    visibility : Visibility
        Prior visibility of new walls.

    Returns
    -------
    GaussianState
    """
    if not sweep:
        return state
    to_gauge = rotation_matrix(-state.bearing_rad)
    seen = np.array([wall.mean_m for wall in sweep]) @ to_gauge.T
    noise = np.array([to_gauge @ wall.covariance_m2 @ to_gauge.T for wall in sweep])
    corrected = state.hypotheses.take(np.arange(state.hypotheses.number))
    nearest = _update(
        state.layout,
        corrected,
        seen,
        noise,
        heading_held,
        model.flash_gate_sigma,
        model.new_flash_density,
        model.heading_scale_m,
        most_turn_rad,
    )
    best = nearest[corrected.best]
    evidence = log_sum_exp(corrected.log_weight)
    corrected.log_weight[...] -= evidence
    state = state.but(hypotheses=corrected, log_evidence=state.log_evidence + evidence)
    if heading_held:
        for j in np.flatnonzero(best > (model.unlike_gates * model.flash_gate_sigma) ** 2).tolist():
            state = _enter(state, seen[j], noise[j], visibility)
    return state


def _enter(state: GaussianState, seen: Array, noise: Array, visibility: Visibility) -> GaussianState:
    """Give all hypotheses the wall whose flash no known wall explains."""
    state, slot = open_slot(state, visibility)
    layout, columns = state.layout, state.layout.wall(slot)
    new = state.hypotheses.take(np.arange(state.hypotheses.number))
    for r in range(new.number):
        mean, covariance = new.mean[r], new.covariance[r]
        turn = rotation_matrix(-float(mean[THETA]))
        gauge, agent = turn @ seen, mean[:2]
        # v = (1 + 2 p.m / |m|^2) m stands where p's image relative to p is m
        square = gauge @ gauge
        scale = 1.0 + 2.0 * (agent @ gauge) / square
        by_agent = 2.0 / square * np.outer(gauge, gauge)
        by_flash = scale * np.eye(2) + 2.0 / square * np.outer(
            gauge, agent - 2.0 * (agent @ gauge) / square * gauge
        )
        linear = np.zeros((2, layout.size))
        linear[:, :2] = by_agent
        linear[:, THETA] = by_flash @ (-_QUARTER @ gauge)
        spread = by_flash @ turn @ noise @ turn.T @ by_flash.T
        mean[columns] = scale * gauge
        covariance[columns, :] = linear @ covariance
        covariance[:, columns] = covariance[columns, :].T
        covariance[columns, columns] = linear @ covariance @ linear.T + spread
        new.present[r, slot] = True
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot] = state.next_wall_id, state.epoch
    return state.but(hypotheses=new, slots=slots, next_wall_id=state.next_wall_id + 1)
