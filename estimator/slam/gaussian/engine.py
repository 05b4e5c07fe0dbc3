"""The Gaussian engine: hybrid SLAM with one joint, gauge-separated Gaussian per hypothesis.

``step`` takes one epoch into a state; the state before the first epoch comes from
:func:`estimator.slam.gaussian.start.start`. Online and offline use call the same function.

    predict -> take sweep -> gate, associate, branch, update -> initialise anchors
    -> path buffer -> births -> reduce the mixture -> lifecycle (confirm, delete) -> integrity
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.measurements import AnchorPaths, Epoch
from estimator.slam.gaussian.anchor_survey import (
    forget_guesses,
    is_tracked,
    survey,
)
from estimator.slam.gaussian.anchors import initialise_anchors
from estimator.slam.gaussian.births.virtual_anchors import bear_virtual_anchors, shorter_than_sight
from estimator.slam.gaussian.births.walls import bear_wall
from estimator.slam.gaussian.clutter import clutter_density
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.estimate import estimate
from estimator.slam.gaussian.free_clock import guess_clock, on_present_clock, to_remember
from estimator.slam.gaussian.integrity import is_lost, possible_evidence, with_epoch
from estimator.slam.gaussian.lifecycle import (
    delete_corners,
    delete_redundant,
    existence_odds,
    judge_tentative,
    prune_confirmed,
)
from estimator.slam.gaussian.path_relocation import search_elsewhere
from estimator.slam.gaussian.phase import Phase, phase_of
from estimator.slam.gaussian.predict import predict
from estimator.slam.gaussian.recalled_track import Move
from estimator.slam.gaussian.reclassification import associated_now
from estimator.slam.gaussian.start import start
from estimator.slam.gaussian.state import GaussianState, Outset, load_state, save_state
from estimator.slam.gaussian.sweep_stage import follow_sweep
from estimator.slam.gaussian.turns import with_doubt
from estimator.slam.gaussian.update import update_hypotheses
from estimator.slam.methods import METHODS, Method, note_unused, walls_at_start
from estimator.slam.mixture_reduction import reduce_mixture
from estimator.slam.models.clutter_guard import guard_clutter
from estimator.slam.models.epoch_paths import EpochPaths, stack_paths
from estimator.slam.models.extents import widen_extents
from estimator.slam.models.features import active_features
from estimator.slam.models.hypotheses import Hypotheses, log_sum_exp, normalised_weights
from estimator.slam.models.noise_level import believed, learned
from estimator.slam.models.path_loss import learn_losses
from estimator.slam.protocol import Estimate, Prior

__all__ = ["GaussianEngine", "step"]

Array = NDArray[np.float64]


def step(
    state: GaussianState, epoch: Epoch, config: GaussianConfig, rng: np.random.Generator | None = None
) -> GaussianState:
    """Take one epoch into the state.

    Parameters
    ----------
    state : GaussianState
        The state after the previous epoch; it is not changed.
    epoch : Epoch
        The next epoch: a larger index and time than the state's. Anchors with more than ``most_paths``
        paths count as not heard.
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
    _check(state, epoch)
    place_before, _, spread_before = _place(state.hypotheses)
    reach_m = config.motion.fastest_m_s * (epoch.time_s - state.time_s if state.epoch >= 0 else 0.0)
    phase = phase_of(
        state.buffer.epochs,
        state.shared and state.blind,
        config.phases,
        config.reduction,
        config.lifecycle,
    )
    epoch = guard_clutter(epoch, config.noise.most_paths)
    paths = stack_paths(epoch, state.carrier_hz, state.bearing_rad)
    paths = believed(paths, config.noise.range_std_m, state.levels, epoch.time_s, config.noise_level.model)
    earlier = state
    state, move = _predict(state, epoch, config)
    predicted = state
    if epoch.sweep and state.shared:
        state = follow_sweep(state, epoch, paths, config, phase)
    clutter = clutter_density(state.buffer, state.layout.anchors, state.blind, config.noise, config.clutter)
    regained = False
    if state.shared and not state.swept_within(config.sweeps.often_epochs):
        state, regained = search_elsewhere(state, paths, clutter, config)
    before, unlabelled = state.log_evidence, state.hypotheses
    state, explained = _update(state, paths, clutter, config)
    state = on_present_clock(state, earlier.hypotheses, config)
    located = state.hypotheses.located[state.hypotheses.best]
    signs = (
        float(paths.valid[located].sum()),
        float((paths.valid & (explained < 0.5))[located].sum()),
        possible_evidence(paths, located, clutter) - (state.log_evidence - before),
    )
    if is_tracked(state, config.anchors) and not epoch.sweep:
        state = state.but(
            hypotheses=with_doubt(state.hypotheses, unlabelled, config.sweeps.mislabelled_probability)
        )
    lost = state.shared and is_lost(state.indicators, config.integrity)
    if not lost:
        state = _locate(state, paths, config, phase)
    state = _remember(state, paths, explained, config)
    if not lost:
        state = _bear(state, config, phase)
    reduced = reduce_mixture(state.hypotheses, config.reduce_model(phase, state.layout))
    state = _live_on(state.but(hypotheses=reduced), config, phase)
    if state.shared:
        state = survey(state, predicted.hypotheses, move, paths, config, config.search)
    place, std, spread = _place(state.hypotheses)
    jump_m = float(np.linalg.norm(place - place_before))
    if jump_m < reach_m + config.integrity.jump_sigma * (spread_before + spread):
        jump_m = 0.0
    untold = state.epoch - max(state.swept_epoch, state.tracked_epoch)
    indicators = with_epoch(state.indicators, *signs, std, jump_m, untold, config.integrity, regained)
    return state.but(indicators=indicators)


def _place(hypotheses: Hypotheses) -> tuple[Array, float, float]:
    """Where the agent of the likeliest hypothesis is, its standard deviation, and that of all; metres."""
    best = hypotheses.best
    place, own = hypotheses.mean[best, :2], np.trace(hypotheses.covariance[:, :2, :2], axis1=1, axis2=2)
    square = own + np.sum((hypotheses.mean[:, :2] - place) ** 2, axis=1)
    spread = normalised_weights(hypotheses.log_weight) @ square
    return place, float(np.sqrt(own[best])), float(np.sqrt(spread))


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


def _predict(state: GaussianState, epoch: Epoch, config: GaussianConfig) -> tuple[GaussianState, Move]:
    """The state at the epoch before its measurements; the first epoch is where the state begins."""
    if state.epoch < 0:
        state = state.but(time_s=epoch.time_s, first_time_s=epoch.time_s)
        return state.but(epoch=epoch.index), Move(0.0, config.motion.driving(0.0), False, 1)
    soon = epoch.index - state.swept_epoch <= config.sweeps.often_epochs
    if state.outset.mean.size and (state.tracked_epoch >= 0 or not (soon and state.shared)):
        state = state.but(outset=Outset.gone(state.layout.anchors))
    by_odometry = epoch.odometry is not None
    if state.shared and (by_odometry or (epoch.sweep and soon)):
        state = forget_guesses(state, config)
    if state.shared and by_odometry:
        state = state.but(tracked_epoch=epoch.index)
    may_turn = state.shared and (bool(epoch.sweep) or is_tracked(state, config.anchors))
    step_s = epoch.time_s - state.time_s
    hypotheses = predict(state.layout, state.hypotheses, epoch, step_s, may_turn, config)
    move = Move(step_s, config.motion.driving(step_s), by_odometry, state.hypotheses.number)
    return state.but(epoch=epoch.index, time_s=epoch.time_s, hypotheses=hypotheses), move


def _update(
    state: GaussianState, paths: EpochPaths, clutter: Array, config: GaussianConfig
) -> tuple[GaussianState, Array]:
    """Gate, associate, branch and update; how far (K, M) the likeliest hypothesis explains the paths.

    A state without any located anchor waits.
    """
    before, slots, layout = state.hypotheses, state.slots, state.layout
    if not before.located.any():
        return state, np.zeros(paths.length_m.shape)
    before = guess_clock(state, paths, clutter, config)
    best = before.best
    levels = learned(
        layout,
        before.mean[best],
        before.covariance[best],
        active_features(layout, before.located[best], before.present[best], slots.confirmed, slots.owner),
        before.visibility[best],
        paths,
        clutter,
        state.levels,
        state.time_s,
        config.noise_level.model,
    )
    done = update_hypotheses(layout, *config.kernels, before, slots.confirmed, slots.owner, paths, clutter)
    after, weight = done.hypotheses, done.hypotheses.log_weight
    if not layout.shared:
        weight -= config.virtual_births.virtual_forgetting * before.log_weight[done.parent]
        weight += shorter_than_sight(
            layout,
            after.mean,
            done.explained,
            paths,
            config.noise.clutter_density,
            clutter,
            config.gating.gate_sigma,
            config.noise.range_std_m,
        )
    evidence = log_sum_exp(weight)
    weight -= evidence
    best = after.best
    detected, expected = done.detected[best], before.visibility[done.parent[best]]
    sure = np.where(expected > config.corrections.sure_expected, detected, 0.0)
    extent, detected_from = widen_extents(
        layout, after.mean[best], sure, slots.extent_m, slots.detected_from_m
    )
    odds = slots.log_odds
    if layout.shared:
        odds = existence_odds(
            layout,
            after.mean[best],
            after.located[best],
            after.present[best],
            slots.confirmed,
            detected,
            paths.number > 0,
            slots.extent_m,
            slots.detected_from_m,
            odds,
            config.lifecycle.expected_probability,
            config.lifecycle.extent_margin_m,
            config.lifecycle.revisit_m,
            config.lifecycle.most_log_odds,
        )
    slots = slots._replace(extent_m=extent, detected_from_m=detected_from, log_odds=odds)
    return (
        state.but(hypotheses=after, slots=slots, levels=levels, log_evidence=state.log_evidence + evidence),
        done.explained[best],
    )


def _locate(state: GaussianState, paths: EpochPaths, config: GaussianConfig, phase: Phase) -> GaussianState:
    """Locate anchors: surveyed where the track is known without them, or else searched at once."""
    if not state.shared:
        return initialise_anchors(state, paths, config, phase)
    if is_tracked(state, config.anchors):
        return state
    return initialise_anchors(state, paths, config, phase)


def _remember(
    state: GaussianState, paths: EpochPaths, explained: Array, config: GaussianConfig
) -> GaussianState:
    """The path buffer with this epoch: where the agent is, and what nothing explains."""
    hypotheses, layout, model = state.hypotheses, state.layout, config.reclassification
    best = hypotheses.best
    mean, covariance = hypotheses.mean[best], hypotheses.covariance[best]
    associated = associated_now(
        layout,
        mean,
        covariance,
        hypotheses.located[best],
        hypotheses.present[best],
        state.slots.confirmed,
        state.slots.owner,
        paths,
        explained,
        model.explained_probability,
        model.pair_radius_m if layout.shared else model.beside_sigma * config.noise.range_std_m,
        model.beside_sigma,
        model.farthest_m,
    )
    window = config.births.birth_window if layout.shared else config.virtual_births.virtual_window
    std = float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))
    heard, kept = to_remember(state, paths, config), max(window, config.anchors.start_window)
    buffer = state.buffer.with_epoch(state.epoch, mean[:2], std, heard, associated, kept)
    return state.but(buffer=buffer)


def _bear(state: GaussianState, config: GaussianConfig, phase: Phase) -> GaussianState:
    """New walls or virtual anchors that the buffer's paths ask for, unless noise is more than is believed."""
    if np.any(state.levels.misfit > config.noise_level.doubt_level):
        return state
    if not state.shared:
        return bear_virtual_anchors(state, config, config.reduction.max_hypotheses)
    if state.epoch % config.path_loss.loss_stride == 0:
        sensed = np.flatnonzero((state.slots.wall_id >= 0) & (state.slots.born < 0))
        losses = learn_losses(
            state.losses_db,
            state.hypotheses,
            state.layout,
            sensed,
            state.buffer,
            config.noise.range_std_m,
            config.path_loss,
        )
        state = state.but(losses_db=losses)
    return bear_wall(state, config, phase.prune_nats)


def _live_on(state: GaussianState, config: GaussianConfig, phase: Phase) -> GaussianState:
    """Confirm and delete walls."""
    model, visibility = config.lifecycle, config.visibility
    if state.slots.tentative.size:
        state = judge_tentative(state, model, visibility, phase.confirm_support)
    if state.shared and state.epoch % model.redundancy_stride == 0:
        state = delete_corners(state, model, visibility, state.swept_within(config.sweeps.often_epochs))
    if np.any(state.slots.confirmed & (state.slots.born >= 0)):
        if state.shared and state.epoch % model.redundancy_stride == 0:
            state = delete_redundant(state, model, visibility, config.reclassification.pair_radius_m)
        state = prune_confirmed(state, model, visibility)
    return state


@dataclass(frozen=True)
class GaussianEngine:
    """The joint, gauge-separated Gaussian filter with hypotheses; draws no random numbers.

    Parameters
    ----------
    config : GaussianConfig
        Models and limits.
    method : Method
        What is known and sensed.
    """

    config: GaussianConfig
    method: Method = METHODS["hybrid"]
    name: str = "gaussian"

    @cached_property
    def models(self) -> GaussianConfig:
        """The configuration; where no wall is sensed at the start, walls are confirmed later.

        The first walls are born from a track that only lines of sight have told, of which a
        mirror image explains most paths nearly as well.
        """
        if self.method.walls:
            return self.config
        return self.config.but(
            birth_trust=0.5 * self.config.births.birth_trust,
            confirm_support=2 * self.config.lifecycle.confirm_support,
            confirm_weight=1.0 - 0.25 * (1.0 - self.config.lifecycle.confirm_weight),
        )

    def start(self, prior: Prior, rng: np.random.Generator) -> GaussianState:
        """See :func:`estimator.slam.gaussian.start.start`; raises InputError if known anchors are lacking.

        Anchors that are known are used by every method that hears paths, with the walls sensed at the start
        if the method uses these; what it leaves aside is noted.
        """
        required = self.method.anchors == "known"
        if required and prior.anchors_m is None:
            raise InputError(f"method {self.method.name}: expected known anchors, the measurements have none")
        known = required or (self.method.paths and prior.anchors_m is not None)
        note_unused(self.method, prior, anchors_used=known)
        return start(
            walls_at_start(self.method, prior),
            prior.anchor_names,
            prior.carrier_hz,
            self.models,
            prior.anchors_m if known else None,
            self.method.shared,
            prior.sweeps and self.method.walls,
        )

    def step(self, state: GaussianState, epoch: Epoch, rng: np.random.Generator) -> GaussianState:
        """See :func:`step`; a method that hears no paths gets none."""
        if not self.method.paths:
            epoch = replace(epoch, paths=(AnchorPaths.none(),) * len(epoch.paths))
        return step(state, epoch, self.models)

    def estimate(self, state: GaussianState) -> Estimate:
        """See :func:`estimator.slam.gaussian.estimate.estimate`."""
        return estimate(state, self.models)

    def save(self, state: GaussianState) -> bytes:
        """See :func:`estimator.slam.gaussian.state.save_state`."""
        return save_state(state)

    def load(self, data: bytes) -> GaussianState:
        """See :func:`estimator.slam.gaussian.state.load_state`."""
        return load_state(data)
