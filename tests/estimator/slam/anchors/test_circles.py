"""Circles: images of the agent, pairs of walls that a path can meet, intersections."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.anchors.circles import image_circles, intersect, met_wall_pairs
from estimator.slam.anchors.likelihood import walls_between
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import Layout
from tests.estimator.slam.anchors.scenes import ANCHOR, SPREAD, WALLS, mirrored


def circles_at(agents, pairs=((0, 1), (2, 3))):
    """Circles of some positions with known pairs."""
    return image_circles(
        np.array(agents, dtype=float),
        np.tile(0.5 * np.eye(2), (len(agents), 1, 1)),
        np.full(len(agents), 0.04),
        WALLS,
        SPREAD,
        np.array(pairs, dtype=np.int64).reshape(-1, 2),
        4.0,
    )


def test_an_image_of_the_agent_is_as_far_as_the_path_is_long():
    """A wrong mirror, or walls of a pair in the wrong order, would put all circles elsewhere."""
    agent = np.array([3.0, -2.0])
    circles = circles_at([(0.0, 0.0), agent])
    distance = np.hypot(ANCHOR[0] - circles.x[1], ANCHOR[1] - circles.y[1])
    sources = [ANCHOR, *(mirrored(ANCHOR, wall) for wall in WALLS)]
    sources += [mirrored(mirrored(ANCHOR, WALLS[near]), WALLS[far]) for near, far in ((0, 1), (2, 3))]
    np.testing.assert_allclose(distance, [np.linalg.norm(agent - source) for source in sources], atol=1e-9)


def test_errors_of_agent_and_walls_add_up():
    """Without a wall's error its circle would be believed too well, and the true place not reached."""
    circles = circles_at([(0.0, 0.0)])
    expected = [0.5, 0.51, 0.52, 0.53, 0.54, 0.53, 0.57]
    np.testing.assert_allclose(circles.xx[0], expected)
    np.testing.assert_allclose(circles.yy[0], expected)
    assert not circles.xy.any()


def test_centres_move_with_the_agent_as_they_say():
    """A place surveyed from them would be tied to the track the wrong way round."""
    still, small = np.array([2.0, 1.0]), 1e-6
    circles = circles_at([still, still + [small, 0.0], still + [0.0, small]])
    for axis in (0, 1):
        dx, dy = circles.x[1 + axis] - circles.x[0], circles.y[1 + axis] - circles.y[0]
        moved = np.stack([dx, dy], axis=1) / small
        np.testing.assert_allclose(circles.by_agent[:, :, axis], moved, atol=1e-6)


def test_no_direction_is_wider_than_the_reach():
    """A reach too small would lose paths before they are compared with the gate."""
    spread = np.array([[[0.5, 0.3], [0.3, 0.2]]] * 4)
    circles = image_circles(
        np.zeros((1, 2)),
        np.zeros((1, 2, 2)),
        np.array([0.04]),
        WALLS,
        spread,
        np.zeros((0, 2), dtype=np.int64),
        3.0,
    )
    turn = np.linspace(0.0, np.pi, 181)
    along = np.stack([np.cos(turn), np.sin(turn)])
    widest = np.max(np.einsum("it,ij,jt->t", along, spread[0], along))
    assert circles.reach_m[0, 1] == pytest.approx(3.0 * np.sqrt(widest + 0.04), rel=1e-3)
    assert circles.reach_m[0, 0] == pytest.approx(0.6, rel=1e-6)


def walls_round(count, seed):
    """Walls on all sides, (VRPs, distances)."""
    rng = np.random.default_rng(seed)
    turn, offset = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(10.0, 60.0, count)
    return 2.0 * offset[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1), offset


def test_few_walls_bounce_in_all_orders():
    """Of a pair left out the paths would count as clutter, and false places explain them better."""
    pairs = met_wall_pairs(np.zeros((1, 2)), WALLS, 1.0, 12)
    assert {tuple(pair) for pair in pairs.tolist()} == {(i, j) for i in range(4) for j in range(4) if i != j}


@pytest.mark.parametrize("seed", range(4))
def test_of_many_pairs_those_stay_that_anchors_in_the_room_show(seed):
    """The cap bounds every later stage; what it keeps first are bounces inside the room."""
    walls, _ = walls_round(7, seed)
    layout, rng, shown = Layout(1, 7), np.random.default_rng(seed), set()
    for x, y in rng.uniform(-60.0, 60.0, (500, 2)):
        if walls_between(x, y, walls):
            continue
        mean = np.zeros(layout.size)
        mean[layout.anchor_xy(0)], mean[layout.walls] = (x, y), walls.ravel()
        possible = np.asarray(predict_paths(mean[None], layout).possible)[0, 0, 8:].reshape(7, 7)
        shown |= set(zip(*(index.tolist() for index in np.nonzero(possible)), strict=True))
    assert 0 < len(shown) < 42
    pairs = met_wall_pairs(np.zeros((1, 2)), walls, 0.0, 41)
    kept = {tuple(pair) for pair in pairs.tolist()}
    assert shown <= kept
    assert len(kept) == 41


def test_of_many_pairs_those_of_short_paths_stay():
    """The paths of what is left out are the longest, and so the weakest."""
    walls, offset = walls_round(12, 5)
    normal = walls / (2.0 * offset[:, None])

    def shortest(pairs):
        image = [mirrored(np.zeros(2), walls[far]) @ normal[near] - offset[near] for near, far in pairs]
        return np.array([-gap if gap < 0.0 else np.inf for gap in image])  # inf: seen from outside only

    few = shortest(met_wall_pairs(np.zeros((1, 2)), walls, 0.0, 10))
    every = shortest([(i, j) for i in range(12) for j in range(12) if i != j])
    np.testing.assert_allclose(np.sort(few), np.sort(every)[:10])


def test_circles_meet_on_both_of_them():
    """Points that lie on one circle only would be seeds of nothing."""
    x0, y0, x1, y1 = intersect(1.0, 2.0, 5.0, 6.0, -1.0, 4.0, 1.0)
    for x, y in ((x0, y0), (x1, y1)):
        assert np.hypot(x - 1.0, y - 2.0) == pytest.approx(5.0)
        assert np.hypot(x - 6.0, y + 1.0) == pytest.approx(4.0)
    assert np.hypot(x0 - x1, y0 - y1) > 1.0


@pytest.mark.parametrize(("gap", "meet"), [(0.05, True), (1.0, False)])
def test_circles_that_nearly_touch_touch(gap, meet):
    """Noise parts circles that should touch; those far apart must not meet."""
    x0, *_ = intersect(0.0, 0.0, 3.0, 8.0 + gap, 0.0, 5.0, 1.0)
    assert np.isfinite(x0) == meet


def test_circles_of_one_centre_never_meet():
    """They would divide by zero."""
    assert all(np.isnan(intersect(1.0, 1.0, 3.0, 1.0, 1.0, 3.0, 1.0)))
