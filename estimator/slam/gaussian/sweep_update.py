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
from estimator.slam.models.hypotheses import Hypotheses
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
    heading_scale_m : float
        Distances between flashes and walls that a common heading explains, beside their noise, metres.
    """

    flash_gate_sigma: float = positive(4.0)
    unlike_gates: float = positive(1.5)
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
def _match(
    layout: Layout,
    mean: Array,
    covariance: Array,
    present: NDArray[np.bool_],
    seen: Array,
    noise: Array,
    gate_sigma: float,
) -> tuple[Index, Array]:
    """The slot (J,) of the wall that each flash comes from, -1 for none; how far off (J,) the nearest one is.

    That is a squared distance in standard deviations, of all known walls.
    """
    flashes, slots = seen.shape[0], layout.slots
    cost = np.full((flashes, slots), np.inf)
    index, value = np.empty(5, dtype=np.int64), np.empty((2, 5))
    first, second = np.empty(mean.size), np.empty(mean.size)
    for i in range(slots):
        if not present[i]:
            continue
        x, y = flash_of(layout, mean, i, index, value)
        xx = projected(covariance, index, value[0], 5, first)
        yy = projected(covariance, index, value[1], 5, second)
        xy = 0.0
        for e in range(5):
            xy += value[1, e] * first[index[e]]
        for j in range(flashes):
            a, b, c = xx + noise[j, 0, 0], xy + noise[j, 0, 1], yy + noise[j, 1, 1]
            dx, dy = seen[j, 0] - x, seen[j, 1] - y
            cost[j, i] = (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / (a * c - b * b)
    nearest = np.full(flashes, np.inf)
    for j in range(flashes):
        for i in range(slots):
            nearest[j] = min(nearest[j], cost[j, i])
    slot = np.full(flashes, -1)
    for _ in range(flashes):
        least, at, wall = gate_sigma**2, -1, -1
        for j in range(flashes):
            for i in range(slots):
                if cost[j, i] < least:
                    least, at, wall = cost[j, i], j, i
        if at < 0:
            break
        slot[at] = wall
        cost[at, :] = np.inf
        cost[:, wall] = np.inf
    return slot, nearest


@compiled
def _take(
    layout: Layout, mean: Array, covariance: Array, seen: Array, noise: Array, slot: Index, held: bool
) -> float:
    """Correct a Gaussian, in place, by the flashes whose wall is known; their log density.

    All are linearised at one state; the unknown heading is one more state, forgotten afterwards.
    """
    n, flashes = mean.size, seen.shape[0]
    wide_mean, wide = np.zeros(n + 1), np.zeros((n + 1, n + 1))
    wide_mean[:n], wide[:n, :n] = mean, covariance
    if not held:
        wide[n, n] = _ANY_HEADING_RAD2
    index, value = np.empty(6, dtype=np.int64), np.empty((2, 6))
    white, cross = np.empty(6), np.empty(n + 1)
    log_density = 0.0
    for j in range(flashes):
        if slot[j] < 0:
            continue
        x, y = flash_of(layout, mean, slot[j], index[:5], value[:, :5])
        index[5], value[0, 5], value[1, 5] = n, -y, x
        entries = 5 if held else 6
        root = np.sqrt(noise[j, 0, 0])  # Cholesky factor of the noise, whitened coordinates
        low = noise[j, 0, 1] / root
        rest = np.sqrt(noise[j, 1, 1] - low * low)
        gap_x, gap_y = seen[j, 0] - x, seen[j, 1] - y
        for part in range(2):
            for e in range(entries):
                if part == 0:
                    white[e] = value[0, e] / root
                else:
                    white[e] = (value[1, e] - low * value[0, e] / root) / rest
            gap = gap_x / root if part == 0 else (gap_y - low * gap_x / root) / rest
            moved = 0.0
            for e in range(entries):
                before = mean[index[e]] if index[e] < n else 0.0
                moved += white[e] * (wide_mean[index[e]] - before)
            log_density += scalar_update(wide_mean, wide, index, white, entries, gap - moved, 1.0, cross)
    mean[:], covariance[:, :] = wide_mean[:n], wide[:n, :n]
    return log_density


@compiled
def _update(
    layout: Layout,
    hypotheses: Hypotheses,
    seen: Array,
    noise: Array,
    held: bool,
    gate_sigma: float,
    scale_m: float,
    most_turn_rad: float,
) -> Array:
    """Correct all hypotheses in place; how far off the nearest wall of the first is for each flash."""
    nearest = np.empty(seen.shape[0])
    back, spread = np.empty(seen.shape), np.empty(noise.shape)
    for r in range(hypotheses.log_weight.size):
        mean, covariance = hypotheses.mean[r], hypotheses.covariance[r]
        turn = 0.0
        if not held:
            turn = _heading(layout, mean, hypotheses.present[r], seen, noise, scale_m)
        c, s = np.cos(turn), np.sin(turn)
        for j in range(seen.shape[0]):
            back[j, 0] = c * seen[j, 0] + s * seen[j, 1]
            back[j, 1] = c * seen[j, 1] - s * seen[j, 0]
            xx, xy, yy = noise[j, 0, 0], noise[j, 0, 1], noise[j, 1, 1]
            spread[j, 0, 0] = c * c * xx + 2.0 * c * s * xy + s * s * yy
            spread[j, 1, 1] = s * s * xx - 2.0 * c * s * xy + c * c * yy
            spread[j, 0, 1] = c * s * (yy - xx) + (c * c - s * s) * xy
            spread[j, 1, 0] = spread[j, 0, 1]
        slot, off = _match(layout, mean, covariance, hypotheses.present[r], back, spread, gate_sigma)
        if r == 0:
            nearest[:] = off
        before = mean.copy()
        hypotheses.log_weight[r] += _take(layout, mean, covariance, back, spread, slot, held)
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
        State with hypotheses corrected by the epoch's paths.
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
    order = np.argsort(-state.hypotheses.log_weight, kind="stable")
    corrected = state.hypotheses.take(order)
    nearest = _update(
        state.layout,
        corrected,
        seen,
        noise,
        heading_held,
        model.flash_gate_sigma,
        model.heading_scale_m,
        most_turn_rad,
    )
    state = state.but(hypotheses=corrected)
    if heading_held:
        for j in np.flatnonzero(nearest > (model.unlike_gates * model.flash_gate_sigma) ** 2).tolist():
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
