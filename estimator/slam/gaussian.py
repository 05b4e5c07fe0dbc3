"""The Gaussian engine: hybrid SLAM with one joint, gauge-separated Gaussian per hypothesis.

``step`` takes one epoch of path lengths into a state; the state before the first
epoch comes from :func:`estimator.slam.start.start`. Online and offline use call the
same function.

    predict the agent -> associate and correct all hypotheses -> take a sweep -> locate anchors
    -> remember the unexplained -> start walls -> prune and merge -> confirm walls
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.measurements import Epoch
from estimator.slam.births import find_line, wall_bank
from estimator.slam.config import GaussianConfig
from estimator.slam.hindsight import look_back
from estimator.slam.hypotheses import moments, tidy
from estimator.slam.locate import locate_anchors
from estimator.slam.memory import clutter_density, remember, widen_spans
from estimator.slam.motion import predict_motion
from estimator.slam.paths import PathTable, stack_paths
from estimator.slam.slots import judge, open_slot
from estimator.slam.state import GaussianState, log_sum_exp
from estimator.slam.sweeps import take_sweep
from estimator.slam.update import correct
from estimator.slam.virtual_births import bear_virtual_anchors, shorter_than_sight

__all__ = ["step"]

Array = NDArray[np.float64]
_EXPECTED = (
    0.7  # a bounce tells how far a wall extends if it was expected this surely: one hit may be clutter
)
_SETTLED_M = 1.5  # standard deviation of an anchor from which walls may be born
_FIRST_EPOCHS = 8  # in which more places of the anchors are kept


def step(
    state: GaussianState, epoch: Epoch, config: GaussianConfig, rng: np.random.Generator | None = None
) -> GaussianState:
    """Take one epoch into the state.

    Parameters
    ----------
    state : GaussianState
        The state after the previous epoch; it is not changed.
    epoch : Epoch
        The next epoch: a larger index and time than the state's.
    config : GaussianConfig
        Models.
    rng : Generator, optional
        Part of the step protocol; this engine draws nothing.

    Returns
    -------
    GaussianState

    Raises
    ------
    InputError
        If the epoch is not later than the state, or has another number of anchors.
    """
    if len(epoch.paths) != len(state.anchor_names):
        raise InputError(
            f"epoch {epoch.index}: expected paths of {len(state.anchor_names)} anchors, "
            f"got {len(epoch.paths)}"
        )
    if state.epoch >= 0:
        if epoch.index <= state.epoch or not epoch.time_s > state.time_s:
            raise InputError(
                f"epoch {epoch.index} at {epoch.time_s} s: expected one later than epoch {state.epoch} "
                f"at {state.time_s} s"
            )
        state = _predict(state, epoch.time_s - state.time_s, config)
    if len(state.trail) < _FIRST_EPOCHS:
        config = config.widened()
    state = replace(state, epoch=epoch.index, time_s=epoch.time_s)
    paths = stack_paths(epoch, state.carrier_hz)
    state, explained = _correct(state, paths, config)
    if state.shared:
        state = take_sweep(state, epoch.sweep, epoch.heading_held, config)
    state = locate_anchors(state, paths, config)
    state = remember(state, paths, explained, config)
    state = _bear(state, config) if state.shared else bear_virtual_anchors(state, config)
    return judge(replace(state, rows=tidy(state.rows, config)), config)


def _predict(state: GaussianState, step_s: float, config: GaussianConfig) -> GaussianState:
    """The agent moves on; features may appear and vanish."""
    rows = state.rows
    mean, covariance = predict_motion(rows.mean, rows.covariance, step_s, config.acceleration_variance)
    stay, appear = 1.0 - config.vanish_probability, config.appear_probability
    visibility = stay * rows.visibility + appear * (1.0 - rows.visibility)
    return replace(state, rows=replace(rows, mean=mean, covariance=covariance, visibility=visibility))


def _correct(state: GaussianState, paths: PathTable, config: GaussianConfig) -> tuple[GaussianState, Array]:
    """Associate and update all rows; also how far the best row explains the paths, (K, M)."""
    rows = state.rows
    if not rows.located.any():
        return state, np.zeros(paths.length_m.shape)
    clutter = clutter_density(state, config)
    done = correct(
        rows.mean,
        rows.covariance,
        rows.visibility,
        state.active(),
        paths.turned(-state.bearing_rad),
        state.layout,
        config,
        clutter,
    )
    expected = rows.visibility[done.parent]
    rows = rows.take(done.parent)
    weight = rows.log_weight + done.log_evidence
    if not state.shared:
        weight -= config.virtual_forgetting * rows.log_weight
        weight += shorter_than_sight(done, paths, state.layout, config, clutter)
    evidence = log_sum_exp(weight)
    heard = np.any(done.heard[:, :, 1 : 1 + state.layout.slots] > 0.5, axis=1)
    rows = replace(
        rows,
        mean=done.mean,
        covariance=done.covariance,
        visibility=done.visibility,
        support=rows.support + heard,
        log_weight=weight - evidence,
    )
    state = replace(state, rows=rows, log_evidence=state.log_evidence + evidence)
    again = np.where(expected[rows.best] > _EXPECTED, done.heard[rows.best], 0.0)
    span = widen_spans(state, rows.best, again)
    return replace(state, slots=replace(state.slots, span_m=span)), done.explained[rows.best]


def _bear(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Start a wall where recent unexplained paths ask for one; one wall at a time."""
    if state.slots.pending.size:
        return state
    line = find_line(state.loose, state.epoch, config)
    if line is None or not _settled(state, line.anchor):
        return state
    past = look_back(state, config)
    state = past.state
    line = find_line(state.loose, state.epoch, config)
    if line is None or not _settled(state, line.anchor):
        return state
    rows, best = state.rows, state.rows.best
    mean, present = rows.mean[best], rows.present[best]
    anchor = mean[state.layout.anchor(line.anchor)]
    trail = state.trail[np.searchsorted(state.trail[:, 0], line.epoch)]
    walls = mean[state.layout.walls].reshape(-1, 2)[present]
    spans = state.slots.span_m[present]
    bank = wall_bank(line, trail[:, 1:3], trail[:, 3], anchor, walls, spans, past.legs, config)
    if bank is None:
        return state
    state, slot = open_slot(state)
    columns = state.layout.wall(slot)
    new = state.rows.take(np.full(len(bank.mean_m), best))
    new.mean[:, columns] = bank.mean_m
    new.covariance[:, columns, columns] = bank.covariance_m2
    new.present[:, slot] = True
    new.log_weight[...] += config.birth_log_prior + bank.log_weight - log_sum_exp(bank.log_weight)
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot] = state.next_wall_id, state.epoch
    heard = state.heard.copy()
    heard[(heard[:, 1] == line.anchor) & np.isin(heard[:, 2], line.length_m), 5] = 0.0
    return replace(
        state,
        rows=state.rows.joined(new),
        slots=slots,
        next_wall_id=state.next_wall_id + 1,
        heard=heard,
    )


def _settled(state: GaussianState, k: int) -> bool:
    """Whether the hypotheses agree on the place of anchor ``k``: of a misplaced one, false walls are born."""
    rows, place = state.rows, state.layout.anchor_xy(k)
    if not rows.located[:, k].all():
        return False
    weight = np.exp(rows.log_weight)
    _, covariance = moments(weight / weight.sum(), rows.mean[:, place], rows.covariance[:, place, place])
    return bool(np.trace(covariance) < _SETTLED_M**2)
