"""Where a virtual anchor may be, from paths that nothing explains.

What one path length tells of its virtual anchor is a circle round the agent; the bearing shows as
the agent moves on. So candidates on all bearings round the agent are scored by the paths of the
recent epochs, misses included, until few of them are left and each is known well enough for a
Gaussian in distance and bearing (:mod:`estimator.slam.models.state_vector`). How long that takes is a matter
of the track: a straight one never tells a virtual anchor from its mirror image in the track.

Time is that of ``most_seeds`` lengths times the bearings (at most ``travel_sigma`` times a few) times
``most_recent_paths`` paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.gaussian.births.config import VirtualBirths
from estimator.slam.models.hypotheses import log_sum_exp

__all__ = ["Modes", "Recent", "search"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Recent:
    """Unassociated paths of one anchor, and where the agent was.

    Parameters
    ----------
    row : ndarray of int64, shape (N,)
        Where the paths stand in the path buffer.
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

    row: Index
    length_m: Array
    step: Index
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
    explained : ndarray of bool, shape (N,)
        The recent paths that it explains.
    """

    mean: Array
    covariance: Array
    log_weight: Array
    evidence: float
    explained: NDArray[np.bool_]


@compiled
def _likelihood(
    px: float,
    py: float,
    length: Array,
    step: Index,
    position: Array,
    variance: Array,
    clutter: float,
    detection: float,
    widen: float,
    share: Array,
    gap: Array,
) -> tuple[float, int]:
    """Best log likelihood of the last epochs over "all is clutter", and from which epoch on.

    ``share`` (N,) takes the probability that the point gave each path of these epochs, ``gap`` (N,) measured
    minus expected lengths.
    """
    epochs, paths = position.shape[0], length.size
    total = best = 0.0
    begin = epochs - 1
    first_of_begin = paths
    n = paths
    for e in range(epochs - 1, -1, -1):
        dx, dy = px - position[e, 0], py - position[e, 1]
        expected = np.sqrt(dx * dx + dy * dy)
        own = widen * variance[e]
        scale = detection / clutter / np.sqrt(2.0 * np.pi * own)
        ratio = 1.0 - detection
        last = n
        while n > 0 and step[n - 1] == e:
            n -= 1
            gap[n] = length[n] - expected
            square = gap[n] * gap[n] / own
            share[n] = scale * np.exp(-0.5 * square) if square < 60.0 else 0.0
            ratio += share[n]
        for i in range(n, last):
            share[i] /= ratio
        total += np.log(ratio)
        if e == epochs - 1 or total > best:
            best, begin, first_of_begin = total, e, n
    for i in range(first_of_begin):
        share[i] = 0.0
    return best, begin


@compiled
def _profile(
    seed: float,
    bearings: Array,
    length: Array,
    step: Index,
    position: Array,
    variance: Array,
    clutter: float,
    detection: float,
) -> tuple[Array, Array]:
    """Distances (B,) that fit best on each bearing, from a path length, and their log likelihoods (B,)."""
    last = position.shape[0] - 1
    reach, score = np.full(bearings.size, seed), np.empty(bearings.size)
    share, gap = np.empty(length.size), np.empty(length.size)
    for b in range(bearings.size):
        ux, uy = np.cos(bearings[b]), np.sin(bearings[b])
        for turn in range(3):
            widen = 4.0 if turn == 0 else 1.0
            score[b], _ = _likelihood(
                position[last, 0] + reach[b] * ux,
                position[last, 1] + reach[b] * uy,
                length,
                step,
                position,
                variance,
                clutter,
                detection,
                widen,
                share,
                gap,
            )
            if turn < 2:
                pull = weight = 0.0
                for i in range(length.size):
                    pull += share[i] * gap[i]
                    weight += share[i]
                reach[b] += pull / max(weight, 1.0)
    return reach, score


@compiled
def _refined(
    place: Array,
    length: Array,
    step: Index,
    position: Array,
    variance: Array,
    cautious: Array,
    clutter: float,
    detection: float,
) -> tuple[Array, Array, Array]:
    """Gauss-Newton on places (P, 2), in place; evidences (P,), covariances (P, 2, 2), shares (P, N)."""
    count, last = place.shape[0], position.shape[0] - 1
    evidence, covariance = np.empty(count), np.empty((count, 2, 2))
    shares = np.zeros((count, length.size))
    gap = np.empty(length.size)
    for p in range(count):
        share = shares[p]
        for turn in range(7):
            ux, uy = np.cos(place[p, 1]), np.sin(place[p, 1])
            px, py = position[last, 0] + place[p, 0] * ux, position[last, 1] + place[p, 0] * uy
            if turn < 6:
                evidence[p], _ = _likelihood(
                    px, py, length, step, position, variance, clutter, detection, 1.0, share, gap
                )
                at_x, at_y, reach = px, py, place[p, 0]
                dir_x, dir_y = ux, uy
            a, b, c = 1e-4, 0.0, 0.1  # a prior far wider than any answer
            first = second = 0.0
            for i in range(length.size):
                if share[i] == 0.0:
                    continue
                e = step[i]
                dx, dy = at_x - position[e, 0], at_y - position[e, 1]
                distance = np.sqrt(dx * dx + dy * dy)
                by_reach = (dx * dir_x + dy * dir_y) / distance
                by_bearing = (dy * dir_x - dx * dir_y) / distance * reach
                weight = share[i] / (variance[e] if turn < 6 else cautious[e])
                a += weight * by_reach * by_reach
                b += weight * by_reach * by_bearing
                c += weight * by_bearing * by_bearing
                first += weight * gap[i] * by_reach
                second += weight * gap[i] * by_bearing
            determinant = a * c - b * b
            if turn < 6:
                place[p, 0] += min(max((c * first - b * second) / determinant, -0.5), 0.5)
                place[p, 1] += min(max((a * second - b * first) / determinant, -0.2), 0.2)
            else:
                covariance[p, 0, 0], covariance[p, 1, 1] = c / determinant, a / determinant
                covariance[p, 0, 1] = covariance[p, 1, 0] = -b / determinant
    return evidence, covariance, shares


def search(recent: Recent, detection: float, trust: float, config: VirtualBirths) -> Modes | None:
    """The best-supported virtual anchor among recent paths, if it is known well enough.

    Parameters
    ----------
    recent : Recent
        Paths and track.
    detection : float
        Detection probability.
    trust : float
        Power of the likelihood that the track gives (``birth_trust``).
    config : VirtualBirths
        Evidence, spacing and limits.
    """
    latest = _kept_up(recent, config)[-config.most_seeds :]
    if latest.size == 0:
        return None
    std = float(np.sqrt(recent.variance_m2.mean()))
    spacing = min(1.5 * std / max(recent.extent_m, 1e-3), config.coarsest_rad)
    bearings = np.linspace(-np.pi, np.pi, int(np.ceil(2.0 * np.pi / spacing)), endpoint=False)
    given = recent.length_m, recent.step, recent.position_m, recent.variance_m2
    profiles = [_profile(seed, bearings, *given, recent.clutter, detection) for seed in latest.tolist()]
    for seed in np.argsort([-score.max() for _, score in profiles], kind="stable").tolist():
        reach, score = profiles[seed]
        if score.max() < config.virtual_evidence:
            return None
        modes = _modes(recent, reach, bearings, score, detection, trust, config)
        if modes is not None:
            return modes
    return None


def _kept_up(recent: Recent, config: VirtualBirths) -> Array:
    """The paths of the last two epochs that most of the epochs before have too.

    By the triangle inequality a path to a point changes by no more than the agent moves.
    """
    last = len(recent.position_m) - 1
    latest = recent.length_m[recent.step >= last - 1]
    before = np.flatnonzero(recent.step > last - config.least_epochs)
    step = recent.step[before]
    moved = np.linalg.norm(recent.position_m[step] - recent.position_m[-1], axis=1)
    reach = moved + 4.0 * np.sqrt(2.0 * recent.variance_m2[step])
    near = np.abs(recent.length_m[before] - latest[:, None]) < reach  # (S, N)
    epochs = np.array([np.unique(step[row]).size for row in near], dtype=np.int64)
    return latest[epochs > config.least_epochs // 2]


def _modes(
    recent: Recent,
    reach: Array,
    bearings: Array,
    score: Array,
    detection: float,
    trust: float,
    config: VirtualBirths,
) -> Modes | None:
    """The peaks of a profile of scores over bearings (B,), as Gaussians; None if they are too blunt."""
    peak = (score >= np.roll(score, 1)) & (score > np.roll(score, -1))
    peak &= trust * (score.max() - score) < config.mode_nats
    at = np.flatnonzero(peak)
    at = at[np.argsort(-score[at])][: 3 * config.most_modes]
    if at.size == 0:
        return None
    place = np.stack([reach[at], bearings[at]], axis=-1)
    evidence, covariance, share = _refined(
        place,
        recent.length_m,
        recent.step,
        recent.position_m,
        recent.variance_m2,
        recent.cautious_m2,
        recent.clutter,
        detection,
    )
    kept: list[int] = []
    for i in np.argsort(-evidence).tolist():
        turn = np.abs(np.angle(np.exp(1j * (place[i, 1] - place[kept, 1]))))
        if np.all(turn > 0.5 * np.sqrt(covariance[kept, 1, 1])):
            kept.append(i)
    trusted = trust * evidence[kept]
    kept = [i for i, value in zip(kept, trusted, strict=True) if trusted[0] - value < config.mode_nats]
    spread = np.sqrt(covariance[kept, 1, 1])
    if len(kept) > config.most_modes or spread.max() > config.virtual_bearing_std_rad:
        return None
    log_weight = trust * evidence[kept] + np.log(spread)
    limit = config.virtual_bearing_std_rad * (1.0 if len(kept) > 1 else config.narrower)
    parts = [
        _halved(place[i], covariance[i], weight, limit, config.aside)
        for i, weight in zip(kept, log_weight, strict=True)
    ]
    mean, spreads, log_weight = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Modes(
        mean,
        spreads,
        log_weight - log_sum_exp(log_weight),
        float(evidence[kept[0]]),
        np.any(share[kept] > 0.5, axis=0),
    )


def _halved(
    mean: Array, covariance: Array, log_weight: float, limit: float, apart: float
) -> tuple[Array, Array, Array]:
    """A Gaussian as several whose bearings have standard deviations within ``limit``; the moments stay.

    A path length is nearly linear in distance and bearing, but for its extreme straight ahead and
    astern, where the virtual anchor and its mirror image are close together: no Gaussian may be across.
    """
    std = np.sqrt(covariance[1, 1])
    if std <= limit:
        return mean[None], covariance[None], np.array([log_weight])
    aside = apart * covariance[:, 1] / std
    narrower = covariance - np.outer(aside, aside)
    low, high = (
        _halved(mean + sign * aside, narrower, log_weight - np.log(2.0), limit, apart) for sign in (-1.0, 1.0)
    )
    return (
        np.concatenate([low[0], high[0]]),
        np.concatenate([low[1], high[1]]),
        np.concatenate([low[2], high[2]]),
    )
