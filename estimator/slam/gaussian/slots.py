"""Slots of walls and virtual anchors: open one, close one; closed slots are used again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.gaussian.state import GaussianState, Slots
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.state_vector import NOWHERE_M, Layout
from estimator.slam.models.visibility import Visibility, prior_visibility

__all__ = ["close_slot", "open_slot"]

Array = NDArray[np.float64]


def open_slot(state: GaussianState, model: Visibility) -> tuple[GaussianState, int]:
    """A state with an empty slot, and the number of that slot."""
    empty = np.flatnonzero(state.slots.wall_id < 0)
    if empty.size:
        return state, int(empty[0])
    old, before, slots = state.layout, state.hypotheses, state.slots
    new = old._replace(slots=old.slots + 1)
    mean = np.full((before.number, new.size), NOWHERE_M)
    mean[:, : old.size] = before.mean
    covariance = np.zeros((before.number, new.size, new.size))
    covariance[:, : old.size, : old.size] = before.covariance
    grown = before._replace(
        mean=mean,
        covariance=covariance,
        present=np.pad(before.present, ((0, 0), (0, 1))),
        visibility=_widened(before.visibility, old, new, model),
        support=np.pad(before.support, ((0, 0), (0, 1))),
    )
    more = Slots(
        wall_id=np.append(slots.wall_id, -1),
        born=np.append(slots.born, -1),
        confirmed=np.append(slots.confirmed, False),
        extent_m=np.concatenate([slots.extent_m, [[np.inf, -np.inf]]]),
        owner=np.append(slots.owner, -1),
        detected_from_m=np.concatenate([slots.detected_from_m, np.full((1, new.anchors, 2, 2), np.nan)]),
        log_odds=np.append(slots.log_odds, 0.0),
        swept=np.append(slots.swept, 0),
        flash_m=np.concatenate([slots.flash_m, np.full((1, 2, 2, 2), np.nan)]),
    )
    return state.but(hypotheses=grown, slots=more), old.slots


def _widened(visibility: Array, old: Layout, new: Layout, model: Visibility) -> Array:
    """Visibility (R, K, F) with features for one more slot."""
    count = len(visibility)
    wide = np.tile(prior_visibility(new, model), (count, new.anchors, 1))
    wide[..., : 1 + old.slots] = visibility[..., : 1 + old.slots]
    if new.shared:
        pairs = wide[..., 1 + new.slots :].reshape(count, new.anchors, new.slots, new.slots)
        pairs[..., : old.slots, : old.slots] = visibility[..., 1 + old.slots :].reshape(
            count, old.anchors, old.slots, old.slots
        )
        wide[..., 1 + new.slots :] = pairs.reshape(count, new.anchors, -1)
    return wide


def close_slot(state: GaussianState, slot: int, model: Visibility) -> GaussianState:
    """Delete a wall: the hypotheses without it stay; if all have it, it is taken out of them."""
    layout, before = state.layout, state.hypotheses
    without = ~before.present[:, slot]
    kept = before.keep(without) if without.any() else before.take(np.arange(before.number))
    _clear(kept, layout, slot, model)
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot], slots.owner[slot] = -1, -1, -1
    slots.confirmed[slot] = False
    slots.extent_m[slot] = np.inf, -np.inf
    slots.detected_from_m[slot] = np.nan
    slots.log_odds[slot] = 0.0
    slots.swept[slot] = 0
    slots.flash_m[slot] = np.nan
    return state.but(hypotheses=kept, slots=slots)


def _clear(hypotheses: Hypotheses, layout: Layout, slot: int, model: Visibility) -> None:
    """Take a wall out of hypotheses, in place."""
    columns = layout.wall(slot)
    hypotheses.mean[:, columns] = NOWHERE_M
    hypotheses.covariance[:, columns, :] = 0.0
    hypotheses.covariance[:, :, columns] = 0.0
    hypotheses.present[:, slot] = False
    hypotheses.support[:, slot] = 0
    involved = np.zeros(layout.features, dtype=bool)
    involved[1 + slot] = True
    if layout.shared:
        pairs = involved[1 + layout.slots :].reshape(layout.slots, layout.slots)
        pairs[slot, :] = pairs[:, slot] = True
    hypotheses.visibility[..., involved] = prior_visibility(layout, model)[involved]
