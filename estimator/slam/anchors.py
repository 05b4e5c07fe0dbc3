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

from estimator.slam.association import associate
from estimator.slam.config import GaussianConfig
from estimator.slam.features import reflect, wall_side

__all__ = ["Candidates", "Centres", "PathBatch", "best_of", "evidence_at", "images_of_agent", "locate"]

Array = NDArray[np.float64]
_SURE = 0.9  # association probability from which a label is believed
_PRIOR = (0.9, 0.6, 0.2)  # that a path of 0, 1, 2 bounces can be heard
_LOSS_MEAN_DB, _LOSS_STD_DB, _LOSS_RANGE_DB = 0.0, 2.5, 40.0  # direct paths; any path


@dataclass(frozen=True, eq=False)
class Centres:
    """Circle centres of one or more epochs.

    Parameters
    ----------
    point_m : ndarray, shape (C, 2)
        The agent and its images.
    covariance_m2 : ndarray, shape (C, 2, 2)
        Their covariances.
    bounces : ndarray of int64, shape (C,)
        0 for the agent, 1 for an image in a wall, 2 for an image of an image.
    epoch : ndarray of int64, shape (C,)
        The epoch it belongs to.
    wall, behind : ndarray of int64, shape (C,)
        Wall of the first image and of the second, -1 where there is none.
    """

    point_m: Array
    covariance_m2: Array
    bounces: NDArray[np.int64]
    epoch: NDArray[np.int64]
    wall: NDArray[np.int64]
    behind: NDArray[np.int64]


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
        Number of paths of up to one bounce that are explained.
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


def images_of_agent(
    position: Array,
    position_variance: float,
    walls: Array,
    wall_covariance: Array,
    slots: NDArray[np.int64],
    epoch: int,
) -> Centres:
    """The agent and its images in the walls, up to two bounces.

    Parameters
    ----------
    position : ndarray, shape (2,)
        Agent, gauge frame, metres.
    position_variance : float
        Its variance per axis, square metres.
    walls : ndarray, shape (L, 2)
        VRPs.
    wall_covariance : ndarray, shape (L, 2, 2)
        Their covariances.
    slots : ndarray of int64, shape (L,)
        Numbers to give the walls.
    epoch : int
        Number of the epoch.
    """
    count = len(walls)
    first = reflect(np.broadcast_to(position, (count, 2)), walls)
    own = position_variance * np.eye(2)
    covariance = own + wall_covariance
    # from the anchor over a near, then a far wall: the image in the near of the image in the far
    near, far = np.nonzero(~np.eye(count, dtype=bool))
    second = reflect(first[far], walls[near])
    none = np.full(1, -1)
    return Centres(
        np.concatenate([position[None], first, second]),
        np.concatenate([own[None], covariance, covariance[near] + wall_covariance[far]]),
        np.repeat([0, 1, 2], [1, count, near.size]),
        np.full(1 + count + near.size, epoch),
        np.concatenate([none, slots, slots[near]]),
        np.concatenate([none, np.full(count, -1), slots[far]]),
    )


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


def _odds(
    points: Array, centres: Centres, paths: PathBatch, walls: dict[int, Array], config: GaussianConfig
) -> tuple[Array, Array, Array]:
    """Association ratios (S, C, N), miss probabilities (S, C) and residuals (S, C, N)."""
    offset = points[:, None, :] - centres.point_m
    distance = np.maximum(np.linalg.norm(offset, axis=-1), 1e-6)  # (S, C)
    residual = paths.length_m - distance[..., None]
    variance = _along(offset / distance[..., None], centres)[..., None] + paths.variance_m2
    same = centres.epoch[:, None] == paths.epoch
    gate = same & (residual**2 < config.gate_sigma**2 * variance)
    density = np.exp(-0.5 * residual**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    chance = np.array(_PRIOR)[centres.bounces] * config.detection_probability
    possible = np.ones(distance.shape, dtype=bool)
    for slot, vrp in walls.items():
        possible[:, (centres.wall == slot) & (centres.bounces == 1)] &= (wall_side(points, vrp) < 0.0)[
            :, None
        ]
    chance = np.where(possible, chance, 0.0)
    odds = chance / (1.0 - chance) / config.clutter_density
    return (
        np.where(gate, odds[..., None] * density * _loss_ratio(paths, centres.bounces), 0.0),
        1.0 - chance,
        residual,
    )


def _intersections(centres: Array, radii: Array) -> Array:
    """Intersections (P, 2, 2) of pairs of circles, centres (P, 2, 2) and radii (P, 2); NaN if apart."""
    offset = centres[:, 1] - centres[:, 0]
    distance = np.linalg.norm(offset, axis=1)
    distance = np.where(distance > 1e-6, distance, np.nan)
    along = (distance**2 + radii[:, 0] ** 2 - radii[:, 1] ** 2) / (2.0 * distance)
    height2 = radii[:, 0] ** 2 - along**2
    height = np.sqrt(np.where(height2 > -1.0, np.maximum(height2, 0.0), np.nan))
    unit = offset / distance[:, None]
    foot = centres[:, 0] + along[:, None] * unit
    side = np.stack([-unit[:, 1], unit[:, 0]], axis=1) * height[:, None]
    return np.stack([foot + side, foot - side], axis=1)


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
    points = _intersections(
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
            free &= np.linalg.norm(points - points[index], axis=1) > radius
            if len(kept) == limit:
                break
    return np.array(kept, dtype=np.int64)


def _refine(
    points: Array, centres: Centres, paths: PathBatch, walls: dict[int, Array], config: GaussianConfig
) -> tuple[Array, Array]:
    """Gauss-Newton on the likeliest label of each centre; points (S, 2), information (S, 2, 2)."""
    information = np.zeros((len(points), 2, 2))
    for _ in range(6):
        ratio, _, residual = _odds(points, centres, paths, walls, config)
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
        ratio, miss, _ = _odds(chunk, now, now_paths, walls, config)
        scores.append(np.sum(np.log(miss) + np.log1p(ratio.sum(axis=-1)), axis=-1))
    score = np.concatenate(scores)
    points = seeds[_distinct(seeds, score, 0.7, 150)]
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
    """Log evidence (S,), labels (S, C) and numbers of explained first-order paths (S,)."""
    ratio, miss, _ = _odds(points, centres, paths, walls, config)
    total = np.sum(np.log(miss), axis=-1)
    label, heard = np.full(ratio.shape[:2], -1), np.zeros(ratio.shape[:2], dtype=bool)
    for epoch in np.unique(paths.epoch):
        rows, columns = np.flatnonzero(centres.epoch == epoch), np.flatnonzero(paths.epoch == epoch)
        association = associate(ratio[:, rows][:, :, columns])
        total = total + association.log_evidence
        share = association.probability
        likely = share.max(axis=-1) > _SURE
        label[:, rows] = np.where(likely, columns[np.argmax(share, axis=-1)], -1)
        heard[:, rows] = share.sum(axis=-1) > 0.5
    area = np.pi * config.region_m**2  # the prior, and Laplace's approximation of the integral
    total = total - 0.5 * np.linalg.slogdet(information)[1] + np.log(2.0 * np.pi / area)
    return total, label, np.sum(heard & (centres.bounces < 2), axis=-1)
