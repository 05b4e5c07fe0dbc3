"""The smoother: derivatives, covariances against the bound, consistency, fixed lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.errors import ConfigurationError, InputError
from estimator.evaluation.metrics import derotated
from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam.bounds.posterior import posterior_bounds
from estimator.slam.bounds.scenario import Scenario, Sensing
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.models.directions import predict_azimuths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import FIRST_ANCHOR, THETA, Layout
from estimator.slam.models.sweeps import predict_flashes
from estimator.slam.smoothing.factors import PathFactors, Problem, SweepFactor, Trajectory
from estimator.slam.smoothing.linearise import linearise
from estimator.slam.smoothing.smoother import smooth, smooth_fixed_lag

SENSED = {0: 0.08, 1: 0.7, 2: 4.0, 3: 0.2}
STD = 0.1
MODEL = GaussianConfig.of(range_std_m=STD, height2_mean_m2=0.0, height2_std_m2=0.0)


@pytest.fixture(scope="module")
def scenario(room):
    """The paper's five reflecting walls, anchors P0 and the smoothed track."""
    from raytrace.plan.files import load_floorplan  # plain pydantic, no ray tracer

    track = load_floorplan("l-room").track()[:, :2]
    return Scenario(room.walls[:5, 0], room.walls[:5, 1], room.anchors, track)


def shortened(scenario: Scenario, epochs: int) -> Scenario:
    return replace(scenario, track_m=scenario.track_m[:epochs])


def truth(scenario: Scenario, problem: Problem) -> Trajectory:
    """The true trajectory in the gauge frame, whose theta is minus the sensed bearing's error."""
    layout, state = scenario.layout, scenario.states[0]
    bearing = float(np.arctan2(scenario.vrps_m[0, 1], scenario.vrps_m[0, 0]))
    turn = rotation_matrix(-bearing)
    still = state.copy()
    for pair in (*map(layout.anchor_xy, range(layout.anchors)), *map(layout.wall, range(layout.slots))):
        still[pair] = turn @ state[pair]
    still[THETA] = np.angle(np.exp(1j * (bearing - problem.bearing_rad)))
    still[layout.wall(0).start + 1] = 0.0
    agent = scenario.states[:, :4].copy()
    agent[:, :2], agent[:, 2:] = agent[:, :2] @ turn.T, agent[:, 2:] @ turn.T
    return Trajectory(agent, still)


def measured(
    scenario: Scenario,
    rng: np.random.Generator | None,
    model: GaussianConfig = MODEL,
    azimuth_std_rad: float | None = None,
    sweep_every: int = 0,
    bias_m: float = 0.0,
) -> Problem:
    """Factors of a run with known associations; without a generator free of errors and misses."""
    layout, states = scenario.layout, scenario.states
    seen = scenario.visible(1)
    noise = (lambda *shape: np.zeros(shape)) if rng is None else (lambda *shape: rng.normal(size=shape))
    if rng is not None:
        seen &= rng.random(seen.shape) < 0.95
    epoch, anchor, feature = np.nonzero(seen)
    count = len(epoch)
    length = predict_paths(states, layout).length_m[seen] + STD * noise(count) + bias_m
    factors = PathFactors(epoch, anchor, feature, length, np.full(count, STD))
    if azimuth_std_rad is not None:
        azimuth = predict_azimuths(states, layout)[0][seen] + azimuth_std_rad * noise(count)
        factors = replace(factors, azimuth_rad=azimuth, azimuth_std_rad=np.full(count, azimuth_std_rad))
    sensed: list[GaussianVrp | None] = [None] * layout.slots
    for wall, variance in SENSED.items():
        error = np.sqrt(variance) * noise(2)
        sensed[wall] = GaussianVrp(scenario.vrps_m[wall] + error, variance * np.eye(2))
    sweeps = []
    if sweep_every:
        met = scenario.walls_met()
        for t in range(sweep_every, len(states), sweep_every):
            for wall in np.flatnonzero(met[t]):
                image = predict_flashes(states[t], layout)[0][wall]
                variance = Sensing().sweep_variance * 0.25 * image @ image
                flash = GaussianVrp(image + np.sqrt(variance) * noise(2), variance * np.eye(2))
                sweeps.append(SweepFactor(t, int(wall), flash))
    times = np.arange(len(states), dtype=np.float64)
    return Problem(layout, times, factors, tuple(sensed), model, tuple(sweeps))


def disturbed(at: Trajectory, layout: Layout, rng: np.random.Generator) -> Trajectory:
    """A start 0.3 m off in everything that stands still."""
    still = at.still.copy()
    still[FIRST_ANCHOR:] += 0.3 * rng.normal(size=len(still) - FIRST_ANCHOR)
    for k in range(layout.anchors):
        still[[layout.height2(k), layout.bias(k), layout.scale(k)]] = 0.0
    still[layout.wall(0).start + 1] = 0.0
    return Trajectory(at.agent, still)


def test_gradient_is_the_slope_of_the_cost(scenario):
    """Every kind of factor and prior, by central differences of the cost, away from the minimum."""
    model = MODEL.but(height2_mean_m2=1.0, height2_std_m2=1.0, clock_bias_std_m=2.0, clock_bias_common=True)
    rng = np.random.default_rng(1)
    problem = measured(shortened(scenario, 12), rng, model, azimuth_std_rad=0.02, sweep_every=5)
    slots = scenario.layout.slots
    pairs = np.array([1 + slots + 0 * slots + 3, 1 + slots + 3 * slots + 2])
    factors = problem.paths
    problem = replace(  # two double bounces as well
        problem, paths=replace(factors, feature=np.concatenate([factors.feature[:-2], pairs]))
    )
    basis, _ = problem.basis()
    at = truth(shortened(scenario, 12), problem)
    at = at.moved(0.1 * rng.normal(size=at.agent.shape), 0.2 * rng.normal(size=basis.shape[1]), basis)
    linear = linearise(problem, at)
    for _ in range(10):
        chain, border = rng.normal(size=at.agent.shape), rng.normal(size=basis.shape[1])
        h = 1e-6
        ahead = linearise(problem, at.moved(h * chain, h * border, basis)).cost
        behind = linearise(problem, at.moved(-h * chain, -h * border, basis)).cost
        slope = -2.0 * (np.sum(linear.chain * chain) + linear.border @ border)
        assert slope == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-4)


@pytest.mark.parametrize(
    ("data", "sensing"),
    [
        ({}, {}),
        ({"azimuth_std_rad": np.deg2rad(1.0)}, {"azimuth_std_rad": np.deg2rad(1.0)}),
        ({"sweep_every": 10}, {"sweep_every": 10}),
        ({"model": MODEL.but(clock_bias_std_m=1e3), "bias_m": 3.0}, {"clock_bias": "each"}),
        (
            {"model": MODEL.but(clock_bias_std_m=1e3, clock_bias_common=True), "bias_m": -2.0},
            {"clock_bias": "common"},
        ),
    ],
    ids=["ranges", "angles", "sweeps", "each its bias", "common bias"],
)
def test_covariances_are_the_batch_bound(scenario, data, sensing):
    """Without errors the smoother finds the truth, and claims what the bound, made elsewhere, allows."""
    problem = measured(scenario, None, **data)
    start = disturbed(truth(scenario, problem), scenario.layout, np.random.default_rng(2))
    found = smooth(problem, start)
    np.testing.assert_allclose(found.agent_mean[:, :2], scenario.states[:, :2], atol=0.02)
    np.testing.assert_allclose(found.wall_mean_m[-1], scenario.vrps_m, atol=0.02)
    bound = posterior_bounds(scenario, Sensing(sensed=SENSED, **sensing), "batch")
    for t in (20, 120, 235):
        np.testing.assert_allclose(
            found.agent_covariance[t, :2, :2], bound.position_covariance_m2[t], rtol=0.01, atol=2e-5
        )
    for name in ("wall_covariance_m2", "anchor_covariance_m2"):
        np.testing.assert_allclose(getattr(found, name)[-1], getattr(bound, name)[-1], rtol=0.01, atol=2e-4)


def joint_nees(scenario: Scenario, problem: Problem) -> tuple[float, np.ndarray]:
    """Squared error per dimension of all that stands still, and the last position's error derotated."""
    at = truth(scenario, problem)
    found = smooth(problem, at)
    basis, _ = problem.basis()
    error = basis.T @ (found.trajectory.still - at.still)
    square = error @ np.linalg.solve(found.marginals.border, error) / len(error)
    track, true = found.agent_mean[:, :2], scenario.states[:, :2]
    cross = np.sum(true[:, 0] * track[:, 1] - true[:, 1] * track[:, 0])
    turn = np.arctan2(cross, np.sum(true * track))
    return square, derotated(track[None], np.array([turn]))[0, -1] - true[-1]


def test_smoother_is_consistent_and_meets_the_bound(scenario):
    """NEES per dimension within 0.8 .. 1.2 up to its Monte-Carlo error; derotated error within the bound."""
    runs = 20
    problems = [measured(scenario, np.random.default_rng(100 + run)) for run in range(runs)]
    squares, errors = zip(*(joint_nees(scenario, problem) for problem in problems), strict=True)
    dimensions = problems[0].basis()[0].shape[1]
    mc = 3.0 * np.sqrt(2.0 / (dimensions * runs))
    assert 0.8 - mc < np.mean(squares) < 1.2 + mc
    sensing = Sensing(sensed=SENSED, detection_probability=0.95)
    bound = posterior_bounds(scenario, sensing).derotated_rmse_m[-1]
    # the true track bends less than the motion model expects, so the error may be below its mean
    assert np.sqrt(np.mean(np.sum(np.square(errors), axis=1))) < bound * (1.0 + 3.0 / np.sqrt(4.0 * runs))
    # claiming half of the true standard deviations would be noticed
    proud = [
        joint_nees(scenario, replace(problem, paths=replace(problem.paths, std_m=0.5 * problem.paths.std_m)))[
            0
        ]
        for problem in problems[:5]
    ]
    assert np.mean(proud) > 1.2 + 3.0 * np.sqrt(2.0 / (dimensions * 5))


def test_fixed_lag_tends_to_the_whole_run(scenario):
    """A lag as long as the run is the whole run; a short one ends at it and is not far off before."""
    problem = measured(shortened(scenario, 60), np.random.default_rng(5))
    start = disturbed(truth(shortened(scenario, 60), problem), scenario.layout, np.random.default_rng(6))
    whole = smooth(problem, start)
    full = smooth_fixed_lag(problem, start, lag=100, iterations=4)
    np.testing.assert_allclose(full.agent_mean, whole.agent_mean, atol=2e-4)
    np.testing.assert_allclose(full.agent_covariance, whole.agent_covariance, rtol=1e-2, atol=1e-6)
    short = smooth_fixed_lag(problem, start, lag=8)
    np.testing.assert_allclose(short.agent_mean[-1, :2], whole.agent_mean[-1, :2], atol=0.03)
    assert np.all(
        np.trace(short.agent_covariance[:, :2, :2], axis1=1, axis2=2)
        >= 0.97 * np.trace(whole.agent_covariance[:, :2, :2], axis1=1, axis2=2) - 1e-6
    )
    gap = short.agent_mean[:, :2] - whole.agent_mean[:, :2]
    spread = np.sqrt(np.trace(short.agent_covariance[:, :2, :2], axis1=1, axis2=2))
    assert np.all(np.linalg.norm(gap, axis=1) < 3.0 * spread + 0.01)


def test_bad_problems_are_named(scenario):
    """Missing reference wall, factors out of range, shapes, lags, starts."""
    problem = measured(shortened(scenario, 5), None)
    at = truth(shortened(scenario, 5), problem)
    with pytest.raises(InputError, match="the first one sensed"):
        replace(problem, sensed=(None, *problem.sensed[1:]))
    with pytest.raises(InputError, match="paths.feature: expected numbers from 0 to 30, got"):
        replace(problem, paths=replace(problem.paths, feature=problem.paths.feature + 31))
    with pytest.raises(InputError, match="ascending"):
        replace(problem, time_s=problem.time_s[::-1])
    with pytest.raises(InputError, match="std_m: expected shape"):
        replace(problem.paths, std_m=np.ones(2))
    with pytest.raises(InputError, match="positive standard deviations"):
        replace(problem.paths, std_m=-problem.paths.std_m)
    with pytest.raises(InputError, match="start: expected agent"):
        smooth(problem, Trajectory(at.agent[:3], at.still))
    with pytest.raises(InputError, match="finite"):
        smooth(problem, Trajectory(at.agent * np.nan, at.still))
    with pytest.raises(ConfigurationError, match="lag, iterations"):
        smooth_fixed_lag(problem, at, lag=0)
