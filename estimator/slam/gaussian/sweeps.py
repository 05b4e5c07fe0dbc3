"""Beam sweeps on the way: walls seen from where the agent is.

A flash gives the agent's own mirror image relative to the agent, ``M_v(p) - p``, in the
agent's axes. With the heading held it tells the rotation of the map again; with
the heading unknown one angle per sweep is integrated out and the distances to the
walls and the angles between them remain. A wall seen for the first time enters all
hypotheses and waits for its confirmation as every new wall does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.kalman import kalman
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.gaussian.turning import turned
from estimator.slam.layout import Layout

__all__ = ["predict_flashes", "take_sweep"]

Array = NDArray[np.float64]
_ANY_HEADING_RAD = 2.0 * np.pi / np.sqrt(12.0)
_UNLIKE = (
    1.5  # times the gate: a flash nearer to a known wall is that wall's, though a bad one, and no new wall
)
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])


def predict_flashes(mean: Array, layout: Layout) -> tuple[Array, Array]:
    """The agent's mirror image in every wall, relative to the agent.

    Parameters
    ----------
    mean : ndarray, shape (n,)
        A state vector.
    layout : Layout
        Positions in it.

    Returns
    -------
    flash : ndarray, shape (L, 2)
        Turned by ``theta``, so that the axes are the expected gauge frame's.
    jacobian : ndarray, shape (L, 2, n)
        Derivatives by the state vector.
    """
    agent, wall = mean[:2], mean[layout.walls].reshape(-1, 2)
    square = np.sum(wall * wall, axis=1)
    scale = wall @ agent / square
    turn = rotation_matrix(float(mean[layout.THETA]))
    flash = ((1.0 - 2.0 * scale)[:, None] * wall) @ turn.T
    jacobian = np.zeros((len(wall), 2, layout.size))
    for slot in range(layout.slots):
        v, q = wall[slot], square[slot]
        jacobian[slot, :, :2] = turn @ (-2.0 / q * np.outer(v, v))
        by_wall = (1.0 - 2.0 * scale[slot]) * np.eye(2) - 2.0 / q * np.outer(v, agent - 2.0 * scale[slot] * v)
        jacobian[slot][:, layout.wall(slot)] = turn @ by_wall
        jacobian[slot, :, layout.THETA] = _QUARTER @ flash[slot]
    return flash, jacobian


def take_sweep(
    state: GaussianState, sweep: Sequence[GaussianVrp], heading_held: bool, config: GaussianConfig
) -> GaussianState:
    """Take the walls of a sweep into all rows.

    Parameters
    ----------
    state : GaussianState
        State with rows corrected by the epoch's paths.
    sweep : sequence of GaussianVrp
        The agent's mirror images relative to the agent, in its axes.
    heading_held : bool
        Whether these axes are those of the start.
    config : GaussianConfig
        ``gate_sigma``.

    Returns
    -------
    GaussianState
    """
    if not sweep:
        return state
    to_gauge = rotation_matrix(-state.bearing_rad)
    seen = np.array([wall.mean_m for wall in sweep]) @ to_gauge.T
    noise = np.array([to_gauge @ wall.covariance_m2 @ to_gauge.T for wall in sweep])
    rows = state.rows.take(np.arange(len(state.rows)))
    new = np.zeros(len(sweep), dtype=bool)
    for r in range(len(rows)):
        heading = 0.0 if heading_held else _heading(state, r, seen, noise)
        back = rotation_matrix(-heading)
        here, spread = seen @ back.T, back @ noise @ back.T
        slot, nearest = _match(state, r, here, spread, config)
        if r == state.rows.best:
            new = nearest > (_UNLIKE * config.gate_sigma) ** 2
        mean, covariance, log_density = _update(state, r, here, spread, slot, heading_held)
        rows.mean[r], rows.covariance[r] = mean, covariance
        rows.log_weight[r] += log_density
    mean, covariance = turned(state.rows.mean, rows.mean, rows.covariance, rows.located, state.layout)
    state = state.but(rows=rows.but(mean=mean, covariance=covariance))
    if heading_held:
        for j in np.flatnonzero(new):
            state = _enter(state, seen[j], noise[j])
    return state


def _present(state: GaussianState, row: int) -> NDArray[np.int64]:
    return np.flatnonzero(state.rows.present[row])


def _match(
    state: GaussianState, row: int, seen: Array, noise: Array, config: GaussianConfig
) -> tuple[NDArray[np.int64], Array]:
    """The slot (J,) of the wall that each flash comes from, -1 for none; how far off (J,) the nearest one is.

    That is a squared distance in standard deviations, of all known walls.
    """
    layout, slots = state.layout, _present(state, row)
    flash, jacobian = predict_flashes(state.rows.mean[row], layout)
    result = np.full(len(seen), -1)
    cost = np.full((len(seen), len(slots)), np.inf)
    for i, slot in enumerate(slots):
        spread = jacobian[slot] @ state.rows.covariance[row] @ jacobian[slot].T
        for j in range(len(seen)):
            gap = seen[j] - flash[slot]
            cost[j, i] = gap @ np.linalg.solve(spread + noise[j], gap)
    nearest = cost.min(axis=1, initial=np.inf)
    while cost.size and cost.min() < config.gate_sigma**2:
        j, i = (int(n) for n in np.unravel_index(int(np.argmin(cost)), cost.shape))
        result[j] = slots[i]
        cost[j, :], cost[:, i] = np.inf, np.inf
    return result, nearest


def _heading(state: GaussianState, row: int, seen: Array, noise: Array) -> float:
    """The turn of the agent's axes that fits a sweep best: each pairing proposes, distances vote."""
    flash, _ = predict_flashes(state.rows.mean[row], state.layout)
    known = flash[_present(state, row)]
    best, best_score = 0.0, np.inf
    for a in seen:
        for b in known:
            turn = float(np.arctan2(a[1], a[0]) - np.arctan2(b[1], b[0]))
            back = seen @ rotation_matrix(-turn).T
            gap = np.linalg.norm(back[:, None, :] - known[None], axis=-1).min(axis=1)
            scale = np.sqrt(0.5 * np.trace(noise, axis1=1, axis2=2)) + 0.5
            score = float(np.sum(np.minimum((gap / scale) ** 2, 16.0)))
            if score < best_score:
                best, best_score = turn, score
    return float(np.angle(np.exp(1j * best)))


def _update(
    state: GaussianState, row: int, seen: Array, noise: Array, slot: NDArray[np.int64], held: bool
) -> tuple[Array, Array, float]:
    """One row corrected by the flashes whose wall is known; and their log density."""
    mean, covariance = state.rows.mean[row], state.rows.covariance[row]
    used = np.flatnonzero(slot >= 0)
    if used.size == 0:
        return mean, covariance, 0.0
    flash, jacobian = predict_flashes(mean, state.layout)
    h, gap, shared = [], [], []
    for j in used:
        whiten = np.linalg.inv(np.linalg.cholesky(noise[j]))
        h.append(whiten @ jacobian[slot[j]])
        gap.append(whiten @ (seen[j] - flash[slot[j]]))
        shared.append(whiten @ _QUARTER @ flash[slot[j]] * (0.0 if held else _ANY_HEADING_RAD))
    size = 2 * used.size
    new_mean, new_covariance, log_density = kalman(
        mean[None],
        covariance[None],
        np.concatenate(h)[None],
        np.concatenate(gap)[None],
        np.ones((1, size)),
        np.concatenate(shared)[None],
    )
    return new_mean[0], new_covariance[0], float(log_density[0])


def _enter(state: GaussianState, seen: Array, noise: Array) -> GaussianState:
    """Give all rows the wall whose flash no known wall explains."""
    state, slot = open_slot(state)
    layout, columns = state.layout, state.layout.wall(slot)
    rows = state.rows.take(np.arange(len(state.rows)))
    for r in range(len(rows)):
        mean, covariance = rows.mean[r], rows.covariance[r]
        turn = rotation_matrix(-float(mean[layout.THETA]))
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
        linear[:, layout.THETA] = by_flash @ (-_QUARTER @ gauge)
        spread = by_flash @ turn @ noise @ turn.T @ by_flash.T
        mean[columns] = scale * gauge
        covariance[columns, :] = linear @ covariance
        covariance[:, columns] = covariance[columns, :].T
        covariance[columns, columns] = linear @ covariance @ linear.T + spread
        rows.present[r, slot] = True
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot] = state.next_wall_id, state.epoch
    return state.but(rows=rows, slots=slots, next_wall_id=state.next_wall_id + 1)
