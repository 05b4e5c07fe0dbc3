"""The lifecycle of walls: tentative, confirmed, deleted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, GaussianVrp
from estimator.slam import GaussianConfig, run_slam, start
from estimator.slam.gaussian.lifecycle import (
    Lifecycle,
    delete_corners,
    delete_redundant,
    existence_odds,
    judge_tentative,
    prune_confirmed,
)
from estimator.slam.gaussian.slots import close_slot, open_slot
from estimator.slam.models.features import mirror
from estimator.slam.models.path_buffer import Track
from estimator.slam.models.visibility import Visibility
from tests.estimator.slam.conftest import Room
from tests.estimator.slam.gaussian.test_higher_order import AGENT, ROOM, image_of

CONFIG = GaussianConfig()
MODEL, VISIBILITY = Lifecycle(), Visibility()
ANCHORS = np.array([[22.0, 11.0], [3.0, 20.0]])


def entered(vrp, epoch=20, confirmed=False):
    """A room of four sensed walls and one that entered on the way, in one hypothesis; and its slot."""
    walls = tuple(GaussianVrp(wall, 0.01 * np.eye(2)) for wall in ROOM)
    state = start(walls, ("a", "b"), 28e9, CONFIG)
    c, s = np.cos(state.bearing_rad), np.sin(state.bearing_rad)
    turn = np.array([[c, s], [-s, c]])  # into the gauge frame
    for k, anchor in enumerate(ANCHORS):
        state.hypotheses.mean[0, state.layout.anchor(k)] = *(turn @ anchor), 1.0, 0.3
    state.hypotheses.located[:] = True
    state, slot = open_slot(state.but(epoch=epoch), VISIBILITY)
    state.hypotheses.mean[0, state.layout.wall(slot)] = turn @ vrp
    state.hypotheses.covariance[0, state.layout.wall(slot), state.layout.wall(slot)] = 0.01 * np.eye(2)
    state.hypotheses.present[0, slot] = True
    state.slots.wall_id[slot], state.slots.born[slot], state.slots.confirmed[slot] = 4, epoch, confirmed
    track = Track(np.arange(epoch), np.zeros((epoch, 2)), np.full(epoch, 0.1))
    return state.but(next_wall_id=5, buffer=state.buffer._replace(track=track)), slot, turn


def with_rival(state, slot, weight, offset):
    """Beside the hypothesis one of some weight that has the wall elsewhere; nowhere if ``offset`` is None."""
    rival = state.hypotheses.take([0])
    if offset is None:
        rival.present[0, slot] = False
    else:
        rival.mean[0, state.layout.wall(slot)] += offset
    both = state.hypotheses.joined(rival)
    return state.but(hypotheses=both._replace(log_weight=np.log([1.0 - weight, weight])))


@pytest.mark.parametrize(
    ("support", "weight", "offset", "confirmed"),
    [(5, 0.01, 20.0, True), (4, 0.01, 20.0, False), (5, 0.05, 20.0, False), (5, 0.05, 1.0, True)],
)
def test_confirmed_once_seen_often_and_agreed_on(support, weight, offset, confirmed):
    """Too few detections, or too much weight on another place: the wall waits; nearby is the same place."""
    state, slot, _ = entered(np.array([0.0, 90.0]))
    state = with_rival(state, slot, weight, offset)
    state.hypotheses.support[:, slot] = support
    after = judge_tentative(state, MODEL, VISIBILITY, MODEL.confirm_support)
    assert after.slots.confirmed[slot] == confirmed
    assert not state.slots.confirmed[slot]
    assert after.hypotheses.number == (1 if confirmed and offset == 20.0 else 2)
    assert np.exp(after.hypotheses.log_weight).sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("waited", "step_m", "deleted"), [(30, 1.0, False), (50, 1.0, True), (50, 0.1, False), (500, 0.1, True)]
)
def test_tentative_walls_are_overdue_in_epochs_and_metres(waited, step_m, deleted):
    """An agent that stands still learns nothing: a wall waits for it, but not for ever."""
    state, slot, _ = entered(np.array([0.0, 90.0]))
    state = with_rival(state, slot, 0.5, None)
    track = Track(np.arange(20), np.stack([step_m * np.arange(20.0), np.zeros(20)], axis=1), np.full(20, 0.1))
    state = state.but(epoch=20 + waited, buffer=state.buffer._replace(track=track))
    after = judge_tentative(state, MODEL, VISIBILITY, MODEL.confirm_support)
    assert (after.slots.wall_id[slot] == -1) == deleted
    assert after.hypotheses.number == (1 if deleted else 2)


def test_a_wall_that_no_weight_has_is_deleted():
    """Hypotheses with it have all but gone: its slot is free at once."""
    state, slot, _ = entered(np.array([0.0, 90.0]))
    state = with_rival(state, slot, 1.0 - 1e-7, None)
    after = judge_tentative(state, MODEL, VISIBILITY, MODEL.confirm_support)
    assert after.slots.wall_id[slot] == -1


def deceived(order=(0, 2), also=()):
    """A room in which a path over two walls has become a fifth; the anchors ``also`` heard it, too."""
    state, slot, turn = entered(image_of(*order), confirmed=True)
    for k in (0, *also):
        state.slots.detected_from_m[slot, k] = AGENT @ turn.T
    return state, slot


def redundant(state):
    """Slots that are deleted because bounces over others explain them."""
    after = delete_redundant(state, MODEL, VISIBILITY, 0.6)
    return np.flatnonzero((state.slots.wall_id >= 0) & (after.slots.wall_id < 0)).tolist()


def test_a_wall_that_bounces_over_others_explain_goes():
    """A double bounce over two known walls was taken for a wall: it is seen through, and taken out."""
    state, slot = deceived()
    after = delete_redundant(state, MODEL, VISIBILITY, 0.6)
    assert after.slots.wall_id[slot] == -1
    assert not after.hypotheses.present[:, slot].any()
    assert after.hypotheses.present[:, :4].all()


def test_a_wall_that_another_anchor_heard_stays():
    """Double bounces of two anchors are never as long as single ones off one wall: what both hear is it."""
    assert redundant(deceived(also=(1,))[0]) == []


def test_the_wall_behind_the_deception_stays():
    """What a true wall explains fits bounces over the deceiving wall and another, but no beam takes them."""
    state, slot = deceived()
    state.slots.born[2] = 30  # found on the way
    state.slots.detected_from_m[2] = state.slots.detected_from_m[slot]
    state.slots.detected_from_m[2, 1] = np.nan
    assert redundant(state) == [slot]


def test_walls_of_the_first_sweep_are_not_doubted():
    """A wall that flashed in the sweep is there, whatever else is as long or is missed."""
    state, slot = deceived()
    state.slots.born[slot] = -1
    state.slots.log_odds[slot] = -100.0
    assert redundant(state) == []
    assert prune_confirmed(state, MODEL, VISIBILITY) is state


def odds_after(state, slot, detected, extent, agent=AGENT[0], margin=0.5):
    """Log odds of a wall's existence after one epoch in which anchor 0 was heard over it so surely."""
    mean = state.hypotheses.mean[0].copy()
    c, s = np.cos(state.bearing_rad), np.sin(state.bearing_rad)
    mean[:2] = np.array([[c, s], [-s, c]]) @ agent
    found = np.zeros((2, state.layout.features))
    found[0, 1 + slot] = detected
    extents = state.slots.extent_m.copy()
    extents[slot] = extent
    places = np.full((state.layout.slots, 2, 2, 2), np.nan)
    places[slot, 0] = mean[:2] + [[-0.5, 0.0], [0.5, 0.0]]
    return existence_odds(
        state.layout, mean, state.hypotheses.located[0], state.hypotheses.present[0], state.slots.confirmed,
        found, np.array([True, False]), extents, places, state.slots.log_odds, 0.5, margin, 1.0, 20.0,
    )[slot]  # fmt: skip


def test_misses_count_inside_the_observed_extent_alone():
    """Where a wall was never seen to reflect it may end, or something stand in the way: no miss counts."""
    state, slot, _ = entered(np.array([0.0, 90.0]), confirmed=True)
    everywhere, elsewhere = (-100.0, 100.0), (60.0, 100.0)
    assert odds_after(state, slot, 0.0, everywhere) == pytest.approx(np.log(0.5))
    assert odds_after(state, slot, 0.0, elsewhere) == 0.0
    assert odds_after(state, slot, 0.0, (np.inf, -np.inf)) == 0.0
    assert odds_after(state, slot, 1.0, elsewhere) == pytest.approx(1.0)
    state.slots.log_odds[slot] = 19.9
    assert odds_after(state, slot, 1.0, everywhere) == 20.0
    state.slots.confirmed[slot] = False
    assert odds_after(state, slot, 0.0, everywhere) == 19.9


def test_misses_count_near_the_stretch_of_track_alone():
    """A wall heard from one end of a hall is not expected at the other, before it was heard there."""
    state, slot, _ = entered(np.array([0.0, 90.0]), confirmed=True)
    state.slots.detected_from_m[slot] = np.nan
    mean = state.hypotheses.mean[0].copy()
    places = np.full((state.layout.slots, 2, 2, 2), np.nan)
    extents = np.tile([-100.0, 100.0], (state.layout.slots, 1))
    nothing = np.zeros((2, state.layout.features))
    given = state.hypotheses.located[0], state.hypotheses.present[0], state.slots.confirmed, nothing
    for shift, counts in ((0.5, True), (5.0, False)):
        places[slot, 0] = mean[:2] + [[shift, 0.0], [shift + 1.0, 0.0]]
        after = existence_odds(
            state.layout, mean, *given, np.array([True, True]), extents, places,
            state.slots.log_odds, 0.5, 0.5, 1.0, 20.0,
        )  # fmt: skip
        assert (after[slot] < 0.0) == counts


@pytest.mark.parametrize(("log_odds", "deleted"), [(-9.9, False), (-10.1, True)])
def test_a_wall_missed_too_often_is_deleted(log_odds, deleted):
    """Its log odds tell; others stay."""
    state, slot, _ = entered(np.array([0.0, 90.0]), confirmed=True)
    state.slots.log_odds[slot] = log_odds
    after = prune_confirmed(state, MODEL, VISIBILITY)
    assert (after.slots.wall_id[slot] == -1) == deleted
    assert after.slots.confirmed[:4].all()


def test_of_duplicates_the_younger_goes():
    """Two slots with one wall would share its paths between them."""
    state, slot, _ = entered(ROOM[3] + 0.1, confirmed=True)
    assert prune_confirmed(state, MODEL, VISIBILITY).slots.wall_id[slot] == -1
    state, slot, _ = entered(ROOM[3] + 2.0, confirmed=True)
    assert prune_confirmed(state, MODEL, VISIBILITY).slots.wall_id[slot] == 4


def test_a_closed_slot_is_empty_when_it_is_used_again():
    """A slot that stayed confirmed would count a new wall as found at once."""
    state, slot, _ = entered(np.array([0.0, 90.0]), confirmed=True)
    state.slots.log_odds[slot], state.slots.extent_m[slot] = 5.0, (-1.0, 1.0)
    state.slots.detected_from_m[slot] = 1.0
    state.hypotheses.support[:, slot] = 9
    state.hypotheses.visibility[:] = 0.123
    closed = close_slot(state, slot, VISIBILITY)
    again, same = open_slot(closed, VISIBILITY)
    assert same == slot
    fresh, _ = open_slot(
        start(tuple(GaussianVrp(w, 0.01 * np.eye(2)) for w in ROOM), ("a", "b"), 28e9, CONFIG), VISIBILITY
    )
    for name in ("wall_id", "born", "confirmed", "extent_m", "detected_from_m", "log_odds", "owner"):
        assert np.array_equal(
            getattr(again.slots, name)[slot], getattr(fresh.slots, name)[slot], equal_nan=True
        )
    columns = again.layout.wall(slot)
    assert not again.hypotheses.covariance[:, columns].any()
    assert not again.hypotheses.covariance[:, :, columns].any()
    assert not again.hypotheses.support[:, slot].any()
    pairs = np.arange(again.layout.pairs).reshape(again.layout.slots, -1)
    involved = np.concatenate([[1 + slot], 1 + again.layout.slots + np.union1d(pairs[slot], pairs[:, slot])])
    assert np.array_equal(
        again.hypotheses.visibility[..., involved], fresh.hypotheses.visibility[..., involved]
    )
    others = np.setdiff1d(np.arange(again.layout.features), involved)
    assert np.all(again.hypotheses.visibility[..., others] == 0.123)


def test_closing_keeps_the_hypotheses_without_the_wall():
    """Those with it made room for nothing; weights sum to one again."""
    state, slot, _ = entered(np.array([0.0, 90.0]))
    state = with_rival(state, slot, 0.3, None)
    closed = close_slot(state, slot, VISIBILITY)
    assert closed.hypotheses.number == 1
    assert closed.hypotheses.log_weight[0] == pytest.approx(0.0)
    assert state.hypotheses.number == 2


def test_a_room_full_of_double_bounces_holds_no_wall_of_them(room):
    """Without powers, a double bounce over an unknown wall is taken for a wall; with that found, it goes."""
    measured = room.measure(1, 95, order=2, range_std_m=0.03, clutter_mean=0.5)
    result = run_slam(measured)
    nearest = np.linalg.norm(result.wall_mean_m[:, :, None] - room.vrps, axis=-1).min(axis=-1)
    false = result.wall_valid & (nearest > 4.0)
    assert not false[-1].any()
    assert result.wall_valid[-1].sum() == 5


def test_a_wall_that_is_taken_away_is_deleted(room):
    """Found on the way out, gone on the way back: the wall is dropped, and the others stay."""
    there, back = room.track[:115], room.track[114:0:-1]
    walk = Room(room.walls, room.anchors, np.concatenate([there, back]))
    measured, kept = walk.measure(3), []
    for epoch in measured.epochs:
        paths = []
        for anchor, heard in zip(room.anchors, epoch.paths, strict=True):
            image = anchor * [1.0, -1.0]  # in the wall y = 0
            off = np.abs(heard.range_m - np.linalg.norm(image - walk.track[epoch.index]))
            stay = (off > 0.5) | (epoch.index < len(there))
            paths.append(AnchorPaths(heard.delay_s[stay], heard.delay_std_s[stay]))
        kept.append(replace(epoch, paths=tuple(paths)))
    unseen = replace(measured, walls=measured.walls[:3], epochs=tuple(kept))  # no sweep showed it
    result = run_slam(unseen)
    nearest = [
        np.linalg.norm(result.wall_mean_m[t][result.wall_valid[t]] - room.vrps[3], axis=1).min()
        for t in (len(there) - 1, -1)
    ]
    assert nearest[0] < 3.0
    assert nearest[1] > 3.0
    assert result.wall_valid[-1].sum() >= 3


@pytest.mark.parametrize(
    ("sweeps", "epochs", "often", "off", "deleted"),
    [
        (0, 20, True, 0.0, True),
        (19, 20, True, 0.0, True),
        (20, 20, True, 0.0, False),
        (0, 5, True, 0.0, False),
        (0, 20, False, 0.0, False),
        (0, 20, True, 1.0, False),
    ],
)
def test_a_corner_taken_for_a_wall_goes(sweeps, epochs, often, off, deleted):
    """First and last seen where the corner of two known walls throws back; what many sweeps show stays."""
    corner = mirror(*ROOM[2], *ROOM[0])  # RP's image over both walls
    state, slot, turn = entered(np.array(corner), confirmed=True)
    for entry, agent in enumerate((np.zeros(2), np.array([3.0, 1.0]))):
        image = np.array(mirror(*mirror(*agent, *ROOM[2]), *ROOM[0]))
        image += off * (image - agent) / np.linalg.norm(image - agent)
        state.slots.flash_m[slot, entry] = turn @ agent, turn @ image
    state.slots.swept[slot], state.slots.swept[:slot] = sweeps, 30
    after = delete_corners(state.but(epoch=20 + epochs), MODEL, VISIBILITY, often)
    assert (after.slots.wall_id[slot] < 0) == deleted
    assert np.all(after.slots.wall_id[:slot] >= 0)
