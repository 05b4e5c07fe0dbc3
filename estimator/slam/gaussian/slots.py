"""The wall slots of a state: open one for a new wall, confirm it, give it up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.multiples import redundant_walls
from estimator.slam.gaussian.pool import pending_of
from estimator.slam.gaussian.state import NOWHERE_M, GaussianState, Rows, Slots
from estimator.slam.layout import Layout

__all__ = ["fresh_visibility", "judge", "may_judge", "open_slot", "retire"]

Array = NDArray[np.float64]
_PATIENCE = 10.0  # times the pending epochs: an agent that stands still
_RECHECK = 8  # epochs between doubts of the walls found on the way
_FRESH = (0.9, 0.6, 0.1)  # prior visibility of line of sight, wall and pair


def fresh_visibility(layout: Layout) -> Array:
    """Prior visibility (F,) of an anchor's features."""
    direct, wall, pair = _FRESH
    return np.repeat([direct, wall, pair], [1, layout.slots, layout.pairs])


def open_slot(state: GaussianState) -> tuple[GaussianState, int]:
    """A state with an empty wall slot, and the number of that slot."""
    empty = np.flatnonzero(state.slots.wall_id < 0)
    if empty.size:
        return state, int(empty[0])
    old, rows, slots = state.layout, state.rows, state.slots
    new = replace(old, slots=old.slots + 1)
    mean = np.full((len(rows), new.size), NOWHERE_M)
    mean[:, : old.size] = rows.mean
    covariance = np.zeros((len(rows), new.size, new.size))
    covariance[:, : old.size, : old.size] = rows.covariance
    grown = Rows(
        rows.log_weight,
        mean,
        covariance,
        rows.located,
        np.pad(rows.present, ((0, 0), (0, 1))),
        _widened(rows.visibility, old, new),
        np.pad(rows.support, ((0, 0), (0, 1))),
    )
    more = Slots(
        np.append(slots.wall_id, -1),
        np.append(slots.born, -1),
        np.append(slots.confirmed, False),
        np.concatenate([slots.span_m, [[np.inf, -np.inf]]]),
        np.append(slots.owner, -1),
        np.concatenate([slots.heard_from_m, np.full((1, new.anchors, 2, 2), np.nan)]),
    )
    return state.but(rows=grown, slots=more), old.slots


def _widened(visibility: Array, old: Layout, new: Layout) -> Array:
    """Visibility (R, K, F) with features for one more slot."""
    rows = len(visibility)
    wide = np.tile(fresh_visibility(new), (rows, new.anchors, 1))
    wide[..., : 1 + old.slots] = visibility[..., : 1 + old.slots]
    if not new.shared:
        return wide
    pairs = wide[..., 1 + new.slots :].reshape(rows, new.anchors, new.slots, new.slots)
    pairs[..., : old.slots, : old.slots] = visibility[..., 1 + old.slots :].reshape(
        rows, old.anchors, old.slots, old.slots
    )
    wide[..., 1 + new.slots :] = pairs.reshape(rows, new.anchors, -1)
    return wide


def may_judge(states: Sequence[GaussianState]) -> NDArray[np.bool_]:
    """Which of B runs with one layout :func:`judge` and :func:`retire` need be asked about."""
    born = np.array([state.slots.born for state in states])
    found = np.any((born >= 0) & np.array([state.slots.confirmed for state in states]), axis=1)
    again = np.array([state.shared and state.epoch % _RECHECK == 0 for state in states])
    return np.asarray(pending_of(states) | (found & again))


def judge(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Confirm pending walls that nearly all the weight agrees on; give up those that linger.

    One that only waits to be heard more often, as do those that sweeps have shown, is none of these.

    A virtual anchor is there if it is heard, wherever it stands: before the track bends it may be
    itself or its mirror image in the track, and the epochs to come decide.
    """
    for slot in state.slots.pending:
        rows, weight = state.rows, np.exp(state.rows.log_weight)
        have = rows.present[:, slot]
        alike = _agreeing(state, int(slot), config) if state.shared else have
        support = rows.support[alike, slot].max(initial=0)
        agreed = bool(weight[alike].sum() > config.confirm_weight)
        if agreed and support >= config.confirm_support:
            slots = state.slots.copy()
            slots.confirmed[slot] = True
            state = state.but(slots=slots, rows=rows.keep(alike))
        elif weight[have].sum() < 1e-5 or (
            _overdue(state, int(slot), config) and not (agreed and support > 0)
        ):
            state = _close_slot(state, int(slot))
    return state


def retire(states: Sequence[GaussianState], config: GaussianConfig) -> list[GaussianState]:
    """Take out the walls found on the way that bounces over others, found later perhaps, explain.

    They are looked at every few epochs; runs with one layout together.
    """
    after = list(states)
    due = [i for i, state in enumerate(states) if state.shared and state.epoch % _RECHECK == 0]
    if due:
        gone = redundant_walls([states[i] for i in due], config)
        for row, slot in np.argwhere(gone).tolist():
            after[due[row]] = _close_slot(after[due[row]], slot)
    return after


def _overdue(state: GaussianState, slot: int, config: GaussianConfig) -> bool:
    """Whether a wall has been pending long enough: in epochs, and in how far the agent has come since.

    An agent that hardly moves learns hardly anything.
    """
    waited = float(state.epoch - state.slots.born[slot])
    travelled = np.sum(np.linalg.norm(np.diff(state.trail[:, 1:3], axis=0), axis=1))
    per_epoch = travelled / max(float(np.ptp(state.trail[:, 0])), 1.0)
    return waited > config.pending_epochs and (
        waited * per_epoch > config.pending_travel_m or waited > _PATIENCE * config.pending_epochs
    )


def _agreeing(state: GaussianState, slot: int, config: GaussianConfig) -> NDArray[np.bool_]:
    """Rows whose wall in ``slot`` stands where the likeliest of them has it."""
    have = state.rows.present[:, slot]
    if not have.any():
        return have
    best = np.flatnonzero(have)[np.argmax(state.rows.log_weight[have])]
    vrp = state.rows.mean[:, state.layout.wall(slot)]
    return np.asarray(have & (np.linalg.norm(vrp - vrp[best], axis=1) < config.confirm_radius_m))


def _close_slot(state: GaussianState, slot: int) -> GaussianState:
    """Give a wall up: the rows without it stay; if all have it, it is taken out of them."""
    layout, rows = state.layout, state.rows
    without = ~rows.present[:, slot]
    rows = rows.keep(without) if without.any() else rows.take(np.arange(len(rows)))
    columns = layout.wall(slot)
    rows.mean[:, columns] = NOWHERE_M
    rows.covariance[:, columns, :] = 0.0
    rows.covariance[:, :, columns] = 0.0
    rows.present[:, slot] = False
    rows.support[:, slot] = 0
    involved = np.zeros(layout.features, dtype=bool)
    involved[1 + slot] = True
    if layout.shared:
        pairs = involved[1 + layout.slots :].reshape(layout.slots, layout.slots)
        pairs[slot, :] = pairs[:, slot] = True
    rows.visibility[..., involved] = fresh_visibility(layout)[involved]
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot], slots.owner[slot] = -1, -1, -1
    slots.span_m[slot] = np.inf, -np.inf
    slots.heard_from_m[slot] = np.nan
    return state.but(rows=rows, slots=slots)
