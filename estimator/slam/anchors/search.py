"""Locating an anchor from path lengths with unknown labels (Section IV-B1).

A mirror keeps lengths, so the path that leaves the anchor and bounces off wall ``l``
is as long as the straight way from the anchor to the *agent's* image in ``l``. Every
path length thus puts the anchor on a circle round a known centre: the agent, one of
its images or an image of an image; which one is unknown. Pairs of circles give
candidates, each is scored by all the paths, refined, and weighed by its evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.circles import Centres, intersections
from estimator.slam.association import associate
from estimator.slam.config import GaussianConfig
from estimator.slam.features import wall_side

__all__ = ["Candidates", "PathBatch", "best_of", "evidence_at", "locate"]

Array = NDArray[np.float64]
_REFINED = 60  # intersections that are refined and weighed by all epochs
_SURE = 0.9  # association probability from which a label is believed
_PRIOR = (0.9, 0.6, 0.2)  # that a path of 0, 1, 2 bounces can be heard
_BEHIND_LOG_PRIOR = -2.5  # of standing behind a known wall: anchors are rarely in other rooms
_LOSS_MEAN_DB, _LOSS_STD_DB, _LOSS_RANGE_DB = 0.0, 2.5, 40.0  # direct paths; any path


@dataclass(frozen=True, eq=False)
class PathBatch:
    """Path lengths of one anchor.

    Parameters
    ----------
    length_m, variance_m2 : ndarray, shape (N,)
        Lengths and their variances.
    epoch : ndarray of int64, shape (N,)
        The epoch each belongs to.
    excess_loss_db : ndarray, shape (N,)
        Loss beyond free space, dB; NaN if unknown.
    """

    length_m: Array
    variance_m2: Array
    epoch: NDArray[np.int64]
    excess_loss_db: Array


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
    label : ndarray of int64, shape (S, C)
        For each centre the path that belongs to it, -1 for none or if in doubt.
    bias_m : ndarray, shape (S,)
        Clock bias that was taken off the path lengths.
    """

    mean_m: Array
    covariance_m2: Array
    log_evidence: Array
    matches: NDArray[np.int64]
    label: NDArray[np.int64]
    bias_m: Array

    def at_bias(self, bias_m: float, log_prior: float = 0.0) -> Candidates:
        """The candidates found after ``bias_m`` was taken off, with its log prior added."""
        return replace(
            self,
            log_evidence=self.log_evidence + log_prior,
            bias_m=np.full(len(self.mean_m), bias_m),
        )


def best_of(found: list[Candidates], config: GaussianConfig) -> Candidates:
    """The candidates of several searches as one, the best ``start_attempts`` of all."""
    joined = Candidates(*(np.concatenate([getattr(c, f.name) for c in found]) for f in fields(Candidates)))
    order = np.argsort(-joined.log_evidence, kind="stable")[: config.start_attempts]
    order = order[joined.log_evidence[order] > joined.log_evidence.max(initial=-np.inf) - config.prune_nats]
    return Candidates(*(getattr(joined, f.name)[order] for f in fields(Candidates)))


def _loss_ratio(paths: PathBatch, bounces: NDArray[np.int64]) -> Array:
    """Likelihood ratio (C, N) of each path's loss, centre against clutter; 1 where unknown."""
    deviation = (paths.excess_loss_db - _LOSS_MEAN_DB) / _LOSS_STD_DB
    density = np.exp(-0.5 * deviation**2) / (np.sqrt(2.0 * np.pi) * _LOSS_STD_DB)
    ratio = np.maximum(density * _LOSS_RANGE_DB, 1e-3)
    known = np.isfinite(paths.excess_loss_db)
    return np.where((bounces == 0)[:, None] & known, np.where(known, ratio, 1.0), 1.0)


def _along(unit: Array, centres: Centres) -> Array:
    """Variance (S, C) of the centres in the directions ``unit`` (S, C, 2)."""
    return np.asarray(np.einsum("sci,cij,scj->sc", unit, centres.covariance_m2, unit))


def _likelihood(
    points: Array, centres: Centres, paths: PathBatch, walls: dict[int, Array], config: GaussianConfig
) -> tuple[Array, Array, Array]:
    """Likelihoods (S, C, N) over clutter's, prior visibilities (S, C) and residuals (S, C, N)."""
    offset = points[:, None, :] - centres.point_m
    distance = np.maximum(np.linalg.norm(offset, axis=-1), 1e-6)  # (S, C)
    residual = paths.length_m - distance[..., None]
    variance = _along(offset / distance[..., None], centres)[..., None] + paths.variance_m2
    same = centres.epoch[:, None] == paths.epoch
    gate = same & (residual**2 < config.gate_sigma**2 * variance)
    density = np.exp(-0.5 * residual**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    relative = density / config.clutter_density * _loss_ratio(paths, centres.bounces)
    visible = np.broadcast_to(np.array(_PRIOR)[centres.bounces], distance.shape).copy()
    for slot, vrp in walls.items():
        over = (centres.wall == slot) & (centres.bounces == 1)
        visible[:, over] *= (wall_side(points, vrp) < 0.0)[:, None]
    return np.where(gate, relative, 0.0), visible, residual


def _odds(relative: Array, chance: Array) -> Array:
    """Association ratios (S, C, N) of features that are measured with probability ``chance`` (S, C)."""
    return np.asarray((chance / (1.0 - chance))[..., None] * relative)


def _seeds(centres: Centres, paths: PathBatch, epochs: NDArray[np.int64]) -> Array:
    """Candidate positions (S, 2): intersections of circles of up to one bounce."""
    centre_index = np.flatnonzero((centres.bounces < 2) & np.isin(centres.epoch, epochs))
    path_index = np.flatnonzero(np.isin(paths.epoch, epochs))
    c, p = (index.ravel() for index in np.meshgrid(centre_index, path_index, indexing="ij"))
    fits = centres.epoch[c] == paths.epoch[p]
    c, p = c[fits], p[fits]
    a, b = np.triu_indices(len(c), 1)
    apart = (c[a] != c[b]) & (p[a] != p[b])
    a, b = a[apart], b[apart]
    points = intersections(
        np.stack([centres.point_m[c[a]], centres.point_m[c[b]]], axis=1),
        np.stack([paths.length_m[p[a]], paths.length_m[p[b]]], axis=1),
    ).reshape(-1, 2)
    return points[np.all(np.isfinite(points), axis=1)]


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
    points: Array, centres: Centres, paths: PathBatch, walls: dict[int, Array], config: GaussianConfig
) -> tuple[Array, Array]:
    """Gauss-Newton on the likeliest label of each centre; points (S, 2), information (S, 2, 2)."""
    information = np.zeros((len(points), 2, 2))
    for _ in range(6):
        relative, visible, residual = _likelihood(points, centres, paths, walls, config)
        ratio = _odds(relative, visible * config.detection_probability)
        best = np.argmax(ratio, axis=-1)[..., None]
        weight = np.take_along_axis(ratio, best, axis=-1)[..., 0]
        weight = weight / (1.0 + weight)
        error = np.take_along_axis(residual, best, axis=-1)[..., 0]
        offset = points[:, None, :] - centres.point_m
        unit = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-6)
        variance = _along(unit, centres) + paths.variance_m2[best[..., 0]]
        weight = weight / variance
        information = np.einsum("sc,sci,scj->sij", weight, unit, unit) + 1e-4 * np.eye(2)
        gradient = np.einsum("sc,sci->si", weight * error, unit)
        points = points + np.linalg.solve(information, gradient[..., None])[..., 0]
    return points, information


def locate(
    centres: Centres,
    paths: PathBatch,
    walls: dict[int, Array],
    config: GaussianConfig,
    seed_epochs: NDArray[np.int64],
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
        np.empty((0, len(centres.epoch)), dtype=np.int64),
        np.empty(0),
    )
    seeds = _seeds(centres, paths, seed_epochs)
    if len(seeds) == 0:
        return none
    here, heard = np.isin(centres.epoch, seed_epochs), np.isin(paths.epoch, seed_epochs)
    now = Centres(*(column[here] for column in vars(centres).values()))
    now_paths = PathBatch(*(column[heard] for column in vars(paths).values()))
    scores = []
    for chunk in np.array_split(seeds, max(1, len(seeds) // 512)):
        relative, visible, _ = _likelihood(chunk, now, now_paths, walls, config)
        chance = visible * config.detection_probability
        scores.append(np.sum(np.log1p(chance * (relative.sum(axis=-1) - 1.0)), axis=-1))
    score = np.concatenate(scores)
    points = seeds[_distinct(seeds, score, 0.7, _REFINED)]
    points, information = _refine(points, centres, paths, walls, config)
    finite = np.all(np.isfinite(points), axis=1) & (np.linalg.norm(points, axis=1) < 2.0 * config.region_m)
    points, information = points[finite], information[finite]
    if len(points) == 0:
        return none
    total, label, matches = _weigh(points, information, centres, paths, walls, config)
    covariance = np.linalg.inv(information)
    kept = _distinct(points, total, 0.5, config.start_attempts)
    kept = kept[total[kept] > total[kept[0]] - config.prune_nats]
    return Candidates(
        points[kept], covariance[kept], total[kept], matches[kept], label[kept], np.zeros(kept.size)
    )


def evidence_at(
    points: Array, centres: Centres, paths: PathBatch, walls: dict[int, Array], config: GaussianConfig
) -> Array:
    """Log evidence (S,) of the anchor standing near ``points`` (S, 2), on the scale of :func:`locate`."""
    points, information = _refine(points, centres, paths, walls, config)
    return _weigh(points, information, centres, paths, walls, config)[0]


def _weigh(
    points: Array,
    information: Array,
    centres: Centres,
    paths: PathBatch,
    walls: dict[int, Array],
    config: GaussianConfig,
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Log evidence (S,), labels (S, C) and numbers of explained first-order features (S,).

    Over a few epochs a feature is visible all along or not at all: belief propagation between
    the epochs' associations tells which. A feature counts if most epochs heard it.
    """
    relative, prior, _ = _likelihood(points, centres, paths, walls, config)
    epochs = np.unique(centres.epoch)
    shape = (len(points), epochs.size, -1)  # the centres of each epoch come in the same order
    order = np.argsort(centres.epoch, kind="stable")
    rows, prior = order.reshape(epochs.size, -1), prior[:, order].reshape(shape)[:, 0]
    label, heard = np.full(relative.shape[:2], -1), np.zeros(relative.shape[:2])
    log_ratio = np.zeros((len(points), *rows.shape))  # of being visible, over not
    contest = np.zeros((len(points), epochs.size))
    pd = config.detection_probability
    for _ in range(2 if epochs.size > 1 else 1):
        for e, epoch in enumerate(epochs):
            columns = np.flatnonzero(paths.epoch == epoch)
            others = log_ratio.sum(axis=1) - log_ratio[:, e]
            visible = prior / (prior + (1.0 - prior) * np.exp(-np.clip(others, -50.0, 50.0)))
            here = relative[:, rows[e]][:, :, columns]
            ratio = _odds(here, pd * visible)
            association = associate(ratio)
            told = here * association.message
            log_ratio[:, e] = np.log(1.0 - pd + pd * told.sum(axis=-1))
            own = np.log1p((ratio * association.message).sum(axis=-1)).sum(axis=-1)
            contest[:, e] = association.log_evidence - own
            share = association.probability
            heard[:, rows[e]] = share.sum(axis=-1)
            likely = share.max(axis=-1, initial=0.0) > _SURE
            if columns.size:
                label[:, rows[e]] = np.where(likely, columns[np.argmax(share, axis=-1)], -1)
    total = np.sum(np.log(1.0 - prior + prior * np.exp(np.minimum(log_ratio.sum(axis=1), 300.0))), axis=-1)
    total = total + contest.sum(axis=-1)
    for vrp in walls.values():
        total = total + np.where(wall_side(points, vrp) > 0.0, _BEHIND_LOG_PRIOR, 0.0)
    area = np.pi * config.region_m**2  # the prior, and Laplace's approximation of the integral
    total = total - 0.5 * np.linalg.slogdet(information)[1] + np.log(2.0 * np.pi / area)
    often = heard[:, rows].mean(axis=1) > 0.5
    return total, label, np.sum(often & (centres.bounces[rows[0]] < 2), axis=-1)
