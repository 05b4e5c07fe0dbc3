"""Walls enter the hypotheses: a line of unassociated paths becomes a bank of walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.gaussian.births.lines import Line, find_line
from estimator.slam.gaussian.births.wall_bank import Bank, Known, wall_bank
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.reclassification import associated_then
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.hypotheses import log_sum_exp, moments, normalised_weights
from estimator.slam.models.path_loss import loss_limits

__all__ = ["bear_wall"]

Array = NDArray[np.float64]


def bear_wall(state: GaussianState, config: GaussianConfig, prune_nats: float) -> GaussianState:
    """Start a wall where recent unassociated paths ask for one; one wall at a time.

    Parameters
    ----------
    state : GaussianState
        A state of shared walls, its buffer with the present epoch.
    config : GaussianConfig
        Models.
    prune_nats : float
        Walls this far below the best are dropped.
    """
    if state.slots.tentative.size:
        return state
    limit = loss_limits(state.losses_db, config.path_loss)
    line = _line(state, limit, config)
    if line is None:
        return state
    best = state.hypotheses.best
    mean, present = state.hypotheses.mean[best], state.hypotheses.present[best]
    known, legs = associated_then(
        state.layout,
        mean,
        state.hypotheses.located[best],
        present,
        state.slots.confirmed,
        state.slots.owner,
        state.buffer,
        config.noise.range_std_m,
        config.reclassification.pair_radius_m,
        config.reclassification.beside_sigma,
        config.reclassification.leg_sigma,
    )
    state = state.but(buffer=state.buffer.with_associated(known))
    line = _line(state, limit, config)
    if line is None:
        return state
    track = state.buffer.track
    row = state.buffer.row_of(line.epoch)
    walls = mean[state.layout.walls].reshape(-1, 2)[present]
    bank = wall_bank(
        line,
        track.position_m[row],
        track.std_m[row],
        mean[state.layout.anchor(line.anchor)],
        Known(walls, state.slots.extent_m[present], legs),
        config.births,
        prune_nats,
        config.lifecycle.confirm_radius_m,
    )
    return state if bank is None else _enter(state, line, bank, config)


def _line(state: GaussianState, limit_db: Array, config: GaussianConfig) -> Line | None:
    """The best line of an anchor on whose place the hypotheses agree."""
    line = find_line(state.buffer, state.epoch, limit_db, config.noise.range_std_m, config.births)
    return line if line is not None and _is_settled(state, line.anchor, config) else None


def _is_settled(state: GaussianState, k: int, config: GaussianConfig) -> bool:
    """Whether the hypotheses agree on the place of anchor ``k``."""
    hypotheses, place = state.hypotheses, state.layout.anchor_xy(k)
    if not hypotheses.located[:, k].all():
        return False
    weight = normalised_weights(hypotheses.log_weight)
    _, spread = moments(weight, hypotheses.mean[:, place], hypotheses.covariance[:, place, place])
    return bool(np.trace(spread) < config.births.settled_std_m**2)


def _enter(state: GaussianState, line: Line, bank: Bank, config: GaussianConfig) -> GaussianState:
    """The likeliest hypothesis once for each wall of the bank, beside all hypotheses without it."""
    state, slot = open_slot(state, config.visibility)
    columns = state.layout.wall(slot)
    new = state.hypotheses.take(np.full(len(bank.mean_m), state.hypotheses.best))
    new.mean[:, columns] = bank.mean_m
    jacobian = bank.jacobian(state.layout, line.anchor)
    cross = jacobian @ new.covariance
    new.covariance[:, columns, :] = cross
    new.covariance[:, :, columns] = cross.transpose(0, 2, 1)
    new.covariance[:, columns, columns] = cross @ jacobian.transpose(0, 2, 1) + bank.covariance_m2
    new.present[:, slot] = True
    new.log_weight[...] += config.births.birth_log_prior + bank.log_weight - log_sum_exp(bank.log_weight)
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot] = state.next_wall_id, state.epoch
    return state.but(
        hypotheses=state.hypotheses.joined(new),
        slots=slots,
        next_wall_id=state.next_wall_id + 1,
        buffer=state.buffer.with_associated(line.row),
    )
