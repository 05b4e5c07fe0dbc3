"""Gauss-Newton's model of a run: all factors linearised at one trajectory.

The information of the run is an arrowhead matrix (:mod:`estimator.slam.smoothing.arrowhead`): the chain
are the agent's states, coupled by the motion (39); the border is what stands still.
The border's coordinates ``y`` leave out what is known: the state vector is ``base + basis y``
(:meth:`estimator.slam.smoothing.factors.Problem.basis`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotate_by_angle_of, rotation_matrix
from estimator.slam.models.directions import predict_azimuths
from estimator.slam.models.motion import process_noise, transition
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import AGENT, THETA
from estimator.slam.models.sweeps import predict_flashes
from estimator.slam.smoothing.arrowhead import Arrowhead
from estimator.slam.smoothing.factors import Problem, Trajectory

__all__ = ["Linear", "Past", "linearise"]

Array = NDArray[np.float64]

_AGENT = 4
_JITTER = 1e-6  # m^2: makes the driving noise, of rank 2 of 4, invertible; far below any measurement


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

    rows, epoch, residual = _measured(problem, at)
    moving, standing = rows[:, AGENT], rows @ basis
    np.add.at(chain, epoch, moving[:, :, None] * moving[:, None, :])
    np.add.at(border, epoch, moving[:, :, None] * standing[:, None, :])
    np.add.at(right, epoch, moving * residual[:, None])
    corner += standing.T @ standing
    below += standing.T @ residual
    cost += float(residual @ residual)

    for step in np.unique(np.diff(problem.time_s)):
        before = np.flatnonzero(np.diff(problem.time_s) == step)
        move = transition(float(step))
        noise = process_noise(float(step), problem.config.motion.acceleration_variance)
        drive = np.linalg.inv(noise + _JITTER * np.eye(_AGENT))
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
            [np.full(2, 1.0 / _JITTER), np.full(2, problem.config.motion.velocity_std_m_s**-2)]
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
    for k in range(layout.anchors):
        away[layout.height2(k)] = still[layout.height2(k)] - problem.config.noise.height2_mean_m2
        away[layout.bias(k)] = still[layout.bias(k)]
    return np.asarray(basis.T @ away / np.sum(basis**2, axis=0))


def _measured(problem: Problem, at: Trajectory) -> tuple[Array, NDArray[np.int64], Array]:
    """Whitened derivatives (m, n), epochs (m,) and residuals (m,) of paths and sweeps."""
    layout, paths = problem.layout, problem.paths
    states = at.states()
    pick = (paths.epoch, paths.anchor, paths.feature)
    lengths = predict_paths(states, layout)
    weight = 1.0 / paths.std_m
    rows = [lengths.jacobian[pick] * weight[:, None]]
    residuals, epochs = [(paths.length_m - lengths.length_m[pick]) * weight], [paths.epoch]
    if paths.azimuth_rad is not None and paths.azimuth_std_rad is not None:
        azimuth, jacobian = predict_azimuths(states, layout)
        weight = 1.0 / paths.azimuth_std_rad
        gap = np.angle(np.exp(1j * (paths.azimuth_rad - problem.bearing_rad - azimuth[pick])))
        rows.append(jacobian[pick] * weight[:, None])
        residuals.append(gap * weight)
        epochs.append(paths.epoch)
    turn = rotation_matrix(-problem.bearing_rad)
    for sweep in problem.sweeps:
        flash, jacobian = predict_flashes(states[sweep.epoch], layout)
        whiten = np.linalg.inv(np.linalg.cholesky(turn @ sweep.flash.covariance_m2 @ turn.T))
        rows.append(whiten @ jacobian[sweep.slot])
        residuals.append(whiten @ (turn @ sweep.flash.mean_m - flash[sweep.slot]))
        epochs.append(np.full(2, sweep.epoch))
    return np.concatenate(rows), np.concatenate(epochs), np.concatenate(residuals)


def _sensed(problem: Problem, still: Array) -> tuple[Array, Array]:
    """Whitened derivatives (m, n) and residuals (m,) of the walls sensed at the start."""
    layout = problem.layout
    rows, residuals = [np.zeros((0, layout.size))], [np.zeros(0)]
    for slot, wall in enumerate(problem.sensed):
        if wall is None:
            continue
        whiten = np.linalg.inv(np.linalg.cholesky(wall.covariance_m2))
        expected, jacobian = rotate_by_angle_of(still, THETA, (layout.wall(slot),), problem.bearing_rad)
        rows.append(whiten @ jacobian)
        residuals.append(whiten @ (wall.mean_m - expected))
    return np.concatenate(rows), np.concatenate(residuals)
