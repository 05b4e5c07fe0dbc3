"""Paths over several walls, and walls that they were taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimator.slam.features import reflect
from estimator.slam.gaussian.multiples import multiple_lengths, redundant_walls
from scipy.optimize import minimize

from estimator.measurements import GaussianVrp
from estimator.slam import GaussianConfig, run_slam
from estimator.slam.gaussian.slots import open_slot, retire
from estimator.slam.gaussian.start import start

CONFIG = GaussianConfig()
ROOM = np.array([[-20.0, 0.0], [60.0, 0.0], [0.0, -30.0], [0.0, 50.0]])  # VRPs: 40 m by 40 m round RP
DEVICE = np.array([22.0, 11.0, 1.0, 0.3])  # place, squared height difference, clock bias
AGENT = np.array([[5.0, -4.0], [9.0, 3.0]])


def shortest(agent, walls):
    """Length of the shortest way from the agent over all lines (from the anchor) to the anchor, by search."""
    normal = walls / np.linalg.norm(walls, axis=1, keepdims=True)
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)

    def length(at):
        corners = np.concatenate([DEVICE[None, :2], 0.5 * walls + at[:, None] * along, agent[None]])
        return np.sum(np.linalg.norm(np.diff(corners, axis=0), axis=1))

    return minimize(length, np.zeros(len(walls)), method="BFGS").fun


def test_lengths_of_double_and_triple_bounces_are_shortest_ways():
    """The image of an image of an image is as far as light goes; a wrong order of mirrors is metres off."""
    for walls in (ROOM[[0, 2]], ROOM[[1, 3]]):
        lengths = multiple_lengths(AGENT, DEVICE, walls)
        assert lengths.shape == (2, 4)  # over (a, b), (b, a), (a, b, a), (b, a, b)
        for agent, own in zip(AGENT, lengths, strict=True):
            flat = min(
                shortest(agent, walls), shortest(agent, walls[::-1])
            )  # the other way leads to the corner
            both = np.sqrt(flat**2 + DEVICE[2]) + DEVICE[3]
            assert own[np.isfinite(own)] == pytest.approx(both, abs=1e-4)
            assert np.isfinite(own).sum() == 1  # of the two orders, one is possible; no beam bounces a, b, a
    opposite = multiple_lengths(AGENT, DEVICE, ROOM[:2])
    there_and_back = shortest(AGENT[0], ROOM[[0, 1, 0]])
    assert opposite[0, 2] == pytest.approx(np.sqrt(there_and_back**2 + 1.0) + 0.3, abs=1e-4)
    assert multiple_lengths(AGENT, DEVICE, ROOM[:1]).shape == (2, 0)


def deceived(order=(0, 2), also=()):
    """A state in a room of four walls, in which a double bounce has become a fifth.

    The other ``also`` anchors have heard that wall, too.
    """
    walls = tuple(GaussianVrp(vrp, 0.01 * np.eye(2)) for vrp in ROOM)
    state = start(walls, ("a", "b"), 28e9, CONFIG)
    layout, rows = state.layout, state.rows
    turn = np.array([np.cos(state.bearing_rad), np.sin(state.bearing_rad)])
    turn = np.array([[turn[0], turn[1]], [-turn[1], turn[0]]])  # into the gauge frame
    anchors = [np.array([22.0, 11.0]), np.array([3.0, 20.0])]
    for k, anchor in enumerate(anchors):
        rows.mean[0, layout.anchor(k)] = *(turn @ anchor), 1.0, 0.0
    rows.located[:] = True
    state, slot = open_slot(replace(state, epoch=0))
    image = anchors[0]
    for wall in order:
        image = reflect(image, ROOM[wall])
    chord = image - anchors[0]
    vrp = (image @ image - anchors[0] @ anchors[0]) / (chord @ chord) * chord
    state.rows.mean[0, state.layout.wall(slot)] = turn @ vrp
    state.rows.present[0, slot] = True
    state.slots.wall_id[slot], state.slots.born[slot], state.slots.confirmed[slot] = 4, 20, True
    for k in (0, *also):
        state.slots.heard_from_m[slot, k] = AGENT @ turn.T
    return state, slot


def test_a_wall_that_bounces_over_others_explain_goes():
    """A double bounce over two known walls was taken for a wall: it is seen through, and taken out."""
    state, slot = deceived()
    assert np.flatnonzero(redundant_walls([state], CONFIG)[0]).tolist() == [slot]
    (after,) = retire([state], CONFIG)
    assert after.slots.wall_id[slot] == -1
    assert np.isnan(after.slots.heard_from_m[slot]).all()
    assert not after.rows.present[:, slot].any()
    assert after.rows.present[:, :4].all()


def test_a_wall_that_another_anchor_heard_stays():
    """Double bounces of two anchors are never as long as single ones off one wall: what both hear is it."""
    state, slot = deceived(also=(1,))
    assert not redundant_walls([state], CONFIG).any()
    assert retire([state], CONFIG)[0].slots.wall_id[slot] == 4


def test_the_wall_behind_the_deception_stays():
    """What a true wall explains fits bounces over the deceiving wall and another, but no beam takes them."""
    state, slot = deceived()
    state.slots.born[2], state.slots.heard_from_m[2] = 30, state.slots.heard_from_m[slot]  # found on the way
    state.slots.heard_from_m[2, 1] = np.nan
    assert np.flatnonzero(redundant_walls([state], CONFIG)[0]).tolist() == [slot]


def test_walls_of_the_first_sweep_are_not_doubted():
    """A wall that flashed in the sweep is there, whatever else is as long."""
    state, slot = deceived()
    state.slots.born[slot] = -1
    assert not redundant_walls([state], CONFIG).any()


def test_a_room_full_of_double_bounces_holds_no_wall_of_them(room):
    """Without powers, a double bounce over an unknown wall is taken for a wall; with that found, it goes."""
    measured = room.measure(1, 95, order=2, range_std_m=0.03, clutter_mean=0.5)
    result = run_slam(measured)
    nearest = np.linalg.norm(result.wall_mean_m[:, :, None] - room.vrps, axis=-1).min(axis=-1)
    false = result.wall_valid & (nearest > 4.0)
    assert false.any()
    assert not false[-1].any()
    assert result.wall_valid[-1].sum() == 5
