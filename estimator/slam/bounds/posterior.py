"""Posterior Cramer-Rao bounds of agent, anchors and walls: what no method can beat.

For Gaussian noise the Bayesian information of a run is that of the problem linearised at the truth:
of the measurements (:mod:`estimator.slam.bounds.scenario`), of the motion (39) and of the prior. Two
bounds follow,

- *recursive*: what the measurements up to an epoch allow at that epoch, the limit of a filter
  (P. Tichavsky, C. Muravchik, A. Nehorai, IEEE Trans. Signal Process. 46(5), 1998); a covariance
  recursion;
- *batch*: what all measurements of the run allow at that epoch, the limit of a smoother; the information of
  the whole run, eliminated along the chain (:mod:`estimator.slam.smoothing.arrowhead`).

At the last epoch they are equal. One mode dominates where anchors are unknown: a rotation of agent
and map about RP, which path lengths do not see. The *rotation* is the projection of the map's error
onto that mode in the metric of its own information; errors are given with and without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.slam.bounds.scenario import Scenario, Sensing
from estimator.slam.models.motion import predict_by_odometry, process_noise, transition
from estimator.slam.models.state_vector import AGENT, POSITION
from estimator.slam.smoothing.arrowhead import Arrowhead, eliminate
from estimator.slam.smoothing.linearise import JITTER_M2

__all__ = ["Bounds", "expected_distance", "posterior_bounds"]

Array = NDArray[np.float64]

_DIRECTIONS = 720  # of the quadrature of mean distances


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of a run, epoch by epoch.

    Parameters
    ----------
    position_covariance_m2 : ndarray, shape (T, 2, 2)
        Covariance of the agent's position.
    derotated_covariance_m2 : ndarray, shape (T, 2, 2)
        The same with the rotation about RP removed.
    rotation_std_rad : ndarray, shape (T,)
        Standard deviation of the rotation; 0 where known anchors or walls forbid one.
    anchor_covariance_m2 : ndarray, shape (T, K, 2, 2)
        Anchors; zero where known.
    wall_covariance_m2 : ndarray, shape (T, L, 2, 2)
        VRPs; huge where nothing is known yet.
    wall_counts : ndarray of bool, shape (T, L)
        Walls that a map at that epoch should have: sensed at the start or reflecting by then, and
        not only in passing.
    """

    position_covariance_m2: Array
    derotated_covariance_m2: Array
    rotation_std_rad: Array
    anchor_covariance_m2: Array
    wall_covariance_m2: Array
    wall_counts: NDArray[np.bool_]

    @property
    def position_rmse_m(self) -> Array:
        """Root mean square position error, shape (T,), metres."""
        return _rms(self.position_covariance_m2)

    @property
    def position_mae_m(self) -> Array:
        """Mean distance from the true position, shape (T,), metres."""
        return expected_distance(self.position_covariance_m2)

    @property
    def derotated_rmse_m(self) -> Array:
        """Root mean square position error with the rotation removed, shape (T,), metres."""
        return _rms(self.derotated_covariance_m2)

    def vrp_ospa_m(self, cutoff_m: float = 10.0) -> Array:
        """Mean OSPA of order 1 of the VRPs, each matched to its own, shape (T,), metres.

        NaN before the first wall.
        """
        error = np.where(self.wall_counts, expected_distance(self.wall_covariance_m2, cutoff_m), 0.0)
        count = self.wall_counts.sum(axis=1)
        return np.asarray(np.where(count > 0, error.sum(axis=1) / np.maximum(count, 1), np.nan))


def _rms(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1)))


def expected_distance(covariance: ArrayLike, cutoff: float = np.inf) -> Array:
    """Mean of ``min(|e|, cutoff)`` for planar Gaussian errors ``e`` of given covariance.

    In the direction of angle ``a`` from the larger axis the length is Rayleigh-like with
    ``q = cos^2 a / l1 + sin^2 a / l2``, over which the radial integral has a closed form; the angle is
    substituted so that the remaining periodic integrand is smooth for any ratio of axes.

    Parameters
    ----------
    covariance : array_like, shape (..., 2, 2)
        Covariances; may be singular.
    cutoff : float
        Largest distance that counts.

    Returns
    -------
    ndarray, shape (...)
    """
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.shape[-2:] != (2, 2) or not cutoff > 0.0:
        raise InputError(
            f"covariance: expected shape (..., 2, 2) and a positive cutoff, got {matrix.shape}, {cutoff}"
        )
    axes = np.sqrt(np.maximum(np.linalg.eigvalsh(matrix), 0.0))
    angle = 2.0 * np.pi * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    # e = r (s1 cos a, s2 sin a) with r Rayleigh and a uniform: the scale in each direction
    scale = np.hypot(axes[..., :1] * np.cos(angle), axes[..., 1:] * np.sin(angle))
    if not np.isfinite(cutoff):
        return np.asarray(np.sqrt(0.5 * np.pi) * scale.mean(axis=-1))
    from scipy.special import erf

    # E min(s r, c) = s sqrt(pi / 2) erf(c / (s sqrt 2)) for Rayleigh r
    safe = np.maximum(scale, 1e-300)
    return np.asarray(np.mean(np.sqrt(0.5 * np.pi) * scale * erf(cutoff / (safe * np.sqrt(2.0))), axis=-1))


def posterior_bounds(
    scenario: Scenario,
    sensing: Sensing,
    kind: Literal["recursive", "batch"] = "recursive",
    least_epochs: int = 20,
) -> Bounds:
    """Bounds of every epoch.

    Parameters
    ----------
    scenario : Scenario
        The truth.
    sensing : Sensing
        What is known and measured.
    kind : {"recursive", "batch"}
        The limit of a filter, or of a smoother.
    least_epochs : int
        A wall that reflects in fewer epochs and was not sensed at the start need not be mapped.

    Returns
    -------
    Bounds

    Raises
    ------
    ConfigurationError
        If ``kind`` is unknown, or odometry is used in the batch.
    """
    if kind not in ("recursive", "batch"):
        raise ConfigurationError(f"kind: expected 'recursive' or 'batch', got {kind!r}")
    if kind == "batch" and sensing.odometry is not None:
        raise ConfigurationError("kind: expected 'recursive' with odometry, got 'batch'")
    covariances = _recursive(scenario, sensing) if kind == "recursive" else _batch(scenario, sensing)
    layout, states = scenario.layout, scenario.states
    epochs = len(states)
    position = covariances[:, POSITION, POSITION]
    rotation, derotated = np.zeros(epochs), position.copy()
    if not (sensing.anchors_known or sensing.walls_known):
        for t in range(epochs):
            rotation[t], derotated[t] = _derotate(covariances[t], states[t], scenario, sensing)
    anchors = [layout.anchor_xy(k) for k in range(layout.anchors)]
    walls = [layout.wall(wall) for wall in range(layout.slots)]
    reflects = np.any(scenario.visible(1)[:, :, 1 : 1 + layout.slots], axis=1)
    sensed = np.isin(np.arange(layout.slots), list(sensing.sensed))
    counts = (np.logical_or.accumulate(reflects) & (reflects.sum(axis=0) >= least_epochs)) | sensed
    return Bounds(
        position,
        derotated,
        rotation,
        np.stack([covariances[:, k, k] for k in anchors], axis=1),
        np.stack([covariances[:, w, w] for w in walls], axis=1),
        counts,
    )


def _recursive(scenario: Scenario, sensing: Sensing) -> Array:
    """Covariances (T, n, n) of the filter that knows the truth's derivatives."""
    basis, variance = scenario.prior(sensing)
    covariance = (basis * variance) @ basis.T
    agent = AGENT
    move = transition(scenario.step_s)
    drive = process_noise(scenario.step_s, sensing.acceleration_variance)
    result = []
    for t, seen in enumerate(scenario.observations(sensing)):
        if t and sensing.odometry is not None:
            # the noise being the same in all directions, the true direction of the body does not matter
            share, turn_std = sensing.odometry
            way = scenario.states[t, POSITION] - scenario.states[t - 1, POSITION]
            spread = np.diag([*[(share * np.linalg.norm(way)) ** 2] * 2, turn_std**2])
            before = scenario.states[t - 1].copy()
            predict_by_odometry(before, covariance, scenario.step_s, way, 0.0, spread)
        elif t:
            covariance[agent, :] = move @ covariance[agent, :]
            covariance[:, agent] = covariance[:, agent] @ move.T
            covariance[agent, agent] += drive
        cross = seen.jacobian @ covariance
        gain = np.linalg.solve(cross @ seen.jacobian.T + seen.covariance, cross).T
        keep = np.eye(len(covariance)) - gain @ seen.jacobian
        covariance = keep @ covariance @ keep.T + gain @ seen.covariance @ gain.T  # Joseph's form
        result.append(covariance.copy())
    return np.array(result)


def _batch(scenario: Scenario, sensing: Sensing) -> Array:
    """Covariances (T, n, n) given all epochs."""
    observations = scenario.observations(sensing)
    basis, variance = scenario.prior(sensing)
    agent, first = 4, 2  # agent states; of these the prior knows the position
    still, velocity = basis[:, first:], variance[:first]
    epochs, size = len(observations), still.shape[1]
    chain, border = np.zeros((epochs, agent, agent)), np.zeros((epochs, agent, size))
    corner = np.diag(1.0 / variance[first:])
    for t, seen in enumerate(observations):
        moving, standing = seen.jacobian[:, AGENT], seen.jacobian @ still
        weighted = np.linalg.solve(seen.covariance, np.concatenate([moving, standing], axis=1))
        chain[t] += moving.T @ weighted[:, :agent]
        border[t] = moving.T @ weighted[:, agent:]
        corner += standing.T @ weighted[:, agent:]
    chain[0] += np.diag(np.concatenate([[1.0 / JITTER_M2] * 2, 1.0 / velocity]))
    move = transition(scenario.step_s)
    drive = np.linalg.inv(
        process_noise(scenario.step_s, sensing.acceleration_variance) + JITTER_M2 * np.eye(agent)
    )
    chain[:-1] += move.T @ drive @ move
    chain[1:] += drive
    link = np.broadcast_to(-move.T @ drive, (epochs - 1, agent, agent))
    marginals = eliminate(Arrowhead(chain, link, border, corner)).marginals()
    covariance = np.broadcast_to(still @ marginals.border @ still.T, (epochs, len(basis), len(basis))).copy()
    covariance[:, AGENT, AGENT] = marginals.chain
    cross = marginals.cross @ still.T
    covariance[:, AGENT, agent:] = cross[:, :, agent:]
    covariance[:, agent:, AGENT] = np.swapaxes(cross[:, :, agent:], -1, -2)
    return covariance


def _derotate(covariance: Array, state: Array, scenario: Scenario, sensing: Sensing) -> tuple[float, Array]:
    """Standard deviation of the rotation, and the position's covariance without it.

    With ``g`` what a rotation does to the map and ``P`` the map's covariance, the rotation of an error
    ``e`` is ``g' P^-1 e / (g' P^-1 g)``.
    """
    layout = scenario.layout
    walls = np.unique(scenario.lines).tolist() if sensing.lines_shared else range(layout.slots)
    map_xy = [
        *(layout.anchor_xy(k) for k in range(layout.anchors)),
        *(layout.wall(i) for i in walls),
    ]
    index = np.concatenate([np.arange(place.start, place.stop) for place in map_xy])
    mode = _quarter_turn(state[index])
    block = covariance[np.ix_(index, index)]
    weight = np.linalg.solve(block, mode)
    variance = 1.0 / float(mode @ weight)
    cross = covariance[POSITION, index] @ weight * variance  # with the rotation
    turn = _quarter_turn(state[POSITION])
    without = (
        covariance[POSITION, POSITION]
        - np.outer(turn, cross)
        - np.outer(cross, turn)
        + variance * np.outer(turn, turn)
    )
    return float(np.sqrt(variance)), 0.5 * (without + without.T)


def _quarter_turn(points: Array) -> Array:
    """Flat points (x, y, x, y, ...) turned by 90 degrees."""
    pairs = points.reshape(-1, 2)
    return np.stack([-pairs[:, 1], pairs[:, 0]], axis=1).ravel()
