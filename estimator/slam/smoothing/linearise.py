"""Gauss-Newton's model of a run: all factors linearised at one trajectory.

The information of the run is an arrowhead matrix (:mod:`estimator.slam.smoothing.arrowhead`): the chain
are the agent's states, coupled by the motion (39); the border is what stands still.
The border's coordinates ``y`` leave out what is known: the state vector is ``base + basis y``
(:meth:`estimator.slam.smoothing.factors.Problem.basis`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotate_by_angle_of, rotation_matrix
from estimator.slam.models.state_vector import AGENT, ECHO_BIAS, THETA
from estimator.slam.models.sweeps import own_covariance, predict_flashes
from estimator.slam.smoothing.arrowhead import Arrowhead
from estimator.slam.smoothing.factors import Problem, Trajectory, column_of
from estimator.slam.smoothing.measured_paths import add_paths

__all__ = ["JITTER_M2", "Linear", "Past", "linearise"]

Array = NDArray[np.float64]

_AGENT = 4
JITTER_M2 = 1e-6
"""Makes the driving noise, of rank 2 of 4, invertible, square metres; far below any measurement."""


@dataclass(frozen=True, eq=False)
class Past:
    """What eliminated epochs say about the first agent state kept and about what stands still.

    Parameters
    ----------
    information : ndarray, shape (4 + q, 4 + q)
        Information matrix.
    gradient : ndarray, shape (4 + q,)
        Its product with the best step away from ``at``.
    at : Trajectory
        Where that was linearised; of the agent only the first state counts.
    """

    information: Array
    gradient: Array
    at: Trajectory


@dataclass(frozen=True, eq=False)
class Linear:
    """Gauss-Newton's model of the cost: ``cost - 2 g'd + d'Md``.

    Parameters
    ----------
    matrix : Arrowhead
        ``M``.
    chain, border : ndarray, shapes (T, 4) and (q,)
        ``g``.
    cost : float
        Sum of squared whitened residuals.
    """

    matrix: Arrowhead
    chain: Array
    border: Array
    cost: float


def linearise(problem: Problem, at: Trajectory, past: Past | None = None) -> Linear:
    """Linearise all factors at a trajectory.

    Parameters
    ----------
    problem : Problem
        The factors.
    at : Trajectory
        Where.
    past : Past, optional
        What came before; in its place stand, without it, the priors of the start.

    Returns
    -------
    Linear
    """
    basis, prior = problem.basis()
    epochs, size = len(problem.time_s), basis.shape[1]
    chain, link = np.zeros((epochs, _AGENT, _AGENT)), np.zeros((max(epochs - 1, 0), _AGENT, _AGENT))
    border, corner = np.zeros((epochs, _AGENT, size)), np.zeros((size, size))
    right, below = np.zeros((epochs, _AGENT)), np.zeros(size)
    cost = 0.0

    paths = problem.paths
    cost += add_paths(
        problem.layout,
        at.agent,
        at.still,
        column_of(basis),
        paths.epoch,
        paths.anchor,
        paths.feature,
        paths.length_m,
        paths.std_m,
        paths.azimuth_rad - problem.bearing_rad,
        paths.azimuth_std_rad,
        chain,
        border,
        corner,
        right,
        below,
    )
    for t, rows, residual in _flashes(problem, at):
        moving, standing = rows[:, AGENT], rows @ basis
        chain[t] += moving.T @ moving
        border[t] += moving.T @ standing
        corner += standing.T @ standing
        right[t] += moving.T @ residual
        below += standing.T @ residual
        cost += float(residual @ residual)

    for step in np.unique(np.diff(problem.time_s)):
        before = np.flatnonzero(np.diff(problem.time_s) == step)
        driving = problem.config.motion.driving(float(step))
        move, noise = driving.transition, driving.covariance
        drive = np.linalg.inv(noise + JITTER_M2 * np.eye(_AGENT))
        gap = at.agent[before + 1] - at.agent[before] @ move.T
        chain[before] += move.T @ drive @ move
        chain[before + 1] += drive
        link[before] -= move.T @ drive
        right[before] += gap @ drive @ move
        right[before + 1] -= gap @ drive
        cost += float(np.sum((gap @ drive) * gap))

    if past is not None:
        step = np.concatenate([at.agent[0] - past.at.agent[0], basis.T @ (at.still - past.at.still)])
        step[_AGENT:] /= np.sum(basis**2, axis=0)
        pull = past.gradient - past.information @ step
        cost += float(step @ (past.information @ step - 2.0 * past.gradient))
        chain[0] += past.information[:_AGENT, :_AGENT]
        border[0] += past.information[:_AGENT, _AGENT:]
        corner += past.information[_AGENT:, _AGENT:]
        right[0] += pull[:_AGENT]
        below += pull[_AGENT:]
    else:
        start = np.concatenate(
            [np.full(2, 1.0 / JITTER_M2), np.full(2, problem.config.motion.velocity_std_m_s**-2)]
        )
        chain[0] += np.diag(start)
        right[0] -= start * at.agent[0]
        cost += float(np.sum(start * at.agent[0] ** 2))
        rows, residual = _sensed(problem, at.still)
        standing = rows @ basis
        away = _from_prior(problem, at.still, basis)
        corner += standing.T @ standing + np.diag(prior)
        below += standing.T @ residual - prior * away
        cost += float(residual @ residual + np.sum(prior * away**2))
    return Linear(Arrowhead(chain, link, border, corner), right, below, cost)


def _from_prior(problem: Problem, still: Array, basis: Array) -> Array:
    """How far heights and biases (q,) are from their prior means; 0 for the rest."""
    layout = problem.layout
    away = np.zeros_like(still)
    away[ECHO_BIAS] = still[ECHO_BIAS]
    for k in range(layout.anchors):
        away[layout.height2(k)] = still[layout.height2(k)] - problem.height2_of(k)[0]
        away[layout.bias(k)] = still[layout.bias(k)]
    return np.asarray(basis.T @ away / np.sum(basis**2, axis=0))


def _flashes(problem: Problem, at: Trajectory) -> Iterator[tuple[int, Array, Array]]:
    """Epochs, whitened derivatives (2, n) and residuals (2,) of the walls that sweeps saw."""
    turn = rotation_matrix(-problem.bearing_rad)
    for sweep in problem.sweeps:
        state = at.still.copy()
        state[AGENT] = at.agent[sweep.epoch]
        flash, jacobian = predict_flashes(state, problem.layout)
        own = own_covariance(sweep.flash, problem.config.sweeps.echo_bias_std_m)
        whiten = np.linalg.inv(np.linalg.cholesky(turn @ own @ turn.T))
        gap = turn @ sweep.flash.mean_m - flash[sweep.slot]
        yield sweep.epoch, whiten @ jacobian[sweep.slot], whiten @ gap


def _sensed(problem: Problem, still: Array) -> tuple[Array, Array]:
    """Whitened derivatives (m, n) and residuals (m,) of the walls sensed at the start."""
    layout = problem.layout
    rows, residuals = [np.zeros((0, layout.size))], [np.zeros(0)]
    for slot, wall in enumerate(problem.sensed):
        if wall is None:
            continue
        whiten = np.linalg.inv(
            np.linalg.cholesky(own_covariance(wall, problem.config.sweeps.echo_bias_std_m))
        )
        expected, jacobian = rotate_by_angle_of(still, THETA, (layout.wall(slot),), problem.bearing_rad)
        along = 2.0 * expected / np.linalg.norm(expected)
        expected = expected + still[ECHO_BIAS] * along
        jacobian[:, ECHO_BIAS] += along
        rows.append(whiten @ jacobian)
        residuals.append(whiten @ (wall.mean_m - expected))
    return np.concatenate(rows), np.concatenate(residuals)
