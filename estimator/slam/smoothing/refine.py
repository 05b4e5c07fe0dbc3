"""A finished hybrid run, smoothed: the result tells which path came from where, and all is estimated again.

Every path of the run is associated with what the run found in the end: anchors, walls and track
(:mod:`estimator.slam.smoothing.association`). The run is smoothed with these associations
(:mod:`estimator.slam.smoothing.smoother`), and with its estimate, which is better everywhere, both
are repeated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp, MeasurementSet
from estimator.result import SlamResult
from estimator.slam.models.clutter_guard import guard_clutter
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import NOWHERE_M, THETA, Layout
from estimator.slam.models.sweeps import predict_flashes
from estimator.slam.run import config_for
from estimator.slam.smoothing.association import RunPaths, path_factors, stacked_paths
from estimator.slam.smoothing.factors import (
    Models,
    PathFactors,
    Problem,
    SweepFactor,
    Trajectory,
    column_of,
)
from estimator.slam.smoothing.map_evidence import joint_map
from estimator.slam.smoothing.measured_paths import length_variances
from estimator.slam.smoothing.smoother import Smoothed, smooth, smooth_fixed_lag

__all__ = ["RefineConfig", "refine"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RefineConfig:
    """How a run is associated and smoothed.

    Parameters
    ----------
    rounds : int
        Times that paths are associated and the run is smoothed.
    first_spread_m : float
        Standard deviation of the lengths predicted from the filter's result, metres; later rounds
        know theirs from the smoother.
    least_probability : float
        Paths that belong to a feature with at least this probability become factors.
    lag : int
        Lag of the smoother, epochs; 0 for the whole run.
    wall_gate_sigma : float
        A wall of the result is one sensed at the start if it is within so many standard deviations; more
        than the filter's gate, for it has moved since.
    bias_bin_m : float
        Clock biases are first looked for in bins of this width: a few errors of a path length.
    bias_reach_sigma : float
        And within so many standard deviations of their prior.
    highest_m, height_step_m : float
        Anchors are first looked for up to this height above or below the agent, in steps of this.
    height_gain : float
        A height is believed, whatever the prior, if so many times as many paths meet there.
    """

    rounds: int = 2
    first_spread_m: float = 0.3
    least_probability: float = 0.5
    lag: int = 0
    wall_gate_sigma: float = 4.5
    bias_bin_m: float = 0.2
    bias_reach_sigma: float = 5.0
    highest_m: float = 12.0
    height_step_m: float = 0.1
    height_gain: float = 1.3

    def __post_init__(self) -> None:
        if self.rounds < 1 or self.lag < 0:
            raise ConfigurationError(
                f"rounds, lag: expected at least 1 and 0, got {self.rounds} and {self.lag}"
            )
        for name in (
            "first_spread_m",
            "wall_gate_sigma",
            "bias_bin_m",
            "bias_reach_sigma",
            "highest_m",
            "height_step_m",
            "height_gain",
        ):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")
        if not 0.0 < self.least_probability < 1.0:
            raise ConfigurationError(
                f"least_probability: expected a number between 0 and 1, got {self.least_probability}"
            )


def refine(
    measurements: MeasurementSet,
    result: SlamResult,
    model: Models | None = None,
    config: RefineConfig | None = None,
) -> SlamResult:
    """Smooth the run that a filter made of some measurements.

    Parameters
    ----------
    measurements : MeasurementSet
        What the filter was given.
    result : SlamResult
        What it found.
    model : Models, optional
        Models; by default those that fit the measurements.
    config : RefineConfig, optional
        How.

    Returns
    -------
    SlamResult
        All epochs given all measurements (or those up to the lag); engine ``smoother``. Anchors and walls are
        those of the result's last epoch; ``joint`` tells what they have in common and which path was which.

    Raises
    ------
    InputError
        If the two do not fit, the result holds no wall that was sensed at the start, or clocks are not
        constant.
    """
    if model is None:
        model = cast(Models, config_for(measurements, engine="gaussian"))
    config = config or RefineConfig()
    if not model.clocks.constant:
        raise InputError(
            "smoother: expected constant clock biases and ranges to scale, "
            "got clock_walk_ppm, clock_free_std_m or range_scale_std above 0"
        )
    if len(result.epoch) != len(measurements.epochs):
        raise InputError(f"result: expected {len(measurements.epochs)} epochs, got {len(result.epoch)}")
    problem, at, wall_id = _start(measurements, result, model, config.wall_gate_sigma)
    epochs = [guard_clutter(epoch, model.noise.most_paths) for epoch in measurements.epochs]
    tables = [stack_paths(epoch, measurements.carrier_hz) for epoch in epochs]
    located = result.anchor_valid[-1]
    heard = stacked_paths(tables)
    at = _biased(problem, at, heard, config)
    problem, at = _raised(problem, at, heard, located, config)
    spread: ArrayLike = config.first_spread_m**2
    for _ in range(config.rounds):
        factors = path_factors(problem, at, heard, located, spread, config.least_probability)
        problem = replace(problem, paths=factors, sweeps=_sweep_factors(problem, at, measurements))
        smoothed = smooth(problem, at)
        at, spread = smoothed.trajectory, _spread(problem, smoothed)
    if config.lag:
        smoothed = smooth_fixed_lag(problem, at, config.lag)
    joint = joint_map(problem, smoothed, measurements, np.argsort(wall_id))
    return replace(_result(result, smoothed, located, wall_id), joint=joint)


def _start(
    measurements: MeasurementSet, result: SlamResult, model: Models, wall_gate_sigma: float
) -> tuple[Problem, Trajectory, NDArray[np.int64]]:
    """A problem without factors, where its result has everything, and the walls' identities by slot."""
    from scipy.optimize import linear_sum_assignment

    found = np.flatnonzero(result.wall_valid[-1])
    vrps = result.wall_mean_m[-1, found]
    sensed: dict[int, GaussianVrp] = {}
    if len(found) and measurements.walls:
        gaps = np.array([[_distance(wall, vrp) for vrp in vrps] for wall in measurements.walls])
        for i, j in zip(*linear_sum_assignment(np.minimum(gaps, wall_gate_sigma**2)), strict=True):
            if gaps[i, j] < wall_gate_sigma**2:
                sensed[int(j)] = measurements.walls[i]
    if not sensed:
        raise InputError("result: expected a wall that was sensed at the start, got none")
    reference = min(sensed, key=lambda j: _bearing_variance(sensed[j]))
    slots = [reference, *(j for j in range(len(found)) if j != reference)]
    layout = Layout(len(result.anchors), len(slots))
    walls = tuple(sensed.get(j) for j in slots)
    problem = Problem(layout, result.time_s, _no_paths(), walls, model)

    vrps = vrps[slots]
    turn = rotation_matrix(-float(np.arctan2(vrps[0, 1], vrps[0, 0])))
    still = np.zeros(layout.size)
    theta = float(np.arctan2(vrps[0, 1], vrps[0, 0])) - problem.bearing_rad
    still[THETA] = np.angle(np.exp(1j * theta))
    still[layout.walls] = (vrps @ turn.T).ravel()
    still[layout.wall(0).start + 1] = 0.0
    for k in range(layout.anchors):
        known = bool(result.anchor_valid[-1, k])
        still[layout.anchor_xy(k)] = turn @ result.anchor_mean_m[-1, k] if known else (NOWHERE_M, 0.0)
        still[layout.height2(k)] = model.noise.height2_mean_m2
    agent = result.agent_mean.copy()
    agent[:, :2], agent[:, 2:] = agent[:, :2] @ turn.T, agent[:, 2:] @ turn.T
    return problem, Trajectory(agent, still), result.wall_id[found][slots]


def _no_paths() -> PathFactors:
    none = np.zeros(0, dtype=np.int64)
    return PathFactors(none, none, none, np.zeros(0), np.ones(0))


def _distance(wall: GaussianVrp, vrp: Array) -> float:
    gap = vrp - wall.mean_m
    return float(gap @ np.linalg.solve(wall.covariance_m2, gap))


def _bearing_variance(wall: GaussianVrp) -> float:
    square = float(wall.mean_m @ wall.mean_m)
    tangent = np.array([-wall.mean_m[1], wall.mean_m[0]])
    return float(tangent @ wall.covariance_m2 @ tangent) / square**2


def _biased(problem: Problem, at: Trajectory, heard: RunPaths, config: RefineConfig) -> Trajectory:
    """Clock biases from the offset that most paths have in common, if there may be any."""
    model, layout = problem.config.clocks, problem.layout
    if model.clock_bias_std_m == 0.0:
        return at
    prediction = predict_paths(at.states(), layout)
    first = slice(0, 1 + layout.slots)
    reach = config.bias_reach_sigma * model.clock_bias_std_m
    bins = int(2.0 * reach / config.bias_bin_m) + 1
    votes = np.zeros((layout.anchors, bins))
    for k in range(layout.anchors):
        gap = heard.length_m[:, k, None, :] - prediction.length_m[:, k, first, None]
        use = heard.valid[:, k, None, :] & prediction.possible[:, k, first, None]
        votes[k] = np.convolve(np.histogram(gap[use], bins, (-reach, reach))[0], np.ones(3), mode="same")
    if model.clock_bias_common:
        votes[:] = votes.sum(axis=0)
    still = at.still.copy()
    for k in range(layout.anchors):
        still[layout.bias(k)] = -reach + (np.argmax(votes[k]) + 0.5) * 2.0 * reach / bins
    return Trajectory(at.agent, still)


def _raised(
    problem: Problem, at: Trajectory, heard: RunPaths, located: NDArray[np.bool_], config: RefineConfig
) -> tuple[Problem, Trajectory]:
    """Heights at which clearly more paths meet than at the prior's, and a prior about them.

    Lines of sight and single bounces count, where the prior leaves heights open at all.
    """
    layout, noise = problem.layout, problem.config.noise
    if noise.height2_std_m2 == 0.0:
        return problem, at
    prediction = predict_paths(at.states(), layout)
    first = slice(0, 1 + layout.slots)
    offset = at.agent[:, None, None, :2] - prediction.source_m[:, :, first]
    flat2 = np.sum(offset**2, axis=-1)
    heights = np.arange(0.0, config.highest_m, config.height_step_m)
    still, priors = at.still.copy(), []
    for k in range(layout.anchors):
        prior = (noise.height2_mean_m2, noise.height2_std_m2)
        use = heard.valid[:, k, None, :] & prediction.possible[:, k, first, None]
        hits = np.zeros(len(heights))
        measured = heard.length_m[:, k, None, :] - still[layout.bias(k)]
        for i, height in enumerate(heights):
            length = np.sqrt(flat2[:, k] + height**2)[..., None]
            hits[i] = np.sum(use & (np.abs(measured - length) < config.first_spread_m))
        best = int(np.argmax(hits))
        near = int(np.argmin(np.abs(heights - np.sqrt(max(noise.height2_mean_m2, 0.0)))))
        if located[k] and hits[best] > config.height_gain * hits[near]:
            height = heights[best]
            prior = (height**2, max(noise.height2_std_m2, 2.0 * height * config.first_spread_m))
            still[layout.height2(k)] = height**2
        priors.append(prior)
    return replace(problem, height2_prior=tuple(priors)), Trajectory(at.agent, still)


def _spread(problem: Problem, smoothed: Smoothed) -> Array:
    """Variances (T, K, F) of the lengths that a smoothed run predicts."""
    at, found = smoothed.trajectory, smoothed.marginals
    column = column_of(problem.basis()[0])
    return length_variances(
        problem.layout, at.agent, at.still, column, found.chain, found.cross, found.border
    )


def _sweep_factors(problem: Problem, at: Trajectory, measurements: MeasurementSet) -> tuple[SweepFactor, ...]:
    """Walls seen on the way, each given to the nearest wall within the gate; heading held."""
    states, turn = at.states(), rotation_matrix(-problem.bearing_rad)
    factors = []
    for t, epoch in enumerate(measurements.epochs):
        if not epoch.sweep or not epoch.heading_held:
            continue
        flash = predict_flashes(states[t], problem.layout)[0] @ turn
        for wall in epoch.sweep:
            gaps = [_distance(wall, seen) for seen in flash]
            slot = int(np.argmin(gaps))
            if gaps[slot] < problem.config.gating.gate_sigma**2:
                factors.append(SweepFactor(t, slot, wall))
    return tuple(factors)


def _result(
    result: SlamResult,
    smoothed: Smoothed,
    located: NDArray[np.bool_],
    wall_id: NDArray[np.int64],
) -> SlamResult:
    """The smoothed run as a result."""
    epochs, order = len(result.epoch), np.argsort(wall_id)
    nowhere = ~located
    anchors, anchor_covariances = smoothed.anchor_mean_m.copy(), smoothed.anchor_covariance_m2.copy()
    anchors[:, nowhere], anchor_covariances[:, nowhere] = np.nan, np.nan
    walls, track = smoothed.wall_mean_m[:, order], smoothed.agent_mean[:, :2]
    existence = result.wall_existence[-1, np.searchsorted(result.wall_id, wall_id[order])]
    return replace(
        result,
        engine="smoother",
        agent_mean=smoothed.agent_mean,
        agent_covariance=smoothed.agent_covariance,
        rotation_std_rad=smoothed.rotation_std_rad,
        anchor_valid=np.tile(located, (epochs, 1)),
        anchor_mean_m=anchors,
        anchor_covariance_m2=anchor_covariances,
        wall_id=wall_id[order],
        wall_valid=np.ones((epochs, len(wall_id)), dtype=bool),
        wall_mean_m=walls,
        wall_covariance_m2=smoothed.wall_covariance_m2[:, order],
        hypotheses=np.ones(epochs, dtype=np.int64),
        anchor_existence=np.tile(result.anchor_existence[-1], (epochs, 1)),
        wall_existence=np.tile(existence, (epochs, 1)),
        candidate_weight=np.ones((epochs, 1)),
        candidate_agent_m=track[:, None],
        candidate_wall_id=wall_id[order],
        candidate_wall_mean_m=walls[:, None],
    )
