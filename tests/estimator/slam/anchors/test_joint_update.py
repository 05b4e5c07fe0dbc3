"""Hypotheses that have located an anchor, against a dense Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.anchors.branching import branch_hypotheses
from estimator.slam.anchors.joint_update import BranchLimits, PlacePaths, updated, weigh_labellings
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.state_vector import Layout
from tests.estimator.slam.anchors.scenes import ANCHOR, WALLS

LAYOUT = Layout(2, 4)
WIDE = BranchLimits(1e9, 10**9, 10**9)
CLUTTER = 0.02


def hypotheses(count: int = 3, seed: int = 1, located: bool = False, common: bool = False) -> Hypotheses:
    """Hypotheses that know the walls and, if ``located``, anchor 1 at some other place."""
    rng = np.random.default_rng(seed)
    size = LAYOUT.size
    mean = np.zeros((count, size))
    mean[:, :2] = rng.normal(0.0, 0.1, (count, 2))
    mean[:, LAYOUT.walls] = WALLS.ravel() + rng.normal(0.0, 0.3, (count, 8))
    root = rng.normal(0.0, 0.1, (count, size, size))
    covariance = root @ root.transpose(0, 2, 1) / size + 1e-4 * np.eye(size)
    for k in range(2):
        mean[:, LAYOUT.anchor(k)] = [5.0, -4.0, 1.0, 0.2]
        if not (located and k == 1):
            place = LAYOUT.anchor_xy(k)
            covariance[:, place, :] = 0.0
            covariance[:, :, place] = 0.0
    biases = [LAYOUT.bias(0), LAYOUT.bias(1)]
    if common:
        covariance[:, biases, :] = 0.0
        covariance[:, :, biases] = 0.0
        covariance[np.ix_(range(count), biases, biases)] = 0.25
    marks = np.zeros((count, 2), dtype=bool)
    marks[:, 1] = located
    return Hypotheses(
        -np.arange(count, dtype=float),
        mean,
        covariance,
        marks,
        np.ones((count, 4), dtype=bool),
        np.zeros((count, 2, LAYOUT.features)),
        np.zeros((count, 4), dtype=np.int64),
    )


def places() -> PlacePaths:
    """Two places of anchor 1 and five labellings of four paths."""
    label = np.array([[0, 1, 2, -1, 3], [0, 2, 1, -1, -1], [-1, -1, 0, -1, -1], [1, 0, -1, 2, 3], [-1] * 5])
    length = np.array([14.0, 30.3, 41.0, 40.1])
    return PlacePaths(
        np.array([ANCHOR, [9.0, -5.0]]),
        np.array([0.2, 0.9]),
        np.array([9.0, 4.0]),
        np.array([-1.0, 3.0]),
        np.array([3.0, 2.0]),
        np.array([0, 0, 0, 1, 1]),
        np.array([0, 3, 5]),
        label,
        np.array([-1, 0, 1, 2, 3]),
        length,
        np.array([0.01, 0.02, 0.03, 0.04]),
        CLUTTER,
    )


def length_of(mean: np.ndarray, wall: int) -> complex:
    """The path of anchor 1 over a wall or none, in complex numbers too."""
    source, height2, bias = mean[LAYOUT.anchor_xy(1)], mean[LAYOUT.height2(1)], mean[LAYOUT.bias(1)]
    if wall >= 0:
        vrp = mean[LAYOUT.wall(wall)]
        source = source + (1.0 - 2.0 * np.sum(source * vrp) / np.sum(vrp * vrp)) * vrp
    slanted = np.sqrt(np.sum((mean[:2] - source) ** 2) + height2)
    return (1.0 + mean[LAYOUT.scale(1)]) * slanted + bias


def dense(base: Hypotheses, r: int, v: int, std: float = 10.0):
    """Kalman update of hypothesis ``r`` by labelling ``v``: mean, covariance, log density over clutter's."""
    given = places()
    mean, covariance = base.mean[r].copy(), base.covariance[r].copy()
    s, xy = int(given.candidate[v]), LAYOUT.anchor_xy(1)
    shift, b = given.bias_m[s] - mean[LAYOUT.bias(1)], LAYOUT.bias(1)
    mean[LAYOUT.bias(0)] += covariance[LAYOUT.bias(0), b] / covariance[b, b] * shift
    mean[b] += shift
    if given.height2_variance_m4[s] >= 0.0:
        mean[LAYOUT.height2(1)] = given.height2_m2[s]
        w = LAYOUT.height2(1)
        covariance[w, w] = given.height2_variance_m4[s]
    mean[xy], covariance[xy, xy] = given.place_m[s], std**2 * np.eye(2)
    known = [(int(given.wall[c]), j) for c, j in enumerate(given.label[v].tolist()) if j >= 0]
    if not known:
        return mean, covariance, 0.0
    jacobian = np.zeros((len(known), LAYOUT.size))
    for i, (wall, _) in enumerate(known):
        for n in range(LAYOUT.size):
            step = mean.astype(complex)
            step[n] += 1e-20j
            jacobian[i, n] = length_of(step, wall).imag / 1e-20
    index = [j for _, j in known]
    innovation = given.length_m[index] - np.array([length_of(mean, wall) for wall, _ in known])
    s_matrix = jacobian @ covariance @ jacobian.T + np.diag(given.variance_m2[index])
    gain = covariance @ jacobian.T @ np.linalg.inv(s_matrix)
    log_density = -0.5 * (
        np.linalg.slogdet(2.0 * np.pi * s_matrix)[1] + innovation @ np.linalg.solve(s_matrix, innovation)
    ) - len(known) * np.log(CLUTTER)
    return mean + gain @ innovation, covariance - gain @ jacobian @ covariance, log_density


def branched(base: Hypotheses, limits: BranchLimits = WIDE, given: PlacePaths | None = None) -> Hypotheses:
    """The children of hypotheses that locate anchor 1."""
    members, given = np.arange(base.number), places() if given is None else given
    fresh = np.linspace(0.1, 0.9, LAYOUT.features)
    return branch_hypotheses(base, members, LAYOUT, 1, given, 10.0, (1.0, 2.0), fresh, limits)


def test_children_are_those_of_a_dense_kalman_filter():
    """A wrong derivative or gain would tie anchor and walls together wrongly for the rest of the run."""
    base = hypotheses()
    children = branched(base)
    assert len(children.log_weight) == 15
    expected = {}
    for r in range(3):
        for s, labels in ((0, (0, 1, 2)), (1, (3, 4))):
            density = np.array([dense(base, r, v)[2] for v in labels])
            share = density - np.log(np.sum(np.exp(density - density.max()))) - density.max()
            for v, own in zip(labels, share, strict=True):
                expected[base.log_weight[r] + places().log_evidence[s] + own] = (r, v)
    weights = sorted(expected, reverse=True)
    np.testing.assert_allclose(children.log_weight, weights, atol=1e-8)
    for i, weight in enumerate(weights):
        mean, covariance, _ = dense(base, *expected[weight])
        np.testing.assert_allclose(children.mean[i], mean, atol=1e-8)
        np.testing.assert_allclose(children.covariance[i], covariance, atol=1e-8)
        np.testing.assert_array_equal(children.covariance[i], children.covariance[i].T)
    assert children.located[:, 1].all()
    assert not children.located[:, 0].any()
    assert not base.located.any()
    np.testing.assert_allclose(
        children.visibility[:, 1], np.linspace(0.1, 0.9, LAYOUT.features)[None].repeat(15, 0)
    )


def test_what_was_known_of_a_place_goes_with_it():
    """A rival place must not inherit what the old one told of walls and height."""
    base = hypotheses(located=True)
    children = branched(base)
    xy, w = LAYOUT.anchor_xy(1), LAYOUT.height2(1)
    silent = int(np.argmin(np.abs(children.covariance[:, xy, xy][:, 0, 0] - 100.0)))  # no path is labelled
    assert children.covariance[silent, w, w] == pytest.approx(3.0)  # as the place says
    assert children.mean[silent, w] == pytest.approx(4.0)
    assert not children.covariance[silent, xy.start, xy.stop :].any()
    planar = branched(base, given=places()._replace(height2_variance_m4=np.full(2, -1.0)))
    silent = int(np.argmin(np.abs(planar.covariance[:, xy, xy][:, 0, 0] - 100.0)))
    assert planar.covariance[silent, w, w] == pytest.approx(4.0)  # as the prior says
    assert planar.mean[silent, w] == pytest.approx(1.0)


def test_clocks_that_agree_move_together():
    """Where a place tells the clock of one anchor, it tells those that are the same clock."""
    base = hypotheses(count=1, common=True)
    silent = branched(base)
    far = silent.mean[np.argmax(silent.covariance[:, LAYOUT.anchor_xy(1).start, LAYOUT.anchor_xy(1).start])]
    assert far[LAYOUT.bias(0)] == pytest.approx(far[LAYOUT.bias(1)])


@pytest.mark.parametrize("nats", [0.5, 3.0, 12.0])
def test_only_children_are_dropped_that_the_reduction_would_drop(nats):
    """Pruning before the update saves time and must change nothing."""
    base = hypotheses(count=6)
    every, some = branched(base), branched(base, WIDE._replace(prune_nats=nats))
    best = max(base.log_weight.max(), every.log_weight.max())
    assert len(some.log_weight) == np.count_nonzero(every.log_weight > best - nats)
    np.testing.assert_array_equal(some.mean, every.mean[: len(some.log_weight)])


def test_caps_keep_the_likeliest():
    """Beyond the caps the work stops, at the unlikely end."""
    base = hypotheses(count=6)
    every = branched(base)
    np.testing.assert_array_equal(branched(base, WIDE._replace(max_branches=4)).mean, every.mean[:4])
    few = branched(base, WIDE._replace(max_labelled=6))
    assert len(few.log_weight) == 5  # those of two places: a third would be beyond
    assert few.log_weight[0] == every.log_weight[0]


def test_labellings_are_weighed_up_to_the_bound():
    """What was not weighed says so, and is not taken for likely."""
    base, given = hypotheses(count=2), places()
    weight = np.full((2, 5), -np.inf)
    limits = WIDE._replace(max_labelled=3)
    order = np.array([0, 1, 2, 3])
    weigh_labellings(
        LAYOUT, 1, base.log_weight, base.mean, base.covariance, given, order, 0.0, limits, weight
    )
    assert np.isfinite(weight).tolist() == [[True] * 3 + [False] * 2, [False] * 5]


def test_no_child_is_no_array():
    """Nothing to make is made without an error."""
    base = hypotheses()
    none = np.zeros(0, dtype=np.int64)
    mean, covariance = updated(LAYOUT, 1, base.mean, base.covariance, places(), none, none)
    assert mean.shape == (0, LAYOUT.size)
    assert covariance.shape == (0, LAYOUT.size, LAYOUT.size)
