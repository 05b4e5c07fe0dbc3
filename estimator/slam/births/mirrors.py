"""New virtual anchors from paths that nothing explains.

What one path length tells of its virtual anchor is a circle round the agent; the bearing shows as
the agent moves on. So candidates on all bearings round the agent are scored by the paths of the
recent epochs, misses included, until few of them are left and each is known well enough for a
Gaussian in distance and bearing (:mod:`estimator.slam.layout`). How long that takes is a matter
of the track: a straight one never tells a virtual anchor from its mirror image in the track.
Both then enter, as hypotheses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.memory import clutter_density
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.state import GaussianState, log_sum_exp
from estimator.slam.gaussian.update import Correction
from estimator.slam.layout import Layout

__all__ = ["Modes", "Recent", "bear_virtual_anchors", "recent_paths", "search", "shorter_than_sight"]

Array = NDArray[np.float64]
_LEAST_EPOCHS = 12  # of a window, however far the agent went in them
_TRAVEL_SIGMAS = 40.0  # of a window: how far the agent goes in it, range standard deviations
_COARSEST_RAD = 0.1  # spacing of the bearings
_MODE_NATS = 10.0  # less likely places are not kept
_MOST_MODES = 4
_BLUNTEST = 1.0
_NARROWER = 0.6  # allowed where there is one mode alone
_ASIDE = 0.8  # where the halves of a Gaussian stand, in its standard deviations
_KEPT_APART_M = 0.5  # virtual anchors of one anchor this close are one


@dataclass(frozen=True, eq=False)
class Recent:
    """Unexplained paths of one anchor, and where the agent was.

    Parameters
    ----------
    length_m : ndarray, shape (N,)
        Horizontal path lengths, clock bias removed, epoch by epoch.
    step : ndarray of int64, shape (N,)
        Which of the E epochs each belongs to, ascending.
    position_m : ndarray, shape (E, 2)
        The agent, the present last.
    variance_m2 : ndarray, shape (E,)
        Of a path length, the agent's uncertainty included.
    cautious_m2 : ndarray, shape (E,)
        The same where a mean over epochs matters: the agent's errors last for several.
    clutter : float
        Intensity per metre of paths of anything else.
    """

    length_m: Array
    step: NDArray[np.int64]
    position_m: Array
    variance_m2: Array
    cautious_m2: Array
    clutter: float

    @property
    def extent_m(self) -> float:
        """How far from here the agent was at most."""
        return float(np.linalg.norm(self.position_m - self.position_m[-1], axis=1).max())


@dataclass(frozen=True, eq=False)
class Modes:
    """Places where a virtual anchor may be, as seen from where the agent is.

    Parameters
    ----------
    mean : ndarray, shape (B, 2)
        Distance, metres, and bearing.
    covariance : ndarray, shape (B, 2, 2)
        Their covariances.
    log_weight : ndarray, shape (B,)
        Log probabilities, normalised.
    evidence : float
        Log likelihood of the best over "all is clutter".
    told : ndarray of bool, shape (N,)
        The recent paths that it explains.
    """

    mean: Array
    covariance: Array
    log_weight: Array
    evidence: float
    told: NDArray[np.bool_]


def shorter_than_sight(
    done: Correction, paths: PathTable, layout: Layout, config: GaussianConfig, loose: Array
) -> Array:
    """Log weight (R,) that rows lose by unexplained paths shorter than their line of sight.

    A feature not yet found is farther away than its anchor: among the shorter paths there is
    only clutter, and less of it than of loose paths in all, (K,) or (R, K) per metre. A row that takes the
    path of a virtual anchor for the line of sight leaves the true one, which is shorter, unexplained
    in every epoch.
    """
    agent = done.mean[:, None, layout.POSITION]
    device = np.stack([done.mean[:, layout.anchor(k)] for k in range(layout.anchors)], axis=1)
    offset = device[..., :2] - agent
    sight = np.sqrt(np.sum(offset**2, axis=-1) + device[..., 2]) + device[..., 3]  # (R, K)
    margin = config.gate_sigma * np.maximum(paths.std_m, config.range_std_m)
    shorter = paths.valid & (paths.length_m + margin < sight[..., None])  # (R, K, M)
    rarer = np.log(np.minimum(config.clutter_density / loose, 1.0))
    return np.asarray(np.sum(shorter * (1.0 - done.explained) * rarer[..., None], axis=(1, 2)))


def recent_paths(state: GaussianState, k: int, config: GaussianConfig) -> Recent | None:
    """What the memory holds of anchor ``k``, as far back as its virtual anchors need; None if too little."""
    trail = state.trail
    gone = np.linalg.norm(trail[:, 1:3] - trail[-1, 1:3], axis=1)
    far = np.flatnonzero(gone > _TRAVEL_SIGMAS * config.range_std_m)
    begin = min(far[-1] + 1 if far.size else 0, max(len(trail) - _LEAST_EPOCHS, 0))
    trail = trail[begin:]
    loose = state.loose
    loose = loose[(loose[:, 1] == k) & (loose[:, 0] >= trail[0, 0])]
    if len(loose) < config.confirm_support:
        return None
    device = state.rows.mean[state.rows.best, state.layout.anchor(k)]
    flat = np.sqrt(np.maximum((loose[:, 2] - device[3]) ** 2 - device[2], 1e-4))
    noise = max(config.range_std_m, float(np.median(loose[:, 3]))) ** 2
    return Recent(
        flat,
        np.searchsorted(trail[:, 0], loose[:, 0]),
        trail[:, 1:3],
        noise + trail[:, 3] ** 2,
        noise + config.virtual_alike_epochs * trail[:, 3] ** 2,
        float(clutter_density([state], config)[0, k]),
    )


def _shares(
    recent: Recent, reach: Array, bearing: Array, detection: float, widen: float = 1.0
) -> tuple[Array, Array, Array, Array]:
    """How well points (...) explain paths: shares and gaps (..., N), gains (..., E), points (..., 2).

    A share is the probability that the point gave the path; a gain is an epoch's log likelihood over
    "all is clutter".
    """
    outward = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    point = recent.position_m[-1] + reach[..., None] * outward
    offset = point[..., None, :] - recent.position_m
    expected = np.sqrt(offset[..., 0] ** 2 + offset[..., 1] ** 2)  # (..., E)
    gap = recent.length_m - expected[..., recent.step]
    variance = widen * recent.variance_m2[recent.step]
    ratio = detection / recent.clutter * np.exp(-0.5 * gap**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    heard, first = np.unique(recent.step, return_index=True)
    total = np.zeros(expected.shape)
    total[..., heard] = np.add.reduceat(ratio, first, axis=-1)
    total += 1.0 - detection
    return ratio / total[..., recent.step], gap, np.log(total), offset


def _suffix(gain: Array) -> tuple[Array, NDArray[np.int64]]:
    """Best sum of gains (..., E) of the last epochs, and from which epoch on."""
    total = np.cumsum(gain[..., ::-1], axis=-1)
    length = np.argmax(total, axis=-1)
    best = np.take_along_axis(total, length[..., None], axis=-1)[..., 0]
    return best, gain.shape[-1] - 1 - length


def _kept_up(recent: Recent) -> Array:
    """The paths of the last two epochs that most of the epochs before have too.

    By the triangle inequality a path to a point changes by no more than the agent moves.
    """
    last = len(recent.position_m) - 1
    latest = recent.length_m[recent.step >= last - 1]
    before = np.flatnonzero(recent.step > last - _LEAST_EPOCHS)
    step = recent.step[before]
    moved = np.linalg.norm(recent.position_m[step] - recent.position_m[-1], axis=1)
    reach = moved + 4.0 * np.sqrt(2.0 * recent.variance_m2[step])
    near = np.abs(recent.length_m[before] - latest[:, None]) < reach  # (S, N)
    epochs = np.array([np.unique(step[row]).size for row in near], dtype=np.int64)
    return latest[epochs > _LEAST_EPOCHS // 2]


def search(recent: Recent, config: GaussianConfig) -> Modes | None:
    """The best-supported virtual anchor among recent paths, if it is known well enough.

    Parameters
    ----------
    recent : Recent
        Paths and track.
    config : GaussianConfig
        ``detection_probability``, ``virtual_evidence`` and ``virtual_bearing_std_rad``.

    Returns
    -------
    Modes or None
    """
    detection = config.detection_probability
    latest = _kept_up(recent)
    if latest.size == 0:
        return None
    std = float(np.sqrt(recent.variance_m2.mean()))
    spacing = min(1.5 * std / max(recent.extent_m, 1e-3), _COARSEST_RAD)
    bearings = np.linspace(-np.pi, np.pi, int(np.ceil(2.0 * np.pi / spacing)), endpoint=False)
    reach, bearing = np.meshgrid(latest, bearings, indexing="ij")
    for widen in (4.0, 1.0):
        share, gap, gain, _ = _shares(recent, reach, bearing, detection, widen)
        _, begin = _suffix(gain)
        share = np.where(recent.step >= begin[..., None], share, 0.0)
        reach = reach + np.sum(share * gap, axis=-1) / np.maximum(share.sum(axis=-1), 1.0)
    _, _, gain, _ = _shares(recent, reach, bearing, detection)
    score, _ = _suffix(gain)  # (S, B)
    for seed in np.argsort(-score.max(axis=1)):
        if score[seed].max() < config.virtual_evidence:
            return None
        modes = _modes(recent, reach[seed], bearings, score[seed], config)
        if modes is not None:
            return modes
    return None


def _modes(
    recent: Recent, reach: Array, bearings: Array, score: Array, config: GaussianConfig
) -> Modes | None:
    """The peaks of a profile of scores over bearings (B,), as Gaussians; None if they are too blunt."""
    peak = (score >= np.roll(score, 1)) & (score > np.roll(score, -1))
    peak &= config.birth_trust * (score.max() - score) < _MODE_NATS
    at = np.flatnonzero(peak)
    at = at[np.argsort(-score[at])][: 3 * _MOST_MODES]
    place = np.stack([reach[at], bearings[at]], axis=-1)
    prior = np.diag([1e-4, 0.1])
    for _ in range(6):
        share, gap, gain, offset = _shares(recent, place[:, 0], place[:, 1], config.detection_probability)
        evidence, begin = _suffix(gain)
        share = np.where(recent.step >= begin[:, None], share, 0.0)
        away = offset / np.linalg.norm(offset, axis=-1, keepdims=True)  # (P, E, 2)
        outward = np.stack([np.cos(place[:, 1]), np.sin(place[:, 1])], axis=-1)
        across = np.stack([-outward[:, 1], outward[:, 0]], axis=-1)
        by_reach = np.sum(away * outward[:, None], axis=-1)
        by_bearing = np.sum(away * across[:, None], axis=-1) * place[:, :1]
        slope = np.stack([by_reach, by_bearing], axis=-1)[:, recent.step]  # (P, N, 2)
        weight = share / recent.variance_m2[recent.step]
        information = np.einsum("pn,pni,pnj->pij", weight, slope, slope) + prior
        change = np.linalg.solve(information, np.einsum("pn,pni->pi", weight * gap, slope)[..., None])[..., 0]
        place = place + np.clip(change, [-0.5, -0.2], [0.5, 0.2])
    weight = share / recent.cautious_m2[recent.step]
    covariance = np.linalg.inv(np.einsum("pn,pni,pnj->pij", weight, slope, slope) + prior)
    order = np.argsort(-evidence)
    kept: list[int] = []
    for i in order.tolist():
        turn = np.abs(np.angle(np.exp(1j * (place[i, 1] - place[kept, 1]))))
        if np.all(turn > 0.5 * np.sqrt(covariance[kept, 1, 1])):
            kept.append(i)
    trusted = config.birth_trust * evidence[kept]
    kept = [i for i, value in zip(kept, trusted, strict=True) if trusted[0] - value < _MODE_NATS]
    spread = np.sqrt(covariance[kept, 1, 1])
    if len(kept) > _MOST_MODES or spread.max() > _BLUNTEST * config.virtual_bearing_std_rad:
        return None
    log_weight = config.birth_trust * evidence[kept] + np.log(spread)
    limit = config.virtual_bearing_std_rad * (1.0 if len(kept) > 1 else _NARROWER)
    parts = [_halved(place[i], covariance[i], w, limit) for i, w in zip(kept, log_weight, strict=True)]
    mean, spreads, log_weight = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Modes(
        mean,
        spreads,
        log_weight - log_sum_exp(log_weight),
        float(evidence[kept[0]]),
        np.any(share[kept] > 0.5, axis=0),
    )


def _halved(mean: Array, covariance: Array, log_weight: float, limit: float) -> tuple[Array, Array, Array]:
    """A Gaussian as several whose bearings have standard deviations within ``limit``; the moments stay.

    A path length is nearly linear in distance and bearing, but for its extreme straight ahead and
    astern, where the virtual anchor and its mirror image are close together: no Gaussian may be across.
    """
    std = np.sqrt(covariance[1, 1])
    if std <= limit:
        return mean[None], covariance[None], np.array([log_weight])
    aside = _ASIDE * covariance[:, 1] / std
    narrower = covariance - np.outer(aside, aside)
    halves = [_halved(mean + s * aside, narrower, log_weight - np.log(2.0), limit) for s in (-1.0, 1.0)]
    return tuple(np.concatenate(columns) for columns in zip(*halves, strict=True))  # type: ignore[return-value]


def bear_virtual_anchors(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Give all rows the virtual anchors that recent paths have shown; every few epochs, anchor by anchor."""
    for k in range(state.layout.anchors):
        if (state.epoch + k) % config.virtual_stride:
            continue
        for _ in range(_MOST_MODES):
            recent = recent_paths(state, k, config)
            modes = None if recent is None else search(recent, config)
            if recent is None or modes is None:
                break
            born = _enter(state, k, modes, config)
            if born is None:
                break
            state = _forget(born, k, recent, modes)
    return state


def _enter(state: GaussianState, k: int, modes: Modes, config: GaussianConfig) -> GaussianState | None:
    """Each row once for each mode; None if these would be too many rows."""
    if len(state.rows) * len(modes.mean) > config.max_hypotheses:
        return None
    state, slot = open_slot(state)
    rows, columns = state.rows, state.layout.wall(slot)
    centre = rows.mean[rows.best, :2]
    parent, mode = np.divmod(np.arange(len(rows) * len(modes.mean)), len(modes.mean))
    new = rows.take(parent)
    new.mean[:, columns] = np.concatenate([modes.mean[mode], np.tile(centre, (len(mode), 1))], axis=1)
    free = slice(columns.start, columns.start + 2)
    new.covariance[:, free, free] = modes.covariance[mode]
    new.present[:, slot] = True
    new.log_weight[...] += modes.log_weight[mode]
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot], slots.owner[slot] = state.next_wall_id, state.epoch, k
    return state.but(rows=new, slots=slots, next_wall_id=state.next_wall_id + 1)


def _forget(state: GaussianState, k: int, recent: Recent, modes: Modes) -> GaussianState:
    """The paths of a virtual anchor that was found are not loose any more."""
    heard = state.heard.copy()
    mine = np.flatnonzero((heard[:, 1] == k) & (heard[:, 5] == 1.0))
    mine = mine[len(mine) - len(recent.length_m) :]
    heard[mine[modes.told], 5] = 0.0
    return state.but(heard=heard)
