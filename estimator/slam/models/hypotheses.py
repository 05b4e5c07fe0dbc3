"""Hypotheses: joint Gaussians of agent, anchors and walls, each with a log weight."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Hypotheses", "log_sum_exp", "moments", "normalised_weights"]

Array = NDArray[np.float64]


class Hypotheses(NamedTuple):
    """A Gaussian mixture; compiled functions take it as it is.

    Shapes: R hypotheses, K anchors, L wall slots, F features per anchor, n the length of
    the state vector (:class:`estimator.slam.models.state_vector.Layout`).

    Parameters
    ----------
    log_weight : ndarray, shape (R,)
        Log weights; normalised between epochs, the likeliest hypothesis first.
    mean : ndarray, shape (R, n)
        Means, metres in the gauge frame.
    covariance : ndarray, shape (R, n, n)
        Covariances.
    located : ndarray of bool, shape (R, K)
        Anchors that have been located.
    present : ndarray of bool, shape (R, L)
        Walls that the hypothesis has.
    visibility : ndarray, shape (R, K, F)
        Probability that a feature can be heard at present.
    support : ndarray of int64, shape (R, L)
        Epochs in which each wall was detected since it entered.
    """

    log_weight: Array
    mean: Array
    covariance: Array
    located: NDArray[np.bool_]
    present: NDArray[np.bool_]
    visibility: Array
    support: NDArray[np.int64]

    @property
    def number(self) -> int:
        """Number of hypotheses R."""
        return len(self.log_weight)

    @property
    def best(self) -> int:
        """Index of the likeliest hypothesis."""
        return int(np.argmax(self.log_weight))

    def take(self, index: NDArray[np.int64] | list[int]) -> Hypotheses:
        """Copies of the hypotheses at ``index``, in that order."""
        return Hypotheses(
            self.log_weight[index],
            self.mean[index],
            self.covariance[index],
            self.located[index],
            self.present[index],
            self.visibility[index],
            self.support[index],
        )

    def joined(self, other: Hypotheses) -> Hypotheses:
        """These hypotheses and then those of ``other``."""
        return Hypotheses(
            np.concatenate([self.log_weight, other.log_weight]),
            np.concatenate([self.mean, other.mean]),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.located, other.located]),
            np.concatenate([self.present, other.present]),
            np.concatenate([self.visibility, other.visibility]),
            np.concatenate([self.support, other.support]),
        )

    def keep(self, mask: NDArray[np.bool_]) -> Hypotheses:
        """The marked hypotheses, weights normalised."""
        kept = self.take(np.flatnonzero(mask))
        kept.log_weight[...] -= log_sum_exp(kept.log_weight)
        return kept


def log_sum_exp(values: Array) -> float:
    """``log(sum(exp(values)))`` of a vector, without overflow; SciPy's takes ten times as long on a few."""
    largest = float(values.max())
    return largest + float(np.log(np.exp(values - largest).sum()))


def normalised_weights(log_weight: Array) -> Array:
    """Weights that sum to one, of their logs."""
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def moments(weight: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of a Gaussian mixture with weights (R,) that sum to one."""
    centre = weight @ mean
    offset = mean - centre
    return centre, np.tensordot(weight, covariance, 1) + (weight * offset.T) @ offset
