"""Maps get their ends: corners, the end of a wall that nothing meets, and walls that nobody mapped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.twin.build import TwinConfig, build_twin
from estimator.twin.stretches import corner_std
from raytrace.plan.files import load_floorplan
from tests.mapped_runs import mapped_run

MAPPED = ["west", "south", "east", "north-right", "north-left"]


@pytest.fixture(scope="module")
def l_room():
    """The L-shaped room, mapped but for its inner edge; some double bounces are mistaken."""
    plan = load_floorplan("l-room")
    result, measurements = mapped_run(plan, np.random.default_rng(1), 1, MAPPED, mistaken=0.1)
    return plan, result, measurements, build_twin(result, measurements)


def test_corners_are_those_of_the_room(l_room):
    """Every closed end lies at a corner of the plan, whatever double bounces say."""
    plan, _, _, twin = l_room
    corners = np.concatenate(plan.walls_m()) - plan.track()[0, :2]
    closed = [(w.ends_m[e], w.std_m[e]) for w in twin.walls for e in (0, 1) if w.kinds[e] == "corner"]
    assert len(closed) == 8
    for end, std in closed:
        assert np.linalg.norm(corners - end, axis=1).min() < 1e-6
        assert 0.0 < std < 0.05


def test_the_missing_wall_is_assumed(l_room):
    """Two open ends that face each other are joined at right angles, where the inner edge is."""
    plan, _, _, twin = l_room
    (wall,) = [w for w in twin.walls if w.line < 0]
    ends = wall.ends_m + plan.track()[0, :2]
    np.testing.assert_allclose(ends[np.argsort(ends[:, 1])], [[50.0, 40.0], [50.0, 60.0]], atol=0.25)
    assert wall.kinds == ("assumed", "assumed")


def test_paths_that_contradict_a_wall_leave_the_gap_open(l_room):
    """Where the assumed wall should have been heard and was not, there is none."""
    _, result, measurements, _ = l_room
    silent = [
        replace(epoch, paths=tuple(_without_edge(p, t, k, result) for k, p in enumerate(epoch.paths)))
        for t, epoch in enumerate(measurements.epochs)
    ]
    twin = build_twin(result, replace(measurements, epochs=tuple(silent)))
    assert not [w for w in twin.walls if w.line < 0]
    assert sum(w.kinds[e] == "open" for w in twin.walls for e in (0, 1)) == 2


def _without_edge(paths, t, k, result):
    """An anchor's paths without those that were given to no feature."""
    joint = result.joint
    kept = joint.path_number[(joint.path_epoch == t) & (joint.path_anchor == k)]
    rest = np.setdiff1d(np.arange(len(paths)), kept)
    delay = paths.delay_s.copy()
    delay[rest] = 5e-7 + 1e-9 * np.arange(len(rest))  # elsewhere: numbers of the others stay
    return replace(paths, delay_s=delay)


def test_gains_tell_offsets(l_room):
    """An anchor that sends 3 dB more is told by its lines of sight, and taken off all losses."""
    plan, _, _, plain = l_room
    result, measurements = mapped_run(plan, np.random.default_rng(2), 4, MAPPED, offset_db=3.0)
    assert [anchor.offset_db for anchor in build_twin(result, measurements).anchors] == [
        0.0,
        0.0,
    ]  # calibrated
    twin = build_twin(result, measurements, TwinConfig(gain_offset_std_db=5.0))
    for anchor in twin.anchors:
        assert anchor.offset_db == pytest.approx(3.0, abs=5.0 * anchor.offset_std_db)
        assert anchor.offset_std_db < 0.05
    for losses in (twin.bounces.loss_db, plain.bounces.loss_db):
        assert 5.0 < np.median(losses) < 9.0


def test_anchors_stand_where_they_are(l_room):
    """Places and heights are taken over."""
    plan, _, _, twin = l_room
    for anchor, true in zip(twin.anchors, plan.anchors_m(), strict=True):
        np.testing.assert_allclose(anchor.position_m, true[:2] - plan.track()[0, :2])
        assert anchor.height_m == pytest.approx(true[2] - plan.agent.height_m)


def test_corner_deviations_are_those_of_drawn_maps():
    """Against the scatter of corners of maps drawn from the covariance."""
    vrps, rng = np.array([[8.0, 1.0], [-2.0, 10.0]]), np.random.default_rng(3)
    root = 0.01 * rng.normal(size=(4, 4))
    drawn = vrps.ravel() + rng.normal(size=(4000, 4)) @ root.T
    corners = np.array(
        [np.linalg.solve(v.reshape(2, 2), 0.5 * np.sum(v.reshape(2, 2) ** 2, axis=1)) for v in drawn]
    )
    scatter = np.sqrt(np.linalg.eigvalsh(np.cov(corners.T))[-1])
    assert corner_std(vrps, root @ root.T, 0, 1) == pytest.approx(scatter, rel=0.05)


def test_results_of_filters_are_refused(l_room):
    """A result that was not smoothed has no evidence."""
    _, result, measurements, _ = l_room
    with pytest.raises(InputError, match="expected a smoothed run"):
        build_twin(replace(result, joint=None), measurements)
    with pytest.raises(InputError, match="expected 236 epochs"):
        build_twin(result, replace(measurements, epochs=measurements.epochs[:5]))


def test_doors_are_openings():
    """Of an office, with what sweeps see: every wall, and its doors within centimetres."""
    plan = load_floorplan("office")
    result, measurements = mapped_run(plan, np.random.default_rng(1), 1, sweeps=True)
    twin = build_twin(result, measurements)
    start = plan.track()[0, :2]
    jambs = [w.ends_m[e] + start for w in twin.walls for e in (0, 1) if w.kinds[e] == "open"]
    true = np.concatenate(plan.walls_m())
    assert len(jambs) == 14  # of seven doors
    assert max(np.linalg.norm(true - end, axis=1).min() for end in jambs) < 0.1
    outer = [w for w in twin.walls if w.length_m > 13.0]
    assert len(outer) == 4
    assert {len(w.cuts_m) for w in outer} == {2, 3}


def test_walls_that_nobody_walked_through_stand(l_room):
    """The agent's own way opens walls, whatever else was heard."""
    _, result, measurements, _ = l_room
    moved = result.agent_mean.copy()
    moved[100:104, 1] = [-10.0, -14.0, -16.0, -14.0]  # through the south wall and back
    twin = build_twin(replace(result, agent_mean=moved), measurements)
    south = [w for w in twin.walls if w.line >= 0 and np.allclose(w.ends_m[:, 1], -15.0, atol=0.01)]
    assert len(south) >= 2
