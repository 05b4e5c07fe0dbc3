"""Which features may have given the measurements of an epoch, and how well they would fit.

Of the pairs of walls few are near any measurement; derivatives and association ratios are made of those
alone, packed side by side.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import Prediction, lines_of
from estimator.slam.gaussian.azimuths import azimuth_ratio
from estimator.slam.gaussian.kalman import kalman
from estimator.slam.gaussian.packing import packed
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.layout import Layout

__all__ = ["Hearing", "Near", "take"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_BENT = 0.5  # of the shift of a prediction: by how much its derivatives may be wrong
_MARGIN = 1.5  # times the gate: pairs of walls farther from every measurement are not looked at


@dataclass(frozen=True, eq=False)
class Near:
    """Features that may have given a measurement, C of each anchor, and how well they would fit.

    Parameters
    ----------
    feature : ndarray of int64, shape (R, K, C)
        Which features.
    real : ndarray of bool, shape (R, K, C)
        Which entries are any; the others fill up.
    jacobian, cross : ndarray, shape (R, K, C, n)
        Derivatives of the lengths, and their products with the covariance.
    spread : ndarray, shape (R, K, C)
        Variance of the predicted lengths that is due to the state.
    innovation, ratio : ndarray, shape (R, K, C, M)
        Measured minus predicted lengths; association ratios.
    """

    feature: NDArray[np.int64]
    real: Mask
    jacobian: Array
    cross: Array
    spread: Array
    innovation: Array
    ratio: Array

    @property
    def at(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Where the features are in arrays (R, K, F)."""
        return *lines_of(self.feature), self.feature

    def of_rows(self, index: NDArray[np.int64]) -> Near:
        """Those of the rows at ``index``."""
        return Near(*(getattr(self, entry.name)[index] for entry in fields(self)))


@dataclass(frozen=True, eq=False)
class Hearing:
    """What an epoch brings to R rows.

    Parameters
    ----------
    paths : PathTable
        Its paths, (R, K, M), or (1, K, M) if they are the same for all rows.
    variance : ndarray, of their shape
        Variances of the lengths, square metres.
    clutter : ndarray, shape (R, K, 1)
        Intensity per metre of paths that no feature gives.
    layout : Layout
        Positions in the state vector.
    config : GaussianConfig
        Models.
    """

    paths: PathTable
    variance: Array
    clutter: Array
    layout: Layout
    config: GaussianConfig

    @classmethod
    def of(
        cls,
        paths: PathTable,
        clutter: Array | float | None,
        rows: int,
        layout: Layout,
        config: GaussianConfig,
    ) -> Hearing:
        """What ``paths`` bring to ``rows`` rows; ``clutter`` as that of :func:`correct` of the update."""
        paths = paths.by_row()
        density = np.asarray(config.clutter_density if clutter is None else clutter)
        variance = np.maximum(paths.std_m, config.range_std_m) ** 2
        density = np.broadcast_to(density, (rows, layout.anchors))[..., None]
        return cls(paths, variance, density, layout, config)

    def of_rows(self, index: NDArray[np.int64]) -> Hearing:
        """The same for the rows at ``index``."""
        variance = self.variance if len(self.variance) == 1 else self.variance[index]
        return replace(self, paths=self.paths.of_rows(index), variance=variance, clutter=self.clutter[index])

    def beside(self, length_m: Array, chance: Array, free: Mask) -> Mask:
        """Features (R, K, F) that may give one of the measurements ``free`` (R, K, M).

        A pair of walls counts only if one lies where a pair known well enough could be heard.
        """
        layout, config = self.layout, self.config
        could = chance > 0.0
        if layout.pairs and could[..., 1 + layout.slots :].any():
            noise = np.max(self.variance, where=self.paths.valid, initial=config.range_std_m**2)
            reach = _MARGIN * config.gate_sigma * np.sqrt(config.pair_gate_std_m**2 + noise)
            row, anchor, pair = np.nonzero(could[..., 1 + layout.slots :])
            feature = pair + 1 + layout.slots
            shared = np.zeros_like(row) if len(self.variance) == 1 else row
            gap = self.paths.length_m[shared, anchor] - length_m[row, anchor, feature, None]
            near = ((np.abs(gap) < reach) & free[row, anchor]).any(axis=-1)
            could[row, anchor, feature] = near
        return could

    def near(
        self, mean: Array, covariance: Array, prediction: Prediction, chance: Array, could: Mask, free: Mask
    ) -> Near:
        """How the features ``could`` (R, K, F) fit the measurements ``free`` (R, K, M)."""
        layout, config = self.layout, self.config
        feature, real = packed(could)
        rows, anchors, columns = feature.shape
        jacobian = prediction.derivatives(feature)
        flat = jacobian.reshape(rows, anchors * columns, layout.size)
        cross = flat @ covariance
        spread = np.einsum("rin,rin->ri", cross, flat).reshape(feature.shape)
        s = spread[..., None] + self.variance[:, :, None, :]
        at = *lines_of(feature), feature
        innovation = self.paths.length_m[:, :, None, :] - prediction.length_m[at][..., None]
        square = innovation**2
        known = real & ((feature <= layout.slots) | (spread < config.pair_gate_std_m**2) | (not layout.pairs))
        gated = (square < config.gate_sigma**2 * s) & (free[:, :, None, :] & known[..., None])
        ratio = np.zeros(gated.shape)
        fits = np.nonzero(gated)
        own = chance[at]
        odds = (own / ((1.0 - own) * self.clutter))[fits[:-1]]
        spread_of, square = s[fits], square[fits]
        ratio[fits] = odds * (np.exp(-0.5 * square / spread_of) / np.sqrt(2.0 * np.pi * spread_of))
        ratio = ratio * azimuth_ratio(mean, covariance, self.paths, layout, feature)
        return Near(feature, real, jacobian, cross.reshape(jacobian.shape), spread, innovation, ratio)

    def fitting(self, near: Near, free: Mask, moved: Array) -> Mask:
        """Features (R, K, C) that measurements ``free`` (R, K, M) might fit now that rows moved (R, n)."""
        shift = np.einsum("rkcn,rn->rkc", near.jacobian, moved)[..., None]
        reach = self.config.gate_sigma * np.sqrt(near.spread[..., None] + self.variance[:, :, None, :])
        close = np.abs(near.innovation - shift) < reach + _BENT * np.abs(shift)
        return np.asarray(near.real & (close & free[:, :, None, :]).any(axis=-1))


def take(
    mean: Array, covariance: Array, near: Near, innovation: Array, variance: Array, use: Mask
) -> tuple[Array, Array, Array]:
    """:func:`kalman` with the features (R, K, C) that ``use`` marks, of the rows that have any.

    ``innovation`` and ``variance`` are of that shape.
    """
    rows, size = mean.shape
    column, keep = packed(use.reshape(rows, -1))
    some = np.flatnonzero(keep.any(axis=1))
    if some.size == 0:
        return mean, covariance, np.zeros(rows)
    row, column, keep = some[:, None], column[some], keep[some]
    jacobian, cross = (each.reshape(rows, -1, size)[row, column] for each in (near.jacobian, near.cross))
    jacobian *= keep[..., None]
    cross *= keep[..., None]
    innovation = np.where(keep, innovation.reshape(rows, -1)[row, column], 0.0)
    variance = np.where(keep, variance.reshape(rows, -1)[row, column], 0.5 / np.pi)
    if some.size == rows:
        return kalman(mean, covariance, jacobian, innovation, variance, cross=cross)
    mean, covariance, log_density = mean.copy(), covariance.copy(), np.zeros(rows)
    mean[some], covariance[some], log_density[some] = kalman(
        mean[some], covariance[some], jacobian, innovation, variance, cross=cross
    )
    return mean, covariance, log_density
