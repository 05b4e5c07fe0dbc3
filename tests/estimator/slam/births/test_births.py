"""New walls: banks of bearings, and what speaks against them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from estimator.slam.births.walls import Line, find_line, wall_bank
from estimator.slam.features import reflect
from estimator.slam.layout import Layout

from estimator.slam import GaussianConfig

CONFIG = GaussianConfig()
TRUE = np.array([0.0, 90.0])  # the wall y = 45
TRACK = np.stack([25.0 + 0.5 * np.arange(12), np.full(12, -2.0)], axis=1)
NOTHING = np.empty((0, 2))
ANY = np.array([np.inf])  # limit of losses


def bank_of(anchor, legs=None, walls=NOTHING, spans=NOTHING):
    """The bank of an anchor's paths over the true wall, heard along the track with errors."""
    image = reflect(np.asarray(anchor)[None], TRUE[None])[0]
    noise = 0.1 * np.random.default_rng(5).normal(size=len(TRACK))
    line = Line(
        0, np.arange(len(TRACK)), np.linalg.norm(TRACK - image, axis=1) + noise, np.full(len(TRACK), 0.1)
    )
    legs = np.empty((0, 2, 2)) if legs is None else legs
    device = np.array([*anchor, 0.0, 0.0])
    return wall_bank(line, TRACK, np.full(len(TRACK), 0.05), device, walls, spans, legs, CONFIG)


@pytest.mark.parametrize("distance", [40.0, 10.0, 4.0])
def test_the_bank_is_fine_enough_for_anchors_near_the_wall(distance):
    """However near the anchor is, a member lies within the radius in which two walls are one."""
    bank = bank_of((55.0, 45.0 - distance))
    nearest = np.linalg.norm(bank.mean_m - TRUE, axis=1)
    assert nearest.min() < CONFIG.confirm_radius_m
    assert bank.log_weight[np.argmin(nearest)] > -CONFIG.prune_nats
    # each member covers the way to the next: within two of its standard deviations
    order = np.argsort(np.arctan2(bank.mean_m[:, 1], bank.mean_m[:, 0]))
    for one, other in pairwise(order.tolist()):
        step = bank.mean_m[other] - bank.mean_m[one]
        if np.linalg.norm(step) < 2.0 * CONFIG.confirm_radius_m:
            cover = bank.covariance_m2[one] + bank.covariance_m2[other]
            assert step @ np.linalg.solve(cover, step) < 4.0


def test_an_epoch_at_which_the_agent_was_thought_elsewhere_decides_nothing():
    """With its mirror image in the track of the bank for one epoch, the wall stays as likely as without."""
    anchor = np.array([55.0, 35.0])
    image = reflect(anchor[None], TRUE[None])[0]
    noise = 0.1 * np.random.default_rng(6).normal(size=len(TRACK))
    line = Line(
        0, np.arange(len(TRACK)), np.linalg.norm(TRACK - image, axis=1) + noise, np.full(len(TRACK), 0.1)
    )
    astray = TRACK.copy()
    astray[1] += (-2.5, 3.9)
    device, std, legs = np.array([*anchor, 0.0, 0.0]), np.full(len(TRACK), 0.05), np.empty((0, 2, 2))
    for track in (TRACK, astray):
        bank = wall_bank(line, track, std, device, NOTHING, NOTHING, legs, CONFIG)
        near = np.linalg.norm(bank.mean_m - TRUE, axis=1) < CONFIG.confirm_radius_m
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
    assert np.linalg.norm(fewer.mean_m - TRUE, axis=1).min() < CONFIG.confirm_radius_m


def test_known_walls_hide_others_where_they_reflect_not_beyond():
    """A wall between is an obstacle along the stretch that reflects, and not at its very end."""
    between = np.array([[0.0, 50.0]])  # the wall y = 25
    covering, ending = np.array([[-80.0, 80.0]]), np.array([[-40.9, 80.0]])
    assert bank_of((55.0, 40.0), walls=between, spans=covering) is None or np.all(
        bank_of((55.0, 40.0), walls=between, spans=covering).mean_m[:, 1] < 45.0
    )
    found = bank_of((55.0, 40.0), walls=between, spans=ending)
    assert np.linalg.norm(found.mean_m - TRUE, axis=1).min() < CONFIG.confirm_radius_m


def test_a_line_needs_support():
    """Ten of eighteen epochs make a line, nine do not; scattered paths never do."""
    epoch = np.arange(18.0)
    points = np.stack(
        [epoch, np.zeros(18), 60.0 - 0.3 * epoch, np.full(18, 0.1), np.full(18, np.nan)], axis=1
    )
    assert find_line(points[8:], 17, ANY, CONFIG).anchor == 0
    assert find_line(points[9:], 17, ANY, CONFIG) is None
    scattered = points.copy()
    scattered[:, 2] = np.random.default_rng(1).uniform(0.0, 180.0, 18)
    assert find_line(scattered, 17, ANY, CONFIG) is None
    assert find_line(points, 17, ANY, replace(CONFIG, birth_support=19)) is None


def test_paths_that_lost_too_much_make_no_line():
    """A path weaker than any single bounce of its anchor starts no wall; one of unknown power may."""
    epoch = np.arange(18.0)
    points = np.stack([epoch, np.ones(18), 60.0 - 0.3 * epoch, np.full(18, 0.1), np.full(18, 9.5)], axis=1)
    assert find_line(points, 17, np.array([20.0, 9.0]), CONFIG) is None
    assert find_line(points, 17, np.array([5.0, 10.0]), CONFIG).anchor == 1
    points[:, 4] = np.nan
    assert find_line(points, 17, np.array([5.0, 5.0]), CONFIG) is not None


def test_a_new_wall_has_the_errors_of_agent_and_anchor():
    """The derivatives of its places are differences of banks of a shifted track, anchor, height and clock."""
    anchor, step = np.array([55.0, 35.0]), 1e-4
    length = np.linalg.norm(TRACK - reflect(anchor[None], TRUE[None])[0], axis=1)
    line = Line(0, np.arange(len(TRACK)), length, np.full(len(TRACK), 0.1))

    def bank(shift, device):
        device = np.array([*anchor, 1.0, 0.0]) + device
        std, nothing = np.full(len(TRACK), 0.05), np.empty((0, 2, 2))
        return wall_bank(line, TRACK + shift, std, device, NOTHING, NOTHING, nothing, CONFIG)

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
