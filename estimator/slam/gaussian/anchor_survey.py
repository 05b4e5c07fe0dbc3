"""Surveyed anchors in the joint state: those that wait, and those that turn out to stand elsewhere.

While echoes tell the track, no anchor starts from an early guess: it waits until one place beats all others
(:mod:`estimator.slam.anchors.survey`), and enters all hypotheses there; the next epochs' paths correlate it
with the rest. Located ones are surveyed again now and then, moved where another place is clearly likelier,
and forgotten where theirs is clearly no longer the likeliest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors import AnchorSearchConfig
from estimator.slam.anchors.cells import heights_of
from estimator.slam.anchors.observations import direct_ratio, gathered
from estimator.slam.anchors.search import scene_of
from estimator.slam.anchors.survey import Survey, survey_anchor
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.models.path_loss import known_gain_offsets
from estimator.slam.models.state_vector import NOWHERE_M
from estimator.slam.models.visibility import prior_visibility

__all__ = ["forget_guesses", "is_track_known", "is_tracked", "survey_anchors", "surveyed_paths"]

Array = NDArray[np.float64]
_KNOWN_M2 = 1e-12  # variance of an anchor known from the start, left by rounding where hypotheses were merged


def is_tracked(state: GaussianState, config: AnchorSearchConfig) -> bool:
    """Whether sweeps or odometry have told of the agent's motion lately."""
    return state.tracked_epoch >= 0 and state.epoch - state.tracked_epoch <= config.survey_patience


def forget_guesses(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """The state where its motion is first told: anchors that were guessed wait for their survey."""
    if state.tracked_epoch >= 0 or state.surveyed.epochs >= config.anchors.survey_least:
        return state
    best = state.hypotheses.best
    for k in np.flatnonzero(state.hypotheses.located.any(axis=0)).tolist():
        place = state.layout.anchor_xy(k)
        if np.trace(state.hypotheses.covariance[best, place, place]) >= _KNOWN_M2:
            state = _without_anchor(state, k, config)
    return state


def is_track_known(state: GaussianState, config: AnchorSearchConfig) -> bool:
    """Whether sweeps or odometry tell the track well enough to survey anchors from it."""
    if not is_tracked(state, config):
        return False
    best = state.hypotheses.best
    variance = 0.5 * float(np.trace(state.hypotheses.covariance[best, :2, :2]))
    return variance < config.survey_track_std_m**2


def surveyed_paths(state: GaussianState, paths: EpochPaths, config: AnchorSearchConfig) -> PathBuffer:
    """The paths along the track with this epoch's, if the agent has come on and is known to be there."""
    track, best = state.surveyed.track, state.hypotheses.best
    mean, covariance = state.hypotheses.mean[best], state.hypotheses.covariance[best]
    std = float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))
    if std > config.survey_track_std_m or not paths.number.any():
        return state.surveyed
    kept, count = state.surveyed, len(track.epoch)
    if count:
        apart = np.hypot(*np.diff(track.position_m, axis=0).T)
        step = max(config.survey_step_m, 0.9 * float(np.min(apart, initial=np.inf)) if count > 1 else 0.0)
        if np.hypot(*(mean[:2] - track.position_m[-1])) < step:
            return kept
    if count >= config.survey_track:
        kept = kept.thinned()
    unused = np.zeros(paths.length_m.shape, dtype=np.bool_)
    return kept.with_epoch(state.epoch, mean[:2], std, paths, unused, state.epoch + 1)


def survey_anchors(state: GaussianState, config: GaussianConfig, search: AnchorSearchConfig) -> GaussianState:
    """Locate, move and forget anchors as their surveys say.

    Parameters
    ----------
    state : GaussianState
        State with corrected hypotheses, the present paths among those surveyed.
    config : GaussianConfig
        Models.
    search : AnchorSearchConfig
        Limits of this epoch.
    """
    for k in range(state.layout.anchors):
        located = bool(state.hypotheses.located[state.hypotheses.best, k])
        stride = search.survey_recheck_stride if located else search.survey_stride
        if (state.epoch + k) % stride == 0:
            state = _survey_one(state, k, config, search)
    return state


def _survey_one(
    state: GaussianState, k: int, config: GaussianConfig, search: AnchorSearchConfig
) -> GaussianState:
    hypotheses, layout, log = state.hypotheses, state.layout, state.surveyed
    best = hypotheses.best
    mean, covariance = hypotheses.mean[best], hypotheses.covariance[best]
    located, bias = bool(hypotheses.located[best, k]), layout.bias(k)
    if covariance[bias, bias] > search.clock_step_m**2:
        return state
    own = log.anchor == k
    heard = np.unique(log.epoch[own])
    few = np.linspace(0, heard.size - 1, min(heard.size, search.survey_epochs))
    heard = heard[few.round().astype(np.int64)]
    place = layout.anchor(k)
    if heard.size < search.survey_least or (
        located and np.trace(covariance[place, place][:2, :2]) < _KNOWN_M2
    ):
        return state
    gain = float(known_gain_offsets(state.losses_db, config.path_loss)[k])
    rows = log.row_of(heard)
    epochs = []
    for epoch in heard.tolist():
        these = np.flatnonzero(own & (log.epoch == epoch))
        variance = np.maximum(log.std_m[these], config.heard.range_std_m) ** 2
        epochs.append((log.length_m[these], variance, direct_ratio(log.excess_loss_db[these] - gain, search)))
    seen = gathered(log.track.position_m[rows], log.track.std_m[rows] ** 2, epochs)
    walls = np.flatnonzero(hypotheses.present[best] & state.slots.confirmed)
    vrp = mean[layout.walls].reshape(-1, 2)[walls]
    spread = np.array([covariance[layout.wall(s), layout.wall(s)] for s in walls.tolist()]).reshape(-1, 2, 2)
    scene = scene_of(seen, vrp, spread, config.noise, search, float(covariance[bias, bias]))
    present = mean[place][:3] if located else None
    found = survey_anchor(scene, float(mean[bias]), heights_of(search)[0], present, search)
    return _decided(state, k, found, config, search)


def _decided(
    state: GaussianState, k: int, found: Survey, config: GaussianConfig, search: AnchorSearchConfig
) -> GaussianState:
    """The state after a survey of anchor ``k``."""
    best, layout = state.hypotheses.best, state.layout
    located = bool(state.hypotheses.located[best, k])
    if not len(found.place):
        return state
    here = state.hypotheses.mean[best, layout.anchor_xy(k)]
    moved = float(np.hypot(*(found.place[0, :2] - here)))
    known = state.hypotheses.covariance[best, layout.anchor_xy(k), layout.anchor_xy(k)]
    spread = float(np.trace(known) + np.trace(found.covariance[0, :2, :2]))
    if located and moved < max(search.survey_apart_m, search.search_gate_sigma * np.sqrt(spread)):
        return state
    if found.margin(0, search.survey_apart_m) > search.survey_nats:
        return _with_anchor(state, k, found.place[0], found.covariance[0], config, search)
    if located:
        present = found.log_evidence[found.present] if found.present >= 0 else -np.inf
        if found.log_evidence[0] - present > search.survey_nats:
            return _without_anchor(state, k, config)
    return state


def _without_anchor(state: GaussianState, k: int, config: GaussianConfig) -> GaussianState:
    """All hypotheses with anchor ``k`` not located."""
    layout, noise = state.layout, config.noise
    hypotheses = state.hypotheses.take(np.arange(state.hypotheses.number))
    w = layout.height2(k)
    known = slice(layout.anchor(k).start, w + 1)
    hypotheses.covariance[:, known, :] = 0.0
    hypotheses.covariance[:, :, known] = 0.0
    hypotheses.mean[:, known] = NOWHERE_M, 0.0, noise.height2_mean_m2
    hypotheses.covariance[:, w, w] = noise.height2_std_m2**2
    hypotheses.located[:, k] = False
    hypotheses.visibility[:, k] = prior_visibility(layout, config.visibility)
    return state.but(hypotheses=hypotheses)


def _with_anchor(
    state: GaussianState,
    k: int,
    place: Array,
    covariance: Array,
    config: GaussianConfig,
    search: AnchorSearchConfig,
) -> GaussianState:
    """All hypotheses with anchor ``k`` at a surveyed place (3,)."""
    state = _without_anchor(state, k, config)
    hypotheses, std = state.hypotheses, search.survey_start_std_m
    known = slice(state.layout.anchor(k).start, state.layout.height2(k) + 1)
    height = 2.0 * np.sqrt(place[2]) * std + std**2
    hypotheses.mean[:, known] = place
    hypotheses.covariance[:, known, known] = covariance + np.diag([std**2, std**2, height**2])
    hypotheses.located[:, k] = True
    return state.but(hypotheses=hypotheses)
