"""Which reflecting-surface points lie on one wall: segmentation without knowing the number of walls.

Every beam of a sweep gives at most one range. A labelling says for each beam which wall returned
it, or that none did (a corner, furniture, a false peak). The best labelling minimises an energy in
nats, a description length,

    E = sum_beams -log p(range | label) + sum_neighbours (change if labels differ) + sum_walls cost(wall),

over labels *and* walls: ranges are Gaussian about a wall's line (:mod:`estimator.sensing.linefit`)
and uniform where there is none. A wall costs what it takes to tell its two parameters as precisely as
its ranges know them (Occam's factor: two ranges fit always, so they prove nothing). For given walls
the best labels come from dynamic programming around the circle of beams; for given labels the best
walls are maximum-likelihood lines. The two alternate, from proposals through any three beams among
a few neighbours, and walls are taken away as long as that lowers the energy. A wall may be
interrupted: its beams need not be neighbours.

Two walls that meet reflect back whatever hits their corner, at any direction about it. Such returns
have the range of the corner point in a few neighbouring beams, and look like a small wall across the
corner: a wall whose foot is where two others meet, seen over a narrow angle, is rejected.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.measurements import GaussianVrp
from estimator.sensing.linefit import BeamFan, LineFit, fit_lines
from estimator.sensing.uncertainty import checked_ranges

__all__ = ["SegmentationConfig", "WallSegments", "segment_walls"]

Array = NDArray[np.float64]
Labels = NDArray[np.int64]

_FAR = 1e9  # nats


@dataclass(frozen=True)
class SegmentationConfig:
    """Prior of walls and returns.

    Parameters
    ----------
    max_range_m : float
        A return from no wall has a range uniform on (0, max_range_m), metres.
    outlier_probability : float
        Probability that a beam's return comes from no wall.
    change_probability : float
        Probability that two neighbouring beams meet different walls.
    wall_cost : float
        What one more wall must save beyond the cost of its parameters, nats.
    least_points : int
        Fewest beams of a wall; a line through two points fits always.
    window : int
        Any three beams among so many neighbours propose a wall.
    corner_span_rad : float
        A wall seen over less than this may be a corner's return, radians.
    corner_std_m : float
        How far the apparent centre of a corner's return is from the corner, metres.
    corner_confidence : float
        Probability with which a true corner's return is recognised.
    """

    max_range_m: float = 180.0
    outlier_probability: float = 0.05
    change_probability: float = 0.1
    wall_cost: float = 3.0
    least_points: int = 3
    window: int = 4
    corner_span_rad: float = float(np.deg2rad(25.0))
    corner_std_m: float = 0.2
    corner_confidence: float = 0.99

    def __post_init__(self) -> None:
        for name in ("outlier_probability", "change_probability", "corner_confidence"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ConfigurationError(
                    f"{name}: expected a number between 0 and 1, got {getattr(self, name)}"
                )
        for name in ("max_range_m", "wall_cost", "corner_span_rad", "corner_std_m"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")
        for name, least in (("least_points", 3), ("window", 3)):
            if getattr(self, name) < least:
                raise ConfigurationError(f"{name}: expected at least {least}, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class WallSegments:
    """Walls found in one sweep.

    Parameters
    ----------
    walls : tuple of GaussianVrp
        VRPs relative to where the agent stands, the nearest first.
    label : ndarray of int64, shape (M,)
        The wall that each beam met, -1 for none.
    """

    walls: tuple[GaussianVrp, ...]
    label: Labels


def segment_walls(
    distance_m: ArrayLike,
    range_std_m: ArrayLike,
    azimuth_rad: ArrayLike,
    config: SegmentationConfig | None = None,
    fan: BeamFan | None = None,
) -> WallSegments:
    """Find the walls that returned a sweep's ranges.

    Parameters
    ----------
    distance_m, range_std_m, azimuth_rad : array_like, shape (M,)
        Ranges and their standard deviations (metres), directions of the beams (radians), in any order.
    config : SegmentationConfig, optional
        Priors.
    fan : BeamFan, optional
        The M wide beams; see :func:`estimator.sensing.linefit.fit_lines`.

    Returns
    -------
    WallSegments

    Raises
    ------
    InputError
        If shapes do not fit or ranges are not positive.
    """
    config = config or SegmentationConfig()
    distance, std, azimuth = checked_ranges(distance_m, range_std_m, azimuth_rad, config.least_points)
    if distance.ndim != 1:
        raise InputError(f"distance_m: expected shape (M,), got {distance.shape}")
    order = np.argsort(np.mod(azimuth, 2.0 * np.pi), kind="stable")
    sweep = _Sweep(
        distance[order], std[order], azimuth[order], None if fan is None else fan.take(order), config
    )
    count = len(distance)
    triples = np.array([(0, *rest) for rest in combinations(range(1, config.window), 2)])
    members = (np.arange(count)[:, None, None] + triples).reshape(-1, 3) % count
    proposals = np.zeros((len(members), count))
    np.put_along_axis(proposals, members, 1.0, axis=1)
    best = sweep.settle(sweep.fit(proposals))
    while len(best.fit.cost):
        trials = [sweep.settle(_without(best.fit, k)) for k in range(len(best.fit.cost))]
        trial = min(trials, key=lambda solution: solution.energy)
        if trial.energy >= best.energy:
            break
        best = trial
    keep = [k for k in range(len(best.fit.cost)) if not sweep.is_corner(best, k)]
    keep.sort(key=lambda k: float(np.linalg.norm(best.fit.mean_m[k])))
    label = np.full(count, -1, dtype=np.int64)
    for new, old in enumerate(keep):
        label[order[best.label == old]] = new
    walls = tuple(GaussianVrp(best.fit.mean_m[k], best.fit.covariance_m2[k]) for k in keep)
    return WallSegments(walls, label)


@dataclass(frozen=True, eq=False)
class _Solution:
    """Walls, the wall of each beam (the number of walls for none), and the energy in nats."""

    fit: LineFit
    label: Labels
    energy: float


def _without(fit: LineFit, wall: int) -> LineFit:
    keep = np.arange(len(fit.cost)) != wall
    return LineFit(fit.mean_m[keep], fit.covariance_m2[keep], fit.cost[keep])


@dataclass(frozen=True, eq=False)
class _Sweep:
    """Ranges in the order of their directions."""

    distance: Array
    std: Array
    azimuth: Array
    fan: BeamFan | None
    config: SegmentationConfig

    def fit(self, weight: Array) -> LineFit:
        """Lines through the beams that each row of ``weight`` (L, M) marks, determined ones only.

        A proposal marks three beams of all, so those that a row marks come first and no more are looked at
        than the row with most of them has.
        """
        most = int(np.count_nonzero(weight, axis=1).max())
        marked = np.argsort(weight == 0.0, axis=1, kind="stable")[:, :most]
        fit = fit_lines(
            self.distance[marked],
            self.std[marked],
            self.azimuth[marked],
            np.take_along_axis(weight, marked, axis=1),
            None if self.fan is None else self.fan.take(marked),
        )
        sure = np.all(np.isfinite(fit.covariance_m2), axis=(1, 2))
        return LineFit(fit.mean_m[sure], fit.covariance_m2[sure], fit.cost[sure])

    def settle(self, fit: LineFit) -> _Solution:
        """Alternate between labels and lines until the energy falls no more."""
        best = self.label(fit)
        for _ in range(20):
            count = len(best.fit.cost)
            weight = (best.label == np.arange(count)[:, None]).astype(np.float64)
            weight = weight[weight.sum(axis=1) >= self.config.least_points]
            trial = self.label(self.fit(weight) if len(weight) else _nothing())
            if trial.energy >= best.energy and len(trial.fit.cost) == count:
                break
            best = trial
        return best

    def label(self, fit: LineFit) -> _Solution:
        """Best labels for given walls: the Viterbi path over two turns, of which the inner is kept."""
        config, count, walls = self.config, len(self.distance), len(fit.cost)
        own = np.full((count, walls + 1), np.log(config.max_range_m) - np.log(config.outlier_probability))
        own[:, :walls] = self._misfit(fit)
        change = -np.log(config.change_probability) + np.log1p(-config.change_probability)
        turns = np.concatenate([own, own])
        total = turns[0]
        back = np.empty(turns.shape, dtype=np.int64)
        for m in range(1, len(turns)):
            cheapest = int(np.argmin(total))
            stay = total <= total[cheapest] + change
            back[m] = np.where(stay, np.arange(walls + 1), cheapest)
            total = np.where(stay, total, total[cheapest] + change) + turns[m]
        path = np.empty(2 * count, dtype=np.int64)
        path[-1] = np.argmin(total)
        for m in range(2 * count - 1, 0, -1):
            path[m - 1] = back[m, path[m]]
        begin = count // 2
        label = np.roll(path[begin : begin + count], begin)
        used = np.unique(label[label < walls])
        energy = float(np.sum(own[np.arange(count), label]) + np.sum(self._occam(fit)[used]))
        energy += change * np.count_nonzero(label != np.roll(label, 1))
        label = np.where(label < walls, np.searchsorted(used, label), len(used))
        return _Solution(LineFit(fit.mean_m[used], fit.covariance_m2[used], fit.cost[used]), label, energy)

    def _occam(self, fit: LineFit) -> Array:
        """Cost (L,) of each wall in nats: prior over posterior volume of distance and normal.

        With ``v = 2 rho n`` the volumes of ``v`` and of ``(rho, alpha)`` differ by ``4 rho = 2 |v|``.
        """
        prior = self.config.max_range_m  # over 2 pi of the normals, which the Gaussian's 2 pi cancels
        volume = np.sqrt(np.linalg.det(fit.covariance_m2)) / (2.0 * np.linalg.norm(fit.mean_m, axis=1))
        return np.asarray(self.config.wall_cost + np.maximum(np.log(prior / volume), 0.0))

    def _misfit(self, fit: LineFit) -> Array:
        """Minus the log likelihood (M, L) of ranges from given walls."""
        normal = np.arctan2(fit.mean_m[:, 1], fit.mean_m[:, 0])
        rho = 0.5 * np.linalg.norm(fit.mean_m, axis=1)
        if self.fan is None:
            cosine = np.cos(self.azimuth - normal[:, None])
            secant = np.where(cosine > 1e-3, 1.0 / np.maximum(cosine, 1e-3), np.inf)
        else:
            secant = self.fan.secant(normal)[0]
        met = np.isfinite(secant)
        ranges = rho[:, None] * np.where(met, secant, 1.0)
        density = 0.5 * ((self.distance - ranges) / self.std) ** 2 + np.log(self.std * np.sqrt(2.0 * np.pi))
        return np.where(met, density - np.log1p(-self.config.outlier_probability), _FAR).T

    def is_corner(self, solution: _Solution, wall: int) -> bool:
        """Whether a wall is what the corner of two others returns."""
        fit, config = solution.fit, self.config
        seen = np.exp(1j * self.azimuth[solution.label == wall])
        span = np.ptp(np.angle(seen * np.conj(np.sum(seen))))
        if span > config.corner_span_rad:
            return False
        foot, spread = 0.5 * fit.mean_m[wall], 0.25 * fit.covariance_m2[wall]
        others = [k for k in range(len(fit.cost)) if k != wall]
        for a, b in combinations(others, 2):
            corner = _intersection(fit.mean_m[[a, b]], fit.covariance_m2[[a, b]])
            if corner is None:
                continue
            gap = foot - corner[0]
            total = spread + corner[1] + config.corner_std_m**2 * np.eye(2)
            if gap @ np.linalg.solve(total, gap) < -2.0 * np.log1p(-config.corner_confidence):
                return True
        return False


def _nothing() -> LineFit:
    return LineFit(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))


def _intersection(vrp: Array, covariance: Array) -> tuple[Array, Array] | None:
    """Where two walls (2, 2) meet, and its covariance; None if they are parallel within 10 degrees.

    A wall is ``v . x = |v|^2 / 2``, whose variation gives ``V dx = (v - x) . dv`` for both rows.
    """
    unit = vrp / np.linalg.norm(vrp, axis=1, keepdims=True)
    if abs(np.linalg.det(unit)) < np.sin(np.deg2rad(10.0)):
        return None
    point = np.linalg.solve(vrp, 0.5 * np.sum(vrp**2, axis=1))
    inverse = np.linalg.inv(vrp)
    lever = vrp - point
    spread = np.einsum("ki,kij,kj->k", lever, covariance, lever)
    return point, inverse @ np.diag(spread) @ inverse.T
