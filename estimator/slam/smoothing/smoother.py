"""Gauss-Newton over a whole run: the likeliest trajectory, anchors and walls, with their covariances.

The factors of a run (:mod:`estimator.slam.smoothing.factors`) are linearised, the arrowhead system is
eliminated along the epochs, and Levenberg-Marquardt steps are taken until the cost falls no more. A
step costs as much as the epochs are many. The marginal covariances are those of the last
system; as everything is linearised at one and the same trajectory, and ``theta`` apart from all path lengths,
they are consistent. :func:`smooth_fixed_lag` keeps a window of epochs and eliminates what falls out of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import rotate_by_angle_of
from estimator.slam.models.settings import Settings, positive
from estimator.slam.models.state_vector import AGENT, THETA, Layout
from estimator.slam.smoothing.arrowhead import Marginals, eliminate
from estimator.slam.smoothing.factors import Problem, SweepFactor, Trajectory
from estimator.slam.smoothing.linearise import Linear, Past, linearise

__all__ = ["Descent", "Smoothed", "placed", "smooth", "smooth_fixed_lag"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Descent(Settings):
    """How Levenberg and Marquardt's steps are taken.

    Parameters
    ----------
    iterations : int
        Steps at most; those that are taken back count.
    converged : float
        Relative decrease of the cost below which the descent has ended.
    first_damping : float
        Share by which the diagonal is raised at first: small, for starts are near.
    damping_growth, damping_decay : float
        Factors of the damping after a step that is taken back, and after one that is kept.
    most_damping : float
        Damping at which no step lowers the cost any more.
    """

    iterations: int = positive(40)
    converged: float = positive(1e-6)
    first_damping: float = positive(1e-4)
    damping_growth: float = positive(10.0)
    damping_decay: float = positive(0.01)
    most_damping: float = positive(1e8)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A smoothed run, in the estimator's frame (RP at the origin).

    Parameters
    ----------
    agent_mean : ndarray, shape (T, 4)
        Agent positions and velocities.
    agent_covariance : ndarray, shape (T, 4, 4)
        Their covariances, the rotation about RP included.
    rotation_std_rad : ndarray, shape (T,)
        Standard deviation of the map's rotation.
    anchor_mean_m, anchor_covariance_m2 : ndarray, shapes (T, K, 2) and (T, K, 2, 2)
        Anchors; equal at all epochs but for a fixed lag.
    wall_mean_m, wall_covariance_m2 : ndarray, shapes (T, L, 2) and (T, L, 2, 2)
        VRPs, in the order of the problem's slots.
    cost : float
        Sum of squared whitened residuals at the end.
    trajectory : Trajectory
        The same in the gauge frame.
    marginals : Marginals
        Covariances of agent states and border in the gauge frame; for a fixed lag, of the last window.
    """

    agent_mean: Array
    agent_covariance: Array
    rotation_std_rad: Array
    anchor_mean_m: Array
    anchor_covariance_m2: Array
    wall_mean_m: Array
    wall_covariance_m2: Array
    cost: float
    trajectory: Trajectory
    marginals: Marginals


def smooth(problem: Problem, start: Trajectory) -> Smoothed:
    """Smooth a whole run.

    Parameters
    ----------
    problem : Problem
        The factors.
    start : Trajectory
        Where to start from, gauge frame: within the basin of the solution, a few metres.

    Returns
    -------
    Smoothed

    Raises
    ------
    InputError
        If the start does not fit the problem, or the factors do not determine everything.
    """
    _check(problem, start)
    trajectory, linear = descend(problem, start)
    marginals = eliminate(linear.matrix).marginals()
    epochs = range(len(trajectory.agent))
    places = [placed(problem, trajectory, marginals, t) for t in epochs]
    return _collect(problem.layout, places, linear.cost, trajectory, marginals)


def descend(
    problem: Problem, start: Trajectory, past: Past | None = None, descent: Descent | None = None
) -> tuple[Trajectory, Linear]:
    """Levenberg-Marquardt; the last trajectory and the problem linearised there."""
    basis, _ = problem.basis()
    descent = descent or Descent()
    at, damping = start, descent.first_damping
    linear = linearise(problem, at, past)
    for _ in range(descent.iterations):
        factor = eliminate(linear.matrix.damped(damping))
        trial_at = at.moved(*factor.solve(linear.chain, linear.border), basis)
        trial = linearise(problem, trial_at, past)
        if not trial.cost <= linear.cost:
            damping *= descent.damping_growth
            if damping > descent.most_damping:
                break
            continue
        done = linear.cost - trial.cost <= descent.converged * (1.0 + abs(linear.cost))
        at, linear, damping = trial_at, trial, max(descent.damping_decay * damping, 1e-12)
        if done:
            break
    return at, linear


def smooth_fixed_lag(problem: Problem, start: Trajectory, lag: int = 20, iterations: int = 3) -> Smoothed:
    """Smooth with a delay: epoch ``t`` from the measurements up to ``t + lag``.

    Each new epoch is predicted, the window is iterated, and the epoch that falls out of it is
    eliminated: what it says about the next agent state and about what stands still is kept,
    linearised where it was.

    Parameters
    ----------
    problem : Problem
        The factors.
    start : Trajectory
        Where to start from, gauge frame; of the agent only the first state counts.
    lag : int
        Epochs that the estimate is behind, 1 or more.
    iterations : int
        Steps at each new epoch.

    Returns
    -------
    Smoothed
        Row ``t`` of every array is what was known ``lag`` epochs later, or at the end.

    Raises
    ------
    ConfigurationError
        If ``lag`` or ``iterations`` is less than 1.
    InputError
        As :func:`smooth`.
    """
    if lag < 1 or iterations < 1:
        raise ConfigurationError(f"lag, iterations: expected at least 1, got {lag} and {iterations}")
    _check(problem, start)
    descent = Descent(iterations=iterations)
    basis, _ = problem.basis()
    last = len(problem.time_s) - 1
    window, past, first = Trajectory(start.agent[:1], start.still), None, 0
    places, agents = [], []
    for now in range(last + 1):
        if now:
            step = float(problem.time_s[now] - problem.time_s[now - 1])
            ahead = window.agent[-1] + step * np.concatenate([window.agent[-1, 2:], np.zeros(2)])
            window = replace(window, agent=np.vstack([window.agent, ahead]))
        part = _part(problem, first, now)
        window, linear = descend(part, window, past, descent)
        if now < last and now - first < lag:
            continue
        marginals = eliminate(linear.matrix).marginals()
        leaving = range(len(window.agent)) if now == last else range(1)
        for t in leaving:
            places.append(placed(problem, window, marginals, t))
            agents.append(window.agent[t])
        if now < last:
            past = _eliminate_first(part, window, past, basis)
            window, first = replace(window, agent=window.agent[1:]), first + 1
    trajectory = Trajectory(np.array(agents), window.still)
    return _collect(problem.layout, places, linear.cost, trajectory, marginals)


def _check(problem: Problem, start: Trajectory) -> None:
    shapes = (len(problem.time_s), 4), (problem.layout.size,)
    if (start.agent.shape, start.still.shape) != shapes:
        raise InputError(
            f"start: expected agent {shapes[0]} and still {shapes[1]}, got {start.agent.shape} "
            f"and {start.still.shape}"
        )
    if not (np.all(np.isfinite(start.agent)) and np.all(np.isfinite(start.still))):
        raise InputError("start: expected finite numbers")


def _part(problem: Problem, first: int, last: int) -> Problem:
    """The problem of epochs ``first .. last``."""
    sweeps = tuple(
        SweepFactor(sweep.epoch - first, sweep.slot, sweep.flash)
        for sweep in problem.sweeps
        if first <= sweep.epoch <= last
    )
    return replace(
        problem,
        time_s=problem.time_s[first : last + 1],
        paths=problem.paths.within(first, last),
        sweeps=sweeps,
    )


def _eliminate_first(part: Problem, window: Trajectory, past: Past | None, basis: Array) -> Past:
    """What the first epoch of the window, and all before, say about the second and the border."""
    pair = replace(
        part,
        time_s=part.time_s[:2],
        paths=part.paths.within(0, 0),
        sweeps=tuple(sweep for sweep in part.sweeps if sweep.epoch == 0),
    )
    at = Trajectory(window.agent[:2], window.still)
    linear = linearise(pair, at, past)
    matrix, size = linear.matrix, basis.shape[1]
    across = np.concatenate([matrix.link[0], matrix.border[0]], axis=1)  # first epoch by the rest
    gain = np.linalg.solve(matrix.chain[0], np.column_stack([across, linear.chain[0]]))
    information = np.zeros((4 + size, 4 + size))
    information[:4, :4] = matrix.chain[1]
    information[:4, 4:] = matrix.border[1]
    information[4:, :4] = matrix.border[1].T
    information[4:, 4:] = matrix.corner
    information -= across.T @ gain[:, :-1]
    gradient = np.concatenate([linear.chain[1], linear.border]) - across.T @ gain[:, -1]
    return Past(0.5 * (information + information.T), gradient, Trajectory(at.agent[1:], at.still))


def placed(problem: Problem, trajectory: Trajectory, marginals: Marginals, t: int) -> tuple[Array, Array]:
    """Agent, anchors and walls of an epoch in the estimator's frame, then theta, and their covariance.

    Parameters
    ----------
    problem, trajectory, marginals
        A smoothed run.
    t : int
        Row of its epochs; -1 is the last, also of a window.

    Returns
    -------
    values, covariance : ndarray, shapes (5 + 2 (K + L),) and its square
        x, y, vx, vy, then x, y of each anchor and of each VRP, metres, and the rotation, radians.
    """
    layout, (basis, _) = problem.layout, problem.basis()
    state = trajectory.still.copy()
    state[AGENT] = trajectory.agent[t]
    pairs = [slice(0, 2), slice(2, 4), *(layout.anchor_xy(k) for k in range(layout.anchors))]
    pairs += [layout.wall(slot) for slot in range(layout.slots)]
    points, jacobian = rotate_by_angle_of(state, THETA, pairs, problem.bearing_rad)
    values = np.append(points, state[THETA])
    linear = np.vstack([jacobian, np.eye(layout.size)[THETA]])
    by_agent, by_border = linear[:, AGENT], linear @ basis
    mixed = by_agent @ marginals.cross[t] @ by_border.T
    covariance = (
        by_agent @ marginals.chain[t] @ by_agent.T
        + mixed
        + mixed.T
        + by_border @ marginals.border @ by_border.T
    )
    return values, covariance


def _collect(
    layout: Layout,
    places: list[tuple[Array, Array]],
    cost: float,
    trajectory: Trajectory,
    marginals: Marginals,
) -> Smoothed:
    """Split what stands at each epoch into agent, anchors and walls."""
    values = np.array([mean for mean, _ in places])
    covariances = np.array([covariance for _, covariance in places])
    points = values[:, 4:-1].reshape(len(values), -1, 2)
    index = np.arange(4, values.shape[1] - 1).reshape(-1, 2)
    blocks = covariances[:, index[:, :, None], index[:, None, :]]
    return Smoothed(
        values[:, :4],
        covariances[:, :4, :4],
        np.sqrt(covariances[:, -1, -1]),
        points[:, : layout.anchors],
        blocks[:, : layout.anchors],
        points[:, layout.anchors :],
        blocks[:, layout.anchors :],
        cost,
        trajectory,
        marginals,
    )
