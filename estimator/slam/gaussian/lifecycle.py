"""The track lifecycle of walls and virtual anchors: tentative, confirmed, deleted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.association.sweep_matching import are_double_bounces
from estimator.slam.gaussian.higher_order import explained_by_others
from estimator.slam.gaussian.slots import close_slot
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.extents import bounce_along_wall
from estimator.slam.models.features import side_of_wall
from estimator.slam.models.settings import Settings, not_negative, positive, probability
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout
from estimator.slam.models.visibility import Visibility

__all__ = [
    "Lifecycle",
    "delete_corners",
    "delete_redundant",
    "existence_odds",
    "judge_tentative",
    "prune_confirmed",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Lifecycle(Settings):
    """When walls are confirmed and deleted.

    Parameters
    ----------
    confirm_support : int
        Detections before a wall counts as found.
    confirm_weight : float
        Posterior weight, within ``confirm_radius_m``, before a wall counts as found.
    confirm_radius_m : float
        Radius in which hypotheses on one wall are the same wall, metres.
    tentative_epochs : int
        Epochs after which a tentative wall is deleted,
    tentative_travel_m : float
        if the agent has also come this far, metres,
    patience : float
        or has waited this many times as long: an agent that hardly moves learns hardly anything.
    least_weight : float
        A tentative wall that less than this posterior weight has is deleted.
    redundancy_stride : int
        Epochs between looks for walls that bounces over others explain.
    third_order_walls : int
        Bounces over three walls are looked at while there are no more walls than this, 0 for never: they are
        as many as the cube of the walls.
    expected_probability : float
        Probability that a wall is detected where it was detected before, within its observed extent: less
        than one, for things may stand in the way.
    extent_margin_m : float
        How far inside the ends of the observed extent a bounce is expected, metres,
    revisit_m : float
        and how near to the stretch of track that the wall was detected on: elsewhere something may stand in
        the way, metres.
    most_log_odds : float
        Log odds of existence, at most: what was detected for ages may vanish.
    delete_log_odds : float
        A wall whose log odds of existence fall below minus this is deleted.
    corner_range_m, corner_azimuth_rad : float
        A wall that few sweeps showed, or from places far apart, first and last where a double bounce over the
        same two others, seen more often, should be, is none: it is the corner between them. Within these
        limits, metres and radians.
    corner_sweeps, corner_apart_m : int, float
        So many sweeps are few, so many metres far,
    corner_epochs : int
        and so many epochs must have passed since its birth, while sweeps come often.
    duplicate_m : float
        Two confirmed walls whose VRPs are closer than this are one, metres.
    """

    confirm_support: int = positive(5)
    confirm_weight: float = probability(0.98)
    confirm_radius_m: float = positive(3.0)
    tentative_epochs: int = positive(40)
    tentative_travel_m: float = positive(15.0)
    patience: float = positive(10.0)
    least_weight: float = positive(1e-5)
    redundancy_stride: int = positive(8)
    third_order_walls: int = not_negative(8)
    expected_probability: float = probability(0.5)
    extent_margin_m: float = not_negative(0.5)
    revisit_m: float = positive(1.0)
    most_log_odds: float = positive(20.0)
    delete_log_odds: float = positive(10.0)
    corner_range_m: float = positive(0.15)
    corner_azimuth_rad: float = positive(0.2)
    corner_sweeps: int = positive(20)
    corner_apart_m: float = positive(5.0)
    corner_epochs: int = positive(10)
    duplicate_m: float = positive(0.5)


def judge_tentative(
    state: GaussianState, model: Lifecycle, visibility: Visibility, confirm_support: int
) -> GaussianState:
    """Confirm tentative walls that nearly all the weight agrees on; delete those that are overdue.

    One that only waits to be detected more often, as do those that sweeps have shown, is neither.

    A virtual anchor is there if it is detected, wherever it stands: before the track bends it may be
    itself or its mirror image in the track, and the epochs to come decide.
    """
    for slot in state.slots.tentative.tolist():
        hypotheses, weight = state.hypotheses, np.exp(state.hypotheses.log_weight)
        have = hypotheses.present[:, slot]
        alike = _agreeing(state, slot, model) if state.shared else have
        support = hypotheses.support[alike, slot].max(initial=0)
        agreed = bool(weight[alike].sum() > model.confirm_weight)
        if agreed and support >= confirm_support:
            slots = state.slots.copy()
            slots.confirmed[slot] = True
            state = state.but(slots=slots, hypotheses=hypotheses.keep(alike))
        elif weight[have].sum() < model.least_weight or (
            _overdue(state, slot, model) and not (agreed and support > 0)
        ):
            state = close_slot(state, slot, visibility)
    return state


def _overdue(state: GaussianState, slot: int, model: Lifecycle) -> bool:
    """Whether a wall has been tentative long enough: in epochs, and in how far the agent has come since."""
    track = state.buffer.track
    waited = float(state.epoch - state.slots.born[slot])
    travelled = float(np.sum(np.linalg.norm(np.diff(track.position_m, axis=0), axis=1)))
    per_epoch = travelled / max(float(np.ptp(track.epoch)), 1.0)
    return waited > model.tentative_epochs and (
        waited * per_epoch > model.tentative_travel_m or waited > model.patience * model.tentative_epochs
    )


def _agreeing(state: GaussianState, slot: int, model: Lifecycle) -> Mask:
    """Hypotheses whose wall in ``slot`` stands where the likeliest of them has it."""
    hypotheses = state.hypotheses
    have = hypotheses.present[:, slot]
    if not have.any():
        return have
    best = np.flatnonzero(have)[np.argmax(hypotheses.log_weight[have])]
    vrp = hypotheses.mean[:, state.layout.wall(slot)]
    return np.asarray(have & (np.linalg.norm(vrp - vrp[best], axis=1) < model.confirm_radius_m))


def delete_corners(
    state: GaussianState, model: Lifecycle, visibility: Visibility, sweeps_tell: bool
) -> GaussianState:
    """Delete walls that were corners: a flash came over two walls of which one was not known yet.

    Walls known from the start are looked at too, but for the reference wall. Time is the cube of the walls.

    Parameters
    ----------
    state : GaussianState
        A state of shared walls.
    model : Lifecycle
        Limits.
    visibility : Visibility
        Prior visibility of slots that are closed.
    sweeps_tell : bool
        Whether sweeps came often since: only then is it a sign that no other one showed a wall.
    """
    slots, hypotheses = state.slots, state.hypotheses
    best = hypotheses.best
    found = slots.confirmed & hypotheses.present[best]
    old = state.epoch - np.maximum(slots.born, 0) >= model.corner_epochs
    apart = np.linalg.norm(slots.flash_m[:, 1, 0] - slots.flash_m[:, 0, 0], axis=1)
    told = (slots.swept < model.corner_sweeps) | (apart > model.corner_apart_m)
    asked = found & old & told & np.isfinite(slots.flash_m[:, 0, 0, 0])
    asked[:1] = False
    for slot in np.flatnonzero(asked & sweeps_tell).tolist():
        if are_double_bounces(
            state.layout,
            hypotheses.mean[best],
            found & (slots.swept > slots.swept[slot]),
            slots.flash_m[slot],
            model.corner_range_m,
            model.corner_azimuth_rad,
        ):
            state = close_slot(state, slot, visibility)
            found[slot] = False
    return state


def delete_redundant(
    state: GaussianState, model: Lifecycle, visibility: Visibility, radius_m: float
) -> GaussianState:
    """Delete walls found on the way that bounces over others, found later perhaps, explain.

    A wall is compared with the others at the two ends of the stretch of track on which each anchor
    detected it. Walls are taken away one after the other, the youngest first: what explains another must
    stay. Time is the cube of the walls (their fourth power while there are few) times the anchors.

    Parameters
    ----------
    state : GaussianState
        A state of shared walls.
    model : Lifecycle
        Limits.
    visibility : Visibility
        Prior visibility of slots that are closed.
    radius_m : float
        Path lengths this close are alike.
    """
    layout, slots = state.layout, state.slots
    mean = state.hypotheses.mean[state.hypotheses.best]
    vrp = mean[layout.walls].reshape(-1, 2)
    found = slots.confirmed & state.hypotheses.present[state.hypotheses.best]
    asked = np.flatnonzero(found & (slots.born >= 0) & (slots.swept < model.confirm_support))
    gone = []
    for slot in asked[np.argsort(-slots.born[asked], kind="stable")].tolist():
        found[slot] = False
        others = vrp[found]
        third = len(others) <= model.third_order_walls
        explained = []
        for k in range(layout.anchors):
            places = slots.detected_from_m[slot, k]
            if np.isfinite(places[0, 0]):
                device = mean[layout.anchor(k)]
                explained.append(explained_by_others(places, device, vrp[slot], others, radius_m, third))
        if explained and all(explained):
            gone.append(slot)
        else:
            found[slot] = True
    for slot in gone:
        state = close_slot(state, slot, visibility)
    return state


@compiled
def _is_near_stretch(mean: Array, stretch: Array, reach: float) -> bool:
    """Whether the agent is within ``reach`` of the segment between two places (2, 2); not if they are NaN."""
    dx, dy = stretch[1, 0] - stretch[0, 0], stretch[1, 1] - stretch[0, 1]
    x, y = mean[0] - stretch[0, 0], mean[1] - stretch[0, 1]
    along = min(max((x * dx + y * dy) / max(dx * dx + dy * dy, 1e-9), 0.0), 1.0)
    return bool((x - along * dx) ** 2 + (y - along * dy) ** 2 < reach * reach)


@compiled
def existence_odds(
    layout: Layout,
    mean: Array,
    located: Mask,
    present: Mask,
    confirmed: Mask,
    detected: Array,
    asked: Mask,
    extent: Array,
    detected_from: Array,
    log_odds: Array,
    expected: float,
    margin: float,
    revisit: float,
    most: float,
) -> Array:
    """Log odds (L,) of existence after an epoch: detections raise them, misses inside the extent lower them.

    Parameters
    ----------
    layout, mean, located, present
        The likeliest hypothesis.
    confirmed : ndarray of bool, shape (L,)
        Confirmed walls; of others nothing changes.
    detected : ndarray, shape (K, F)
        Probability that each feature was measured.
    asked : ndarray of bool, shape (K,)
        Anchors of which any path was heard: the others tell nothing.
    extent : ndarray, shape (L, 2)
        Observed extents, metres.
    detected_from : ndarray, shape (L, K, 2, 2)
        Where the agent first and last detected each anchor over each wall, NaN if never.
    log_odds : ndarray, shape (L,)
        Log odds before.
    expected, margin, revisit, most : float
        ``expected_probability``, ``extent_margin_m``, ``revisit_m`` and ``most_log_odds`` of
        :class:`Lifecycle`.
    """
    after = log_odds.copy()
    first_slot = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    for i in range(layout.slots):
        if not (confirmed[i] and present[i]):
            continue
        w = first_slot + 2 * i
        here = side_of_wall(mean[0], mean[1], mean[w], mean[w + 1])
        for k in range(layout.anchors):
            if not (located[k] and asked[k]):
                continue
            a = FIRST_ANCHOR + PER_ANCHOR * k
            seen = detected[k, 1 + i]
            after[i] += seen
            if not _is_near_stretch(mean, detected_from[i, k], revisit):
                continue
            if here * side_of_wall(mean[a], mean[a + 1], mean[w], mean[w + 1]) > 0.0:
                along = bounce_along_wall(mean[0], mean[1], mean[a], mean[a + 1], mean[w], mean[w + 1])
                if extent[i, 0] + margin < along < extent[i, 1] - margin:
                    after[i] += (1.0 - seen) * np.log1p(-expected)
        after[i] = min(after[i], most)
    return after


def prune_confirmed(state: GaussianState, model: Lifecycle, visibility: Visibility) -> GaussianState:
    """Delete confirmed walls that should have been detected and were not, and the younger of duplicates.

    Walls known from the start stay.
    """
    slots = state.slots
    found = slots.confirmed & (slots.born >= 0)
    unseen = slots.swept < model.confirm_support  # what sweeps show stands, whatever paths say
    gone = np.flatnonzero(found & unseen & (slots.log_odds < -model.delete_log_odds)).tolist()
    if state.shared and found.any():
        best = state.hypotheses.best
        vrp = state.hypotheses.mean[best][state.layout.walls].reshape(-1, 2)
        standing = np.flatnonzero(slots.confirmed & state.hypotheses.present[best])
        for slot in np.flatnonzero(found & state.hypotheses.present[best]).tolist():
            older = standing[(slots.born[standing] < slots.born[slot]) & (standing != slot)]
            near = np.linalg.norm(vrp[older] - vrp[slot], axis=1) < model.duplicate_m
            if slot not in gone and near.any():
                gone.append(slot)
    for slot in gone:
        state = close_slot(state, slot, visibility)
    return state
