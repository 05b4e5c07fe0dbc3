"""What a search takes in: the agent at a few epochs, and the paths of one anchor heard there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.models.path_buffer import PathBuffer

__all__ = ["NoiseModel", "Observations", "direct_ratio", "gathered", "observations_of"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_BUCKETS = 256  # of the table by which paths are found: about as many as there may be paths
_LEAST_LOSS_RATIO = 1e-3  # numerical floor of the likelihood ratio of a loss


class NoiseModel(Protocol):
    """What the search needs to know of the measurements; units in :class:`MeasurementNoise`."""

    @property
    def range_std_m(self) -> float:
        """Smallest standard deviation believed of a path length, metres."""

    @property
    def detection_probability(self) -> float:
        """Probability that a visible feature is measured."""

    @property
    def clutter_mean(self) -> float:
        """Paths of an anchor and epoch that no feature explains."""

    @property
    def clutter_density(self) -> float:
        """Clutter intensity, per metre."""

    @property
    def region_m(self) -> float:
        """Largest path length, metres."""

    @property
    def height2_mean_m2(self) -> float:
        """Prior mean of the squared height difference of anchor and agent, square metres."""

    @property
    def height2_std_m2(self) -> float:
        """Its standard deviation."""


class Observations(NamedTuple):
    """One anchor's paths at E epochs, the present one last; those of different epochs never meet.

    Parameters
    ----------
    position_m : ndarray, shape (E, 2)
        The agent, metres.
    covariance_m2 : ndarray, shape (E, 2, 2)
        Its covariance, square metres.
    paths : ndarray of int64, shape (E,)
        Number of paths of each epoch.
    length_m : ndarray, shape (E, M)
        Path lengths in ascending order, infinite beyond ``paths``.
    length_variance_m2 : ndarray, shape (E, M)
        Their variances.
    direct_ratio : ndarray, shape (E, M)
        Likelihood ratio of the path's loss in line of sight, against any other path; 1 where unknown.
    first : ndarray of int64, shape (E, B)
        The first path that is no shorter than ``b / buckets_per_m``.
    buckets_per_m : float
        Their number on a metre.
    """

    position_m: Array
    covariance_m2: Array
    paths: Index
    length_m: Array
    length_variance_m2: Array
    direct_ratio: Array
    first: Index
    buckets_per_m: float


def observations_of(
    anchor: int,
    position_m: Array,
    variance_m2: float,
    now: tuple[Array, Array, Array],
    heard: PathBuffer,
    gain_offset_db: float,
    noise: NoiseModel,
    config: AnchorSearchConfig,
) -> Observations:
    """The present paths of an anchor and those of remembered epochs, every ``search_stride``-th.

    Parameters
    ----------
    anchor : int
        Its number.
    position_m, variance_m2
        The agent at the present epoch, metres, and its variance per axis, square metres.
    now : tuple of ndarray, shape (M,)
        Lengths, standard deviations and excess losses of the present paths.
    heard : PathBuffer
        The epochs before.
    gain_offset_db : float
        To be taken off all losses; NaN if unknown.
    noise, config
        Models.
    """
    positions, variances, parts = [position_m], [variance_m2], [now]
    track = heard.track
    stride = 1 if len(track.epoch) < config.search_stride else config.search_stride
    own = heard.anchor == anchor
    for i in range(len(track.epoch) - 1, -1, -stride):
        old = np.flatnonzero(own & (heard.epoch == track.epoch[i]))
        if old.size:
            positions.append(track.position_m[i])
            variances.append(float(track.std_m[i]) ** 2)
            parts.append((heard.length_m[old], heard.std_m[old], heard.excess_loss_db[old]))
    epochs = []
    for lengths, std, loss in reversed(parts):
        ratio = direct_ratio(loss - gain_offset_db, config)
        epochs.append((lengths, np.maximum(std, noise.range_std_m) ** 2, ratio))
    return gathered(np.array(positions[::-1]), np.array(variances[::-1])[:, None, None] * np.eye(2), epochs)


def gathered(
    position_m: Array, covariance_m2: Array, epochs: Sequence[tuple[Array, Array, Array]]
) -> Observations:
    """Observations at some positions (E, 2), known to (E, 2, 2), of lengths, variances, direct ratios."""
    count = np.array([len(lengths) for lengths, _, _ in epochs])
    shape = len(epochs), max(int(count.max()), 1)
    length, variance, ratio = np.full(shape, np.inf), np.ones(shape), np.ones(shape)
    for e, columns in enumerate(epochs):
        order = np.argsort(columns[0], kind="stable")
        for table, column in zip((length, variance, ratio), columns, strict=True):
            table[e, : order.size] = column[order]
    longest = np.max(length, initial=1.0, where=np.isfinite(length))
    edges = longest / _BUCKETS * np.arange(_BUCKETS)
    first = np.array([np.searchsorted(lengths, edges) for lengths in length])
    return Observations(position_m, covariance_m2, count, length, variance, ratio, first, _BUCKETS / longest)


def direct_ratio(loss_db: Array, config: AnchorSearchConfig) -> Array:
    """Likelihood ratios of losses beyond free space: a line of sight's against any path's."""
    std = config.los_loss_std_db
    density = np.exp(-0.5 * (loss_db / std) ** 2) / (np.sqrt(2.0 * np.pi) * std)
    return np.where(np.isfinite(loss_db), np.maximum(density * config.loss_range_db, _LEAST_LOSS_RATIO), 1.0)
