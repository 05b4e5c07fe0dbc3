"""Anchors enter the joint state: candidates are searched and hypotheses forked."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.circles import Centres, images_of_agent
from estimator.slam.anchors.labellings import labellings
from estimator.slam.anchors.search import Candidates, evidence_at, locate
from estimator.slam.anchors.sight import PathBatch, walls_between
from estimator.slam.config import GaussianConfig
from estimator.slam.features import predict_paths
from estimator.slam.gaussian.hypotheses import tidy
from estimator.slam.gaussian.kalman import kalman
from estimator.slam.gaussian.levels import known_gains
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.gaussian.slots import fresh_visibility
from estimator.slam.gaussian.state import GaussianState, Rows, log_sum_exp

__all__ = ["locate_anchors", "may_locate"]

Array = NDArray[np.float64]
_BIAS_STEP_M = 1.0  # spacing of the clock biases that are tried
_MOST_BIASES = 10  # searched for further anchors
_STRIDE = 4  # epochs between those of a window that are searched
_FRESH = 2  # features that the present epoch must surely have heard
_ODDS = 1.0  # that a feature is measured
_MARGIN_NATS = 2.0  # by which a place must beat those that explain too little, and no place at all
_NO_CHANCE_NATS = 20.0  # of a place that few features tell, once another anchor stands and there is no hurry
_RECHECK = 8  # epochs between doubts of a located anchor
_RIVAL_LOG_PRIOR = -3.0  # log odds that a located anchor is elsewhere after all
_KNOWN_M2 = 1e-12  # variance of an anchor known from the start, left by rounding where rows were merged
_PRIOR_STD_M = 10.0  # of an anchor started from one epoch, whose paths all enter the joint Gaussian


def may_locate(state: GaussianState) -> bool:
    """Whether :func:`locate_anchors` has anything to look at in this epoch."""
    if len(state.trail) < _STRIDE or state.epoch % _RECHECK == 0:
        return True
    return state.epoch % _STRIDE == 0 and not state.rows.located.all()


def locate_anchors(state: GaussianState, paths: PathTable, config: GaussianConfig) -> GaussianState:
    """Start the anchors that the best row has not located, where the paths allow it.

    The rows that lack the anchor split: one for each candidate place, weighted by
    its evidence, and one that goes on without it. A located anchor of which too much
    goes unexplained is searched again; a place that explains the recent epochs better
    becomes a rival hypothesis, and the epochs to come decide. While no anchor at all is located
    the agent's motion is not known either, and waiting only loses what the start tells: after the
    first epoch the anchor that is heard over most paths then starts from every place that explains
    enough, even if one that explains too little is as likely.

    Parameters
    ----------
    state : GaussianState
        State with corrected rows.
    paths : PathTable
        The epoch's paths.
    config : GaussianConfig
        Models.
    """
    early = len(state.trail) < _STRIDE
    for k in range(state.layout.anchors):
        waiting = np.flatnonzero(~state.rows.located[:, k])
        located = waiting.size == 0
        if (located and not _doubtful(state, k, config)) or (state.epoch % _STRIDE and not early):
            continue
        groups = (
            [np.array([state.rows.best])] if located else _alike(state.rows, waiting, state.layout.bias(k))
        )
        state = _forked(
            state, [_places(state, paths, k, group, config) for group in groups], _MARGIN_NATS, config
        )
    if early and len(state.trail) and not state.rows.located.any():
        everyone = np.arange(len(state.rows))
        for k in np.argsort(-np.sum(paths.valid, axis=1), kind="stable").tolist():
            state = _forked(state, [_places(state, paths, k, everyone, config)], -np.inf, config)
            if state.rows.located.any():
                break
    return state


@dataclass(frozen=True, eq=False)
class _Places:
    """Where an anchor may be, as seen from rows that agree on its clock.

    Parameters
    ----------
    anchor : int
        The anchor.
    rows : ndarray of int64
        The rows.
    found : Candidates
        Places.
    enough : ndarray of bool, shape (S,)
        Which of them explain enough.
    centres : Centres
        The circles they are from.
    walls : dict of int to ndarray, shape (2,)
        Known walls.
    heard : PathTable
        The epoch's paths.
    """

    anchor: int
    rows: NDArray[np.int64]
    found: Candidates
    enough: NDArray[np.bool_]
    centres: Centres
    walls: dict[int, Array]
    heard: PathTable


def _forked(
    state: GaussianState, places: list[_Places], margin: float, config: GaussianConfig
) -> GaussianState:
    """The state with a row for each of the rows and each place that explains enough; as it is if none does.

    The best of these places has to beat those that explain too little by ``margin`` nats, from whichever
    rows these are seen: rows whose anchor has to wait gain nothing by its paths, and would lose to worse
    ones that have not.
    """
    weight = [float(state.rows.log_weight[each.rows].max()) for each in places]
    best, rest = -np.inf, max(weight, default=0.0)
    for own, each in zip(weight, places, strict=True):
        best = max(best, own + float(each.found.log_evidence[each.enough].max(initial=-np.inf)))
        rest = max(rest, own + float(each.found.log_evidence[~each.enough].max(initial=-np.inf)))
    if not best > rest + margin:
        return state
    rows = state.rows
    for each in places:
        if each.enough.any():
            rows = rows.joined(_fork(state, each, config))
    return state.but(rows=tidy(rows, config))


def _alike(rows: Rows, waiting: NDArray[np.int64], bias: int) -> list[NDArray[np.int64]]:
    """The rows that wait for an anchor, likeliest first, in groups that agree on its clock bias.

    Anchors with a common clock: where the first one stands tells the bias, and each of its places
    another one.
    """
    groups: list[NDArray[np.int64]] = []
    left = waiting[np.argsort(-rows.log_weight[waiting], kind="stable")]
    while left.size and len(groups) < _MOST_BIASES:
        near = np.abs(rows.mean[left, bias] - rows.mean[left[0], bias]) < _BIAS_STEP_M
        groups.append(left[near])
        left = left[~near]
    return groups


def _places(
    state: GaussianState, paths: PathTable, k: int, rows: NDArray[np.int64], config: GaussianConfig
) -> _Places:
    """Places of anchor ``k``, as seen from the likeliest of ``rows``."""
    first = int(rows[np.argmax(state.rows.log_weight[rows])])
    located = bool(state.rows.located[first, k])
    centres, batch, walls = _gather(state, paths, k, first, config)
    found = _search(state, k, first, centres, batch, walls, config)
    epochs = np.unique(batch.epoch).size
    enough = (found.matches >= config.start_matches - (epochs > 1)) & (found.fresh >= _FRESH)
    if not located and state.rows.located[first].any():
        enough &= (found.matches >= config.start_matches) | (found.log_evidence > _NO_CHANCE_NATS)
    if located:
        here = state.rows.mean[state.rows.best, state.layout.anchor(k)][None, :2]
        rival = np.linalg.norm(found.mean_m - here, axis=1) > config.restart_distance_m
        # its images behind walls explain much, too
        rival &= walls_between(found.mean_m, walls) <= walls_between(here, walls)
        bias = state.rows.mean[[first], state.layout.bias(k)]
        enough &= rival & (found.log_evidence > evidence_at(here, centres, batch, walls, config, bias)[0])
    return _Places(k, rows, found, enough, centres, walls, paths)


def _search(
    state: GaussianState,
    k: int,
    row: int,
    centres: Centres,
    batch: PathBatch,
    walls: dict[int, Array],
    config: GaussianConfig,
) -> Candidates:
    """Candidates for anchor ``k`` at its clock bias, or on a grid of biases if that is unknown."""
    b = state.layout.bias(k)
    mean, std = float(state.rows.mean[row, b]), float(np.sqrt(state.rows.covariance[row, b, b]))
    seeds = np.array([state.epoch])
    if std < _BIAS_STEP_M:
        wide = replace(batch, variance_m2=batch.variance_m2 + std**2)
        return locate(centres, wide, walls, config, seeds, np.array([mean]))
    shift = np.arange(-3.0 * std, 3.0 * std + _BIAS_STEP_M, _BIAS_STEP_M)
    log_prior = -0.5 * (shift / std) ** 2 + np.log(_BIAS_STEP_M / (std * np.sqrt(2.0 * np.pi)))
    wide = replace(batch, variance_m2=batch.variance_m2 + _BIAS_STEP_M**2 / 12.0)
    return locate(centres, wide, walls, config, seeds, mean + shift, log_prior)


def _doubtful(state: GaussianState, k: int, config: GaussianConfig) -> bool:
    """Whether so much of a located anchor goes unexplained that its place should be checked."""
    if state.epoch % _RECHECK or len(state.trail) < _STRIDE:
        return False
    place = state.layout.anchor_xy(k)
    if np.trace(state.rows.covariance[state.rows.best, place, place]) < _KNOWN_M2:
        return False
    count = np.count_nonzero(state.loose[:, 1] == k)
    expected = config.clutter_mean * len(state.trail)
    if count <= expected + 4.0 * np.sqrt(expected) + 0.5 * len(state.trail):
        return False
    first = state.rows.visibility[state.rows.best, k, : 1 + state.layout.slots]
    active = state.active()[state.rows.best, k, : len(first)]
    return bool(np.sum(first * active > 0.5) < config.start_matches - 1)


def _gather(
    state: GaussianState, paths: PathTable, k: int, row: int, config: GaussianConfig
) -> tuple[Centres, PathBatch, dict[int, Array]]:
    """Circles of anchor ``k``: this epoch's and, every fourth epoch, recent ones."""
    layout, rows = state.layout, state.rows
    mean, covariance = rows.mean[row], rows.covariance[row]
    slots = np.flatnonzero(rows.present[row] & state.slots.confirmed)
    walls = mean[layout.walls].reshape(-1, 2)[slots]
    spread = np.array([covariance[layout.wall(s), layout.wall(s)] for s in slots.tolist()]).reshape(-1, 2, 2)
    n = int(paths.valid[k].sum())
    variance = 0.5 * float(np.trace(covariance[:2, :2]))
    centres = [images_of_agent(mean[:2], variance, walls, spread, slots, state.epoch)]
    table = [paths.length_m[k, :n], paths.std_m[k, :n], paths.excess_loss_db[k, :n]]
    heard = [np.column_stack([np.full(n, state.epoch), *table])]
    stride = 1 if len(state.trail) < _STRIDE else _STRIDE
    for epoch, x, y, std in state.trail[::-stride]:
        old = state.heard[(state.heard[:, 1] == k) & (state.heard[:, 0] == epoch)]
        if len(old):
            centres.append(images_of_agent(np.array([x, y]), std**2, walls, spread, slots, int(epoch)))
            heard.append(old[:, [0, 2, 3, 4]])
    joined = Centres(
        *(np.concatenate([getattr(c, entry.name) for c in centres]) for entry in fields(Centres))
    )
    columns = np.concatenate(heard)
    batch = PathBatch(
        columns[:, 1],
        np.maximum(columns[:, 2], config.range_std_m) ** 2,
        columns[:, 0].astype(np.int64),
        columns[:, 3] - known_gains(state)[k],
    )
    return joined, batch, dict(zip(slots.tolist(), walls, strict=True))


def _fork(state: GaussianState, places: _Places, config: GaussianConfig) -> Rows:
    """One new row for each of the rows and each place that explains enough.

    Neither the candidates' covariances are believed nor their labels: both come from walls
    held fixed. Each starts wide, and takes this epoch's paths into the joint Gaussian, where anchor
    and walls become correlated, once for each labelling that may be. Earlier epochs only
    chose the place; their lengths are not used as information again.
    """
    layout, k, rows, centres, paths = state.layout, places.anchor, places.rows, places.centres, places.heard
    found = Candidates(*(getattr(places.found, entry.name)[places.enough] for entry in fields(Candidates)))
    now = np.flatnonzero((centres.epoch == state.epoch) & (centres.bounces < 2))
    current = Centres(*(column[now] for column in vars(centres).values()))
    heard = paths.length_m[k][paths.valid[k]]
    candidate, label = labellings(found, current, heard, places.walls)
    count = len(candidate)
    group = np.repeat(np.arange(len(rows)), count) * len(found.mean_m) + np.tile(candidate, len(rows))
    candidate, label = np.tile(candidate, len(rows)), np.tile(label, (len(rows), 1))
    new = state.rows.take(np.repeat(rows, count))
    xy, w, b = layout.anchor_xy(k), layout.height2(k), layout.bias(k)
    located = bool(new.located[0, k])
    new.located[:, k] = True
    new.log_weight[...] += _RIVAL_LOG_PRIOR if located else found.log_evidence[candidate]
    new.mean[:, xy] = found.mean_m[candidate]
    shift = found.bias_m[candidate] - new.mean[:, b]
    scale = np.maximum(new.covariance[:, b, b], 1e-12)
    for other in (layout.bias(j) for j in range(layout.anchors)):  # clocks that agree move together
        share = new.covariance[:, other, b] / scale
        new.mean[:, other] += (1.0 if other == b else share) * shift
    if located:  # what was known of the anchor goes with its place
        place = slice(xy.start, w + 1)
        new.covariance[:, place, :] = 0.0
        new.covariance[:, :, place] = 0.0
        new.mean[:, w] = config.height2_mean_m2
        new.covariance[:, w, w] = config.height2_std_m2**2
    new.covariance[:, xy, xy] = _PRIOR_STD_M**2 * np.eye(2)
    new.visibility[:, k] = fresh_visibility(layout)

    feature = np.where(centres.bounces[now] == 0, 0, 1 + centres.wall[now])
    known = label >= 0
    prediction = predict_paths(new.mean, layout)
    jacobian = prediction.derivatives(np.broadcast_to(feature, (len(label), layout.anchors, feature.size)))[
        :, k
    ]
    length = paths.length_m[k][np.maximum(label, 0)]
    std = np.maximum(paths.std_m[k][np.maximum(label, 0)], config.range_std_m)
    mean, covariance, log_density = kalman(
        new.mean,
        new.covariance,
        np.where(known[..., None], jacobian, 0.0),
        np.where(known, length - prediction.length_m[:, k, feature], 0.0),
        np.where(known, std**2, 0.5 / np.pi),
    )
    log_density += np.sum(known, axis=1) * np.log(_ODDS / config.clutter_density)
    for g in np.unique(group):
        log_density[group == g] -= log_sum_exp(log_density[group == g])
    return replace(new, mean=mean, covariance=covariance, log_weight=new.log_weight + log_density)
