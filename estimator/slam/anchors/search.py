"""Locating an anchor from path lengths with unknown labels (Section IV-B1).

A mirror keeps lengths, so the path that leaves the anchor and bounces off wall ``l``
is as long as the straight way from the anchor to the *agent's* image in ``l``. Every
path length thus puts the anchor on a circle round a known centre: the agent, one of
its images or an image of an image; which one is unknown. Pairs of circles give
candidates, each is scored by all the paths, refined, and weighed by its evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.circles import Centres, intersections
from estimator.slam.anchors.sight import Heard, PathBatch, prior_visibility, see, walls_between
from estimator.slam.association import associate
from estimator.slam.config import GaussianConfig

__all__ = ["Candidates", "evidence_at", "locate"]

Array = NDArray[np.float64]
_MOST_PAIRS = 20_000  # of circles that are intersected: 40 paths and four walls
_CHUNK = 512  # intersections seen at once: their arrays stay in the cache
_REFINED, _REFINED_IN_ALL = (
    60,
    600,
)  # intersections that are refined and weighed, of one clock bias and of all
_STILL_M = 1e-4  # a place that moves by less has been found
_SHORTEST_M = 1e-3  # a path, whatever the clock says
_SURE = 0.9  # association probability from which a path is believed to be a feature's
_BEHIND_LOG_PRIOR = -2.5  # of standing behind a known wall: anchors are rarely in other rooms
_NO_BIAS = np.zeros(1)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Where the anchor may be, best first.

    Parameters
    ----------
    mean_m : ndarray, shape (S, 2)
        Positions.
    covariance_m2 : ndarray, shape (S, 2, 2)
        Covariances from the matched paths alone.
    log_evidence : ndarray, shape (S,)
        Log evidence over "all is clutter".
    matches : ndarray of int64, shape (S,)
        Number of features of up to one bounce that most epochs heard.
    fresh : ndarray of int64, shape (S,)
        How many of these features the last epoch surely heard.
    bias_m : ndarray, shape (S,)
        Clock bias that was taken off the path lengths.
    """

    mean_m: Array
    covariance_m2: Array
    log_evidence: Array
    matches: NDArray[np.int64]
    fresh: NDArray[np.int64]
    bias_m: Array


def _odds(relative: Array, chance: Array) -> Array:
    """Association ratios (S, ..., N) of features that are measured with probability ``chance`` (S, ...)."""
    return np.asarray((chance / (1.0 - chance))[..., None] * relative)


def _seeds(
    centres: Centres, paths: PathBatch, epochs: NDArray[np.int64], bias_m: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Intersections (S, 2) of circles of up to one bounce, and of which clock bias (S,) each is."""
    centre_index = np.flatnonzero((centres.bounces < 2) & np.isin(centres.epoch, epochs))
    path_index = np.flatnonzero(np.isin(paths.epoch, epochs))
    c, p = (index.ravel() for index in np.meshgrid(centre_index, path_index, indexing="ij"))
    fits = centres.epoch[c] == paths.epoch[p]
    c, p = c[fits], p[fits]
    a, b = np.triu_indices(len(c), 1)
    apart = (c[a] != c[b]) & (p[a] != p[b])
    every = max(-(-int(apart.sum()) // _MOST_PAIRS), 1)  # where most paths meet, many pairs do
    a, b = a[apart][::every], b[apart][::every]
    radius = (
        np.stack([paths.length_m[p[a]], paths.length_m[p[b]]], axis=1) - bias_m[:, None, None]
    )  # (B, P, 2)
    centre = np.stack([centres.point_m[c[a]], centres.point_m[c[b]]], axis=1)
    centre = np.broadcast_to(centre, (*radius.shape, 2)).reshape(-1, 2, 2)
    points = intersections(centre, np.maximum(radius, _SHORTEST_M).reshape(-1, 2)).reshape(-1, 2)
    kind = np.repeat(np.arange(bias_m.size), 2 * a.size)
    real = np.all(np.isfinite(points), axis=1)
    return points[real], kind[real]


def _distinct(points: Array, score: Array, radius: float, limit: int) -> NDArray[np.int64]:
    """Indices of the best points that are further than ``radius`` from a better one."""
    order = np.argsort(-score, kind="stable")
    kept: list[int] = []
    free = np.ones(len(points), dtype=bool)
    for index in order:
        if free[index]:
            kept.append(int(index))
            free &= np.sum((points - points[index]) ** 2, axis=1) > radius**2
            if len(kept) == limit:
                break
    return np.array(kept, dtype=np.int64)


def _refine(
    points: Array, bias: Array, heard: Heard, walls: dict[int, Array], config: GaussianConfig
) -> tuple[Array, Array]:
    """Gauss-Newton on the likeliest label of each centre; points (S, 2), information (S, 2, 2)."""
    points, information = points.copy(), np.zeros((len(points), 2, 2))
    moving = np.arange(len(points))
    for _ in range(6):
        at = points[moving]
        seen = see(at, bias[moving], heard, config)
        chance = prior_visibility(at, heard, walls) * config.detection_probability
        best = np.argmax(seen.relative, axis=-1)
        label = (*np.ogrid[tuple(slice(n) for n in best.shape)], best)
        weight = _odds(seen.relative[label][..., None], chance[:, None])[..., 0]
        variance = seen.variance + np.broadcast_to(heard.variance_m2, seen.relative.shape)[label]
        weight = np.where(weight > 0.0, weight / (1.0 + weight) / variance, 0.0)
        unit = np.stack([seen.along, seen.across], axis=-1)
        pull = weight * np.where(weight > 0.0, seen.residual[label], 0.0)
        gradient = np.einsum("seq,seqi->si", pull, unit)
        own = np.einsum("seq,seqi,seqj->sij", weight, unit, unit) + 1e-4 * np.eye(2)
        step = np.linalg.solve(own, gradient[..., None])[..., 0]
        points[moving], information[moving] = at + step, own
        moving = moving[np.sum(step**2, axis=1) > _STILL_M**2]
        if moving.size == 0:
            break
    return points, information


def locate(
    centres: Centres,
    paths: PathBatch,
    walls: dict[int, Array],
    config: GaussianConfig,
    seed_epochs: NDArray[np.int64],
    bias_m: Array = _NO_BIAS,
    bias_log_prior: Array = _NO_BIAS,
) -> Candidates:
    """Find the places from which the paths of an anchor make sense.

    Parameters
    ----------
    centres : Centres
        Circle centres of all epochs in ``paths``.
    paths : PathBatch
        The anchor's paths.
    walls : dict of int to ndarray, shape (2,)
        VRP of each wall number: an anchor is heard over a wall only from the agent's side.
    config : GaussianConfig
        Models.
    seed_epochs : ndarray of int64
        Epochs whose circles are intersected, and which choose among the candidates; all
        epochs weigh those chosen.
    bias_m, bias_log_prior : ndarray, shape (B,)
        Clock biases that are tried, and their log prior.

    Returns
    -------
    Candidates
        Possibly empty.
    """
    none = Candidates(
        np.empty((0, 2)),
        np.empty((0, 2, 2)),
        np.empty(0),
        np.empty(0, dtype=np.int64),
        np.empty(0, dtype=np.int64),
        np.empty(0),
    )
    seeds, kind = _seeds(centres, paths, seed_epochs, bias_m)
    if len(seeds) == 0:
        return none
    here, lately = np.isin(centres.epoch, seed_epochs), np.isin(paths.epoch, seed_epochs)
    now = Heard.of(
        Centres(*(column[here] for column in vars(centres).values())),
        PathBatch(*(column[lately] for column in vars(paths).values())),
        config,
    )
    scores = []
    for chunk in np.array_split(np.arange(len(seeds)), max(1, len(seeds) // _CHUNK)):
        relative = see(seeds[chunk], bias_m[kind[chunk]], now, config).relative.sum(axis=-1)
        chance = (prior_visibility(seeds[chunk], now, walls) * config.detection_probability)[:, None]
        scores.append(np.sum(np.log1p(chance * (relative - 1.0)), axis=(1, 2)))
    score = np.concatenate(scores)
    chosen = []
    for each in range(bias_m.size):
        own = np.flatnonzero(kind == each)
        chosen.append(own[_distinct(seeds[own], score[own], 0.7, _REFINED)])
    pick = np.concatenate(chosen)
    pick = pick[np.argsort(-(score + bias_log_prior[kind])[pick], kind="stable")[:_REFINED_IN_ALL]]
    points, bias, log_prior = seeds[pick], bias_m[kind[pick]], bias_log_prior[kind[pick]]
    heard = Heard.of(centres, paths, config)
    points, information = _refine(points, bias, heard, walls, config)
    finite = np.all(np.isfinite(points), axis=1) & (np.linalg.norm(points, axis=1) < 2.0 * config.region_m)
    points, bias, log_prior, information = (
        points[finite],
        bias[finite],
        log_prior[finite],
        information[finite],
    )
    if len(points) == 0:
        return none
    total, matches, fresh = _weigh(points, bias, information, heard, walls, config)
    total = total + log_prior
    covariance = np.linalg.inv(information)
    kept = _distinct(np.column_stack([points, bias]), total, 0.5, config.start_attempts)
    kept = kept[total[kept] > total[kept[0]] - config.prune_nats]
    return Candidates(points[kept], covariance[kept], total[kept], matches[kept], fresh[kept], bias[kept])


def evidence_at(
    points: Array,
    centres: Centres,
    paths: PathBatch,
    walls: dict[int, Array],
    config: GaussianConfig,
    bias_m: Array = _NO_BIAS,
) -> Array:
    """Log evidence (S,) of the anchor standing near ``points`` (S, 2), on the scale of :func:`locate`."""
    bias = np.broadcast_to(bias_m, len(points))
    heard = Heard.of(centres, paths, config)
    points, information = _refine(points, bias, heard, walls, config)
    return _weigh(points, bias, information, heard, walls, config)[0]


def _weigh(
    points: Array,
    bias: Array,
    information: Array,
    heard: Heard,
    walls: dict[int, Array],
    config: GaussianConfig,
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Log evidence (S,), numbers of explained first-order features (S,), and of those of the last epoch (S,).

    Over a few epochs a feature is visible all along or not at all: belief propagation between
    the epochs' associations tells which. A feature counts if most epochs heard it.
    """
    relative, prior = see(points, bias, heard, config).relative, prior_visibility(points, heard, walls)
    epochs = len(heard.x)
    first = heard.bounces < 2
    often, sure = np.zeros(prior.shape), np.zeros(prior.shape, dtype=bool)
    log_ratio = np.zeros((len(points), epochs, prior.shape[1]))  # of being visible, over not
    contest = np.zeros((len(points), epochs))
    pd, last = config.detection_probability, min(epochs, 2) - 1
    for sweep in range(last + 1):
        for e in range(epochs):
            others = log_ratio.sum(axis=1) - log_ratio[:, e]
            visible = prior / (prior + (1.0 - prior) * np.exp(-np.clip(others, -50.0, 50.0)))
            here = relative[:, e]
            ratio = _odds(here, pd * visible)
            association = associate(ratio)
            told = here * association.message
            log_ratio[:, e] = np.log(1.0 - pd + pd * told.sum(axis=-1))
            own = np.log1p((ratio * association.message).sum(axis=-1)).sum(axis=-1)
            contest[:, e] = association.log_evidence - own
            if sweep == last:
                often += association.probability.sum(axis=-1) / epochs
                sure = association.probability.max(axis=-1, initial=0.0) > _SURE
    total = np.sum(np.log(1.0 - prior + prior * np.exp(np.minimum(log_ratio.sum(axis=1), 300.0))), axis=-1)
    total = total + contest.sum(axis=-1)
    total = total + _BEHIND_LOG_PRIOR * walls_between(points, walls)
    area = np.pi * config.region_m**2  # the prior, and Laplace's approximation of the integral
    total = total - 0.5 * np.linalg.slogdet(information)[1] + np.log(2.0 * np.pi / area)
    return total, np.sum((often > 0.5) & first, axis=-1), np.sum(sure & first, axis=-1)
