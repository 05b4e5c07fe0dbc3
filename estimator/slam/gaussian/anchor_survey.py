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
from estimator.slam.gaussian.recalled_track import Move
from estimator.slam.gaussian.start import begun_again
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.path_loss import known_gain_offsets
from estimator.slam.models.state_vector import NOWHERE_M
from estimator.slam.models.visibility import prior_visibility

__all__ = ["forget_guesses", "is_track_known", "is_tracked", "survey", "survey_anchors", "with_survey_place"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_KNOWN_M2 = 1e-12  # variance of an anchor known from the start, left by rounding where hypotheses were merged


def is_tracked(state: GaussianState, config: AnchorSearchConfig) -> bool:
    """Whether sweeps or odometry have told of the agent's motion lately."""
    return state.tracked_epoch >= 0 and state.epoch - state.tracked_epoch <= config.survey_patience


def forget_guesses(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """The state where its motion is first told: anchors that were guessed wait for their survey.

    Shortly after the start all is forgotten that they told of walls, too.
    """
    if state.tracked_epoch >= 0 or state.surveyed.epochs >= config.anchors.survey_least:
        return state
    if state.outset.mean.size:
        return begun_again(state, config)
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


def with_survey_place(state: GaussianState, paths: EpochPaths, config: AnchorSearchConfig) -> GaussianState:
    """The state with this epoch's place and paths among those surveyed, if the agent has come on."""
    track, best = state.surveyed.track, state.hypotheses.best
    mean, covariance = state.hypotheses.mean[best], state.hypotheses.covariance[best]
    std = float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))
    if std > config.survey_track_std_m or not paths.number.any():
        return state
    kept, recalled, count = state.surveyed, state.recalled, len(track.epoch)
    if count:
        apart = np.hypot(*np.diff(track.position_m, axis=0).T)
        step = max(config.survey_step_m, 0.9 * float(np.min(apart, initial=np.inf)) if count > 1 else 0.0)
        if np.hypot(*(mean[:2] - track.position_m[-1])) < step:
            return state
    if count >= config.survey_track:
        kept, recalled = kept.thinned(), recalled.every_other()
    unused = np.zeros(paths.length_m.shape, dtype=np.bool_)
    kept = kept.with_epoch(state.epoch, mean[:2], std, paths, unused, state.epoch + 1)
    return state.but(surveyed=kept, recalled=recalled.with_place(mean, covariance))


def survey(
    state: GaussianState,
    predicted: Hypotheses,
    move: Move,
    paths: EpochPaths,
    config: GaussianConfig,
    search: AnchorSearchConfig,
) -> GaussianState:
    """Recall the places passed as they are known after an epoch; survey anchors from them where that is well.

    Parameters
    ----------
    state : GaussianState
        State after the epoch.
    predicted : Hypotheses
        At the epoch, before its measurements.
    move : Move
        How they were predicted.
    paths : EpochPaths
        Its paths.
    config : GaussianConfig
        Models.
    search : AnchorSearchConfig
        Limits of this epoch.
    """
    if is_tracked(state, search):
        recalled = state.recalled.after(
            state.layout, predicted, state.hypotheses, move, config.gating.gate_sigma
        )
    else:
        recalled = state.recalled.unlinked(state.layout.size)
    state = with_survey_place(state.but(recalled=recalled), paths, search)
    return survey_anchors(state, config, search) if is_track_known(state, search) else state


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
    recalled = state.recalled
    seen = gathered(recalled.position_m[rows], recalled.covariance_m2[rows], epochs)
    walls = np.flatnonzero(hypotheses.present[best] & state.slots.confirmed)
    vrp = mean[layout.walls].reshape(-1, 2)[walls]
    spread = np.array([covariance[layout.wall(s), layout.wall(s)] for s in walls.tolist()]).reshape(-1, 2, 2)
    scene = scene_of(seen, vrp, spread, config.noise, search, float(covariance[bias, bias]))
    present = mean[place][:3] if located else None
    stretch = _stretches(state, walls, search.survey_beyond)
    found = survey_anchor(scene, stretch, float(mean[bias]), heights_of(search)[0], present, search)
    return _decided(state, k, found, rows, config, search)


def _stretches(state: GaussianState, walls: Index, beyond: float) -> Array:
    """First and last place (L, 2) along each wall that may reflect; anywhere if no sweep showed it."""
    image = state.slots.flash_m[walls]
    away = 0.5 * np.linalg.norm(image[:, :, 1] - image[:, :, 0], axis=2).max(axis=1)
    margin = np.where(np.isfinite(away), beyond * away, np.inf)
    return np.asarray(state.slots.extent_m[walls] + margin[:, None] * [-1.0, 1.0])


def _decided(
    state: GaussianState,
    k: int,
    found: Survey,
    rows: Index,
    config: GaussianConfig,
    search: AnchorSearchConfig,
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
        return _with_anchor(state, k, found, rows, config, search)
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
    found: Survey,
    rows: Index,
    config: GaussianConfig,
    search: AnchorSearchConfig,
) -> GaussianState:
    """All hypotheses with anchor ``k`` at its likeliest place, which moves with the agent.

    The errors of the positions that it was surveyed from are taken for fully dependent on each other: drift
    is common to many.
    """
    best = state.hypotheses.best
    here, known_here = state.hypotheses.mean[best, :2], state.hypotheses.covariance[best, :2, :2]
    place, lever = found.place[0], found.lever[0]
    value, vector = np.linalg.eigh(state.recalled.covariance_m2[rows])
    root = (vector * np.sqrt(np.maximum(value, 0.0))[:, None, :]) @ vector.transpose(0, 2, 1)
    common = (lever @ root).sum(axis=0)
    with_agent = (lever @ state.recalled.with_state[rows, :, :2]).sum(axis=0)
    by_agent = with_agent @ np.linalg.pinv(known_here)
    value, vector = np.linalg.eigh(common @ common.T - by_agent @ with_agent.T)
    apart = (vector * np.maximum(value, 0.0)) @ vector.T
    std = search.survey_start_std_m
    height = 2.0 * np.sqrt(place[2]) * std + std**2
    own = found.covariance[0] + apart + np.diag([std**2, std**2, height**2])
    state = _without_anchor(state, k, config)
    hypotheses = state.hypotheses
    known = slice(state.layout.anchor(k).start, state.layout.height2(k) + 1)
    hypotheses.mean[:, known] = place + (hypotheses.mean[:, :2] - here) @ by_agent.T
    shared = by_agent @ hypotheses.covariance[:, :2, :]
    hypotheses.covariance[:, known, :] = shared
    hypotheses.covariance[:, :, known] = shared.transpose(0, 2, 1)
    hypotheses.covariance[:, known, known] = shared[:, :, :2] @ by_agent.T + own
    hypotheses.located[:, k] = True
    return state.but(hypotheses=hypotheses, recalled=state.recalled.moved(known, by_agent))
