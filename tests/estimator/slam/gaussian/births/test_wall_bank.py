"""New walls: banks of bearings, and what speaks against them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from estimator.geometry import mirror
from estimator.slam.gaussian.births.config import Births
from estimator.slam.gaussian.births.lines import Line
from estimator.slam.gaussian.births.wall_bank import Known, wall_bank
from estimator.slam.models.state_vector import Layout

CONFIG = Births()
PRUNE, RADIUS = 12.0, 3.0
TRUE = np.array([0.0, 90.0])  # the wall y = 45
TRACK = np.stack([25.0 + 0.5 * np.arange(12), np.full(12, -2.0)], axis=1)
NOTHING, NO_LEGS = np.empty((0, 2)), np.empty((0, 2, 2))


def line_of(anchor, rng=None):
    """The anchor's paths over the true wall, heard along the track; with errors if there is a generator."""
    length = np.linalg.norm(TRACK - mirror(np.asarray(anchor), TRUE), axis=1)
    if rng is not None:
        length = length + 0.1 * rng.normal(size=len(TRACK))
    number = np.arange(len(TRACK))
    return Line(0, number, number, length, np.full(len(TRACK), 0.1))


def bank_of(anchor, legs=NO_LEGS, walls=NOTHING, extents=NOTHING, track=TRACK, seed=5):
    """Places of the wall."""
    line = line_of(anchor, np.random.default_rng(seed))
    device = np.array([*anchor, 0.0, 0.0])
    std = np.full(len(TRACK), 0.05)
    return wall_bank(line, track, std, device, Known(walls, extents, legs), CONFIG, PRUNE, RADIUS)


@pytest.mark.parametrize("distance", [40.0, 10.0, 4.0])
def test_the_bank_is_fine_enough_for_anchors_near_the_wall(distance):
    """However near the anchor is, a member lies within the radius in which two walls are one."""
    bank = bank_of((55.0, 45.0 - distance))
    nearest = np.linalg.norm(bank.mean_m - TRUE, axis=1)
    assert nearest.min() < RADIUS
    assert bank.log_weight[np.argmin(nearest)] > -PRUNE
    # each member covers the way to the next: within two of its standard deviations
    order = np.argsort(np.arctan2(bank.mean_m[:, 1], bank.mean_m[:, 0]))
    for one, other in pairwise(order.tolist()):
        step = bank.mean_m[other] - bank.mean_m[one]
        if np.linalg.norm(step) < 2.0 * RADIUS:
            cover = bank.covariance_m2[one] + bank.covariance_m2[other]
            assert step @ np.linalg.solve(cover, step) < 4.0


def test_an_epoch_at_which_the_agent_was_thought_elsewhere_decides_nothing():
    """With its mirror image in the track of the bank for one epoch, the wall stays as likely as without."""
    astray = TRACK.copy()
    astray[1] += (-2.5, 3.9)
    for track in (TRACK, astray):
        bank = bank_of((55.0, 35.0), track=track, seed=6)
        near = np.linalg.norm(bank.mean_m - TRUE, axis=1) < RADIUS
        assert near.any()
        assert bank.log_weight[near].max() > -3.0


def test_paths_heard_leave_no_room_for_a_wall_across_them():
    """The mirror image of the wall about the track goes once two heard paths cross it; one may be clutter."""
    anchor = (55.0, 40.0)
    bank = bank_of(anchor)
    behind = bank.mean_m[:, 1] < 0.0  # a straight track cannot tell the wall from one on its other side
    assert behind.any()
    x = TRACK[5, 0] + 1.5
    leg = np.array([[x, -2.0], [x, -40.0]])
    assert (bank_of(anchor, np.array([leg])).mean_m[:, 1] < 0.0).sum() == behind.sum()
    fewer = bank_of(anchor, np.array([leg, leg + 0.01]))
    assert (fewer.mean_m[:, 1] < 0.0).sum() < behind.sum()
    assert np.linalg.norm(fewer.mean_m - TRUE, axis=1).min() < RADIUS


def test_known_walls_hide_others_where_they_reflect_not_beyond():
    """A wall between is an obstacle along the stretch that reflects, and not at its very end."""
    between = np.array([[0.0, 50.0]])  # the wall y = 25
    covering, ending = np.array([[-80.0, 80.0]]), np.array([[-40.9, 80.0]])
    hidden = bank_of((55.0, 40.0), walls=between, extents=covering)
    assert hidden is None or np.all(hidden.mean_m[:, 1] < 45.0)
    found = bank_of((55.0, 40.0), walls=between, extents=ending)
    assert np.linalg.norm(found.mean_m - TRUE, axis=1).min() < RADIUS


def test_a_known_wall_is_not_born_again():
    """Nothing within the radius of a wall that is there."""
    bank = bank_of((55.0, 40.0), walls=TRUE[None], extents=np.array([[np.inf, -np.inf]]))
    assert bank is None or np.linalg.norm(bank.mean_m - TRUE, axis=1).min() > RADIUS


def test_a_new_wall_has_the_errors_of_agent_and_anchor():
    """The derivatives of its places are differences of banks of a shifted track, anchor, height and clock."""
    anchor, step = np.array([55.0, 35.0]), 1e-4
    line, std, known = line_of(anchor), np.full(len(TRACK), 0.05), Known(NOTHING, NOTHING, NO_LEGS)

    def bank(shift, device):
        device = np.array([*anchor, 1.0, 0.0]) + device
        return wall_bank(line, TRACK + shift, std, device, known, CONFIG, PRUNE, RADIUS)

    def slope(shift, device):
        ahead, behind = bank(shift, device), bank(-shift, -device)
        return (ahead.mean_m - behind.mean_m) / (2.0 * step)

    here = bank(np.zeros(2), np.zeros(4))
    for i, axis in enumerate(step * np.eye(2)):
        np.testing.assert_allclose(here.by_agent[:, :, i], slope(axis, np.zeros(4)), atol=1e-3)
    for i, axis in enumerate(step * np.eye(4)):
        np.testing.assert_allclose(here.by_device[:, :, i], slope(np.zeros(2), axis), atol=0.03)
    layout = Layout(2, 1)
    jacobian = here.jacobian(layout, 1)
    assert np.array_equal(jacobian[:, :, layout.anchor(1)], here.by_device)
    assert np.array_equal(jacobian[:, :, :2], here.by_agent)
    assert not jacobian[:, :, layout.anchor(0)].any()
