"""The Gaussian engine: hybrid SLAM with one joint, gauge-separated Gaussian per hypothesis.

``step`` takes one epoch of path lengths into a state; the state before the first
epoch comes from :func:`estimator.slam.gaussian.start.start`. Online and offline use call the
same function. ``step_many`` takes an epoch into each of many runs, in one array; ``step`` is the
batch of one.

    predict the agent -> associate and correct all hypotheses -> take a sweep -> locate anchors
    -> remember the unexplained -> start walls -> prune and merge -> confirm walls
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.measurements import Epoch
from estimator.slam.anchors.locate import locate_anchors, may_locate
from estimator.slam.births.mirrors import bear_virtual_anchors, shorter_than_sight
from estimator.slam.births.walls import find_line, may_bear, wall_bank
from estimator.slam.config import GaussianConfig
from estimator.slam.floods import without_floods
from estimator.slam.gaussian.hindsight import look_back
from estimator.slam.gaussian.hypotheses import moments, tidy_pool
from estimator.slam.gaussian.levels import learn_levels, loss_limits
from estimator.slam.gaussian.memory import clutter_density, remember, widen_spans, widen_stretches
from estimator.slam.gaussian.paths import PathTable, pool_paths
from estimator.slam.gaussian.pool import Pool, active_of
from estimator.slam.gaussian.slots import judge, may_judge, open_slot, retire
from estimator.slam.gaussian.state import GaussianState, Rows, log_sum_exp
from estimator.slam.gaussian.sweeps import take_sweep
from estimator.slam.gaussian.update import correct
from estimator.slam.layout import Layout
from estimator.slam.motion import predict_motion

__all__ = ["step", "step_many"]

Array = NDArray[np.float64]
_EXPECTED = (
    0.7  # a bounce tells how far a wall extends if it was expected this surely: one hit may be clutter
)
_SETTLED_M = 1.5  # standard deviation of an anchor from which walls may be born
_MANY_ROWS = 48  # from which a run gains nothing from company: its arrays fill the cache
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
    return step_many([state], [epoch], config)[0]


def step_many(
    states: Sequence[GaussianState], epochs: Sequence[Epoch], config: GaussianConfig
) -> list[GaussianState]:
    """Take one epoch into each of several independent runs.

    The rows of all runs that have the same layout are predicted, associated and corrected as one
    array; a run's result is that of :func:`step` to rounding. Once the first epochs have
    settled, a run in a batch takes about a tenth of its time alone.

    Parameters
    ----------
    states : sequence of GaussianState
        The states of B runs; they are not changed. Runs may have different anchors, walls and epochs.
    epochs : sequence of Epoch
        The next epoch of each. Anchors with more than 200 paths count as unheard
        (:mod:`estimator.slam.floods`).
    config : GaussianConfig
        Models of all of them.

    Returns
    -------
    list of GaussianState

    Raises
    ------
    InputError
        If there are not as many epochs as states, or an epoch is not later than its state or has another
        number of anchors.
    """
    if len(states) != len(epochs):
        raise InputError(f"epochs: expected one for each of {len(states)} states, got {len(epochs)}")
    for state, epoch in zip(states, epochs, strict=True):
        _check(state, epoch)
    epochs = [without_floods(epoch) for epoch in epochs]
    groups: dict[tuple[bool, bool, *tuple[Hashable, ...]], list[int]] = {}
    for i, (state, epoch) in enumerate(zip(states, epochs, strict=True)):
        passed = None if state.epoch < 0 else epoch.time_s - state.time_s
        first = len(state.trail) < _FIRST_EPOCHS
        alone = i if len(state.rows) > _MANY_ROWS else -1
        angles = any(paths.azimuth_rad is not None for paths in epoch.paths)
        blind = state.shared and state.blind
        key = (first, blind, alone, state.layout, passed, angles, epoch.heading_held)
        groups.setdefault(key, []).append(i)
    result = list(states)
    for (first, blind, *_), members in groups.items():
        models = config.widened() if first else config
        models = models.blind() if blind else models
        group = _step_alike([states[i] for i in members], [epochs[i] for i in members], models)
        for i, state in zip(members, group, strict=True):
            result[i] = state
    return result


def _check(state: GaussianState, epoch: Epoch) -> None:
    if len(epoch.paths) != len(state.anchor_names):
        raise InputError(
            f"epoch {epoch.index}: expected paths of {len(state.anchor_names)} anchors, "
            f"got {len(epoch.paths)}"
        )
    if state.epoch >= 0 and (epoch.index <= state.epoch or not epoch.time_s > state.time_s):
        raise InputError(
            f"epoch {epoch.index} at {epoch.time_s} s: expected one later than epoch {state.epoch} "
            f"at {state.time_s} s"
        )


def _step_alike(
    states: list[GaussianState], epochs: list[Epoch], config: GaussianConfig
) -> list[GaussianState]:
    """Runs with one layout, the same time since their last epoch and the same kind of measurements."""
    pool = Pool.of(states)
    paths = pool_paths(epochs, [state.carrier_hz for state in states])
    if states[0].epoch >= 0:
        pool = Pool(_predict(pool.rows, epochs[0].time_s - states[0].time_s, config), pool.count)
    told = _correct(states, pool, paths, config)
    states = [
        state.but(
            epoch=epoch.index,
            time_s=epoch.time_s,
            rows=rows,
            log_evidence=state.log_evidence + gained,
            slots=state.slots.but(span_m=span, heard_from_m=stretch),
        )
        for state, epoch, rows, gained, span, stretch in zip(
            states,
            epochs,
            told.pool.apart(),
            told.log_evidence.tolist(),
            told.span_m,
            told.heard_from_m,
            strict=True,
        )
    ]
    corrected = list(states)
    for i, epoch in enumerate(epochs):
        if epoch.sweep and states[i].shared:
            states[i] = take_sweep(states[i], epoch.sweep, epoch.heading_held, config)
        if may_locate(states[i]):
            states[i] = locate_anchors(states[i], paths.of_run(i), config)
    for members in _of_one_layout(states):  # a sweep may have shown one run a new wall
        group, before = [states[i] for i in members], [corrected[i] for i in members]
        known = _pooled(group, before, told.pool, len(members) == len(states))
        group = remember(group, known, paths.of_rows(np.array(members)), told.explained[members], config)
        for i, state in zip(members, _born(group, config), strict=True):
            states[i] = state
    for members in _of_one_layout(states):
        group, before = [states[i] for i in members], [corrected[i] for i in members]
        pool = tidy_pool(_pooled(group, before, told.pool, len(members) == len(states)), config)
        asked = may_judge(group)
        for i, state, rows in zip(members, group, pool.apart(), strict=True):
            states[i] = state.but(rows=rows)
        doubted = [members[j] for j in np.flatnonzero(asked).tolist()]
        judged = [judge(states[i], config) for i in doubted]
        for i, state in zip(doubted, retire(judged, config), strict=True):
            states[i] = state
    return states


def _of_one_layout(states: list[GaussianState]) -> list[list[int]]:
    """The runs, in groups of one layout."""
    groups: dict[Layout, list[int]] = {}
    for i, state in enumerate(states):
        groups.setdefault(state.layout, []).append(i)
    return list(groups.values())


def _born(states: list[GaussianState], config: GaussianConfig) -> list[GaussianState]:
    """The states of runs with one layout, with the walls or virtual anchors that their paths ask for."""
    if not states[0].shared:
        return [bear_virtual_anchors(state, config) for state in states]
    states = [learn_levels(state, config) for state in states]
    for i in may_bear(states, config):
        states[i] = _bear(states[i], config)
    return states


def _pooled(states: list[GaussianState], before: list[GaussianState], pool: Pool, every: bool) -> Pool:
    """The rows of states: ``pool``, if it is of ``every`` run and no rows changed since ``before``."""
    same = every and all(a.rows is b.rows for a, b in zip(states, before, strict=True))
    return pool if same else Pool.of(states)


def _predict(rows: Rows, step_s: float, config: GaussianConfig) -> Rows:
    """The agent moves on; features may appear and vanish."""
    mean, covariance = predict_motion(rows.mean, rows.covariance, step_s, config.acceleration_variance)
    stay, appear = 1.0 - config.vanish_probability, config.appear_probability
    visibility = stay * rows.visibility + appear * (1.0 - rows.visibility)
    return rows.but(mean=mean, covariance=covariance, visibility=visibility)


@dataclass(frozen=True, eq=False)
class _Told:
    """What the paths of an epoch do to B runs.

    Parameters
    ----------
    pool : Pool
        The corrected rows.
    log_evidence : ndarray, shape (B,)
        Log evidence of the paths.
    span_m, heard_from_m : ndarray, shapes (B, L, 2) and (B, L, K, 2, 2)
        Those of :class:`estimator.slam.gaussian.state.Slots`.
    explained : ndarray, shape (B, K, M)
        How far the best row of each run explains each path.
    """

    pool: Pool
    log_evidence: Array
    span_m: Array
    heard_from_m: Array
    explained: Array


def _correct(states: list[GaussianState], pool: Pool, paths: PathTable, config: GaussianConfig) -> _Told:
    """Associate and update all rows; those of runs without any anchor wait."""
    layout, rows = states[0].layout, pool.rows
    spans = np.array([state.slots.span_m for state in states])
    stretches = np.array([state.slots.heard_from_m for state in states])
    ready = np.logical_or.reduceat(rows.located.any(axis=1), pool.begin).nonzero()[0]
    if ready.size < len(states):
        evidence, explained = np.zeros(len(states)), np.zeros(paths.length_m.shape)
        if ready.size:
            parts = pool.apart()
            some = Pool.joined([parts[i] for i in ready.tolist()])
            told = _correct([states[i] for i in ready.tolist()], some, paths.of_rows(ready), config)
            for i, part in zip(ready.tolist(), told.pool.apart(), strict=True):
                parts[i] = part
            pool = Pool.joined(parts)
            evidence[ready], explained[ready] = told.log_evidence, told.explained
            spans[ready], stretches[ready] = told.span_m, told.heard_from_m
        return _Told(pool, evidence, spans, stretches, explained)
    table = paths.turned([-state.bearing_rad for state in states]).of_rows(pool.run)
    clutter = clutter_density(states, config)[pool.run]
    active = active_of(pool, states, layout)
    done = correct(
        rows.mean,
        rows.covariance,
        rows.visibility,
        active,
        table,
        layout,
        config,
        clutter,
        pool.run,
        rows.log_weight,
    )
    if len(done.parent) > len(rows):
        rows = rows.take(done.parent)
    expected, weight = rows.visibility, rows.log_weight + done.log_evidence
    if not layout.shared:
        weight -= config.virtual_forgetting * rows.log_weight
        of = done.parent
        weight += shorter_than_sight(done, table.of_rows(of), layout, config, clutter[of])
    heard = (done.heard[:, :, 1 : 1 + layout.slots] > 0.5).any(axis=1)
    rows = rows.but(
        log_weight=weight,
        mean=done.mean,
        covariance=done.covariance,
        visibility=done.visibility,
        support=rows.support + heard,
    )
    pool = Pool(rows, np.bincount(pool.run[done.parent], minlength=len(states)))
    evidence = pool.log_sum_exp(weight)
    rows.log_weight[...] -= evidence[pool.run]
    best = pool.best()
    again = np.where(expected[best] > _EXPECTED, done.heard[best], 0.0)
    return _Told(
        pool,
        evidence,
        widen_spans(spans, rows.mean[best], again, layout),
        widen_stretches(stretches, rows.mean[best], again, layout),
        done.explained[best],
    )


def _bear(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Start a wall where recent unexplained paths ask for one; one wall at a time."""
    limit = loss_limits(state, config)
    line = find_line(state.loose, state.epoch, limit, config)
    if line is None or not _settled(state, line.anchor):
        return state
    past = look_back(state, config)
    state = past.state
    line = find_line(state.loose, state.epoch, limit, config)
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
    jacobian = bank.jacobian(state.layout, line.anchor)
    cross = jacobian @ new.covariance
    new.covariance[:, columns, :] = cross
    new.covariance[:, :, columns] = cross.transpose(0, 2, 1)
    new.covariance[:, columns, columns] = cross @ jacobian.transpose(0, 2, 1) + bank.covariance_m2
    new.present[:, slot] = True
    new.log_weight[...] += config.birth_log_prior + bank.log_weight - log_sum_exp(bank.log_weight)
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot] = state.next_wall_id, state.epoch
    heard = state.heard.copy()
    heard[(heard[:, 1] == line.anchor) & np.isin(heard[:, 2], line.length_m), 5] = 0.0
    return state.but(
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
