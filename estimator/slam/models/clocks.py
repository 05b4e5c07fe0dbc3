"""Clocks and ranging hardware: biases and scales of path lengths, their prior and how they change.

The path length of an anchor is ``(1 + s) d + b``: ``b`` its clock bias and antenna delay, ``s`` its range
scale. A bias is constant, walks at random, or is new in every epoch, as where a receiver takes time
differences of arrival (TDOA, RSTD): what all anchors' lengths have in common then tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.settings import Settings, not_negative
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = ["ClockModel", "Clocks", "clock_prior", "predict_clocks"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Clocks(Settings):
    """What is unknown of clocks and ranging hardware.

    Parameters
    ----------
    clock_bias_std_m : float
        Standard deviation of the anchors' unknown clock bias (antenna delays included) as a path length,
        metres; 0 if the clocks agree.
    clock_bias_common : bool
        Whether all anchors have the same bias, and the same random walk of it.
    clock_walk_ppm : float
        How much the biases walk at random in a second, millionths of a second; 0 if they are constant.
    clock_free_std_m : float
        Standard deviation of a bias common to all anchors that is new in every epoch, metres; 0 if there
        is none.
    range_scale_std : float
        Standard deviation of the unknown scale of path lengths, a share of 1; 0 if they are to scale.
    range_scale_apart : float
        Share of that standard deviation by which anchors differ: devices of one make are out of scale alike.
    """

    clock_bias_std_m: float = not_negative(0.0)
    clock_bias_common: bool = not_negative(False)
    clock_walk_ppm: float = not_negative(0.0)
    clock_free_std_m: float = not_negative(0.0)
    range_scale_std: float = not_negative(0.0)
    range_scale_apart: float = not_negative(0.1)

    @property
    def model(self) -> ClockModel:
        """How biases change, as compiled functions take it."""
        walk = self.clock_walk_ppm * 1e-6 * SPEED_OF_LIGHT_M_S
        constant, free = self.clock_bias_std_m**2, self.clock_free_std_m**2
        if self.clock_bias_common and free > 0.0:
            constant, free = 0.0, constant + free
        return ClockModel(walk**2, bool(self.clock_bias_common), free, constant)

    @property
    def constant(self) -> bool:
        """Whether biases do not change, and lengths are to scale."""
        return self.clock_walk_ppm == 0.0 and self.clock_free_std_m == 0.0 and self.range_scale_std == 0.0


class ClockModel(NamedTuple):
    """How biases change.

    Parameters
    ----------
    walk_m2_s : float
        Variance of their walk in a second, square metres.
    common : bool
        Whether all walk together.
    free_m2 : float
        Variance of what is common to all and new in every epoch, square metres; 0 if nothing is.
    constant_m2 : float
        Variance beforehand of what is each anchor's own and stays, square metres.
    """

    walk_m2_s: float
    common: bool
    free_m2: float
    constant_m2: float


def clock_prior(covariance: Array, layout: Layout, clocks: Clocks) -> None:
    """Set the prior of biases and scales in a covariance (n, n), in place."""
    everyone = np.ones((layout.anchors, layout.anchors))
    bias = [layout.bias(k) for k in range(layout.anchors)]
    together = everyone if clocks.clock_bias_common else np.eye(layout.anchors)
    covariance[np.ix_(bias, bias)] = (
        clocks.clock_bias_std_m**2 * together + clocks.clock_free_std_m**2 * everyone
    )
    scale = [layout.scale(k) for k in range(layout.anchors)]
    apart = min(clocks.range_scale_apart, 1.0) ** 2
    together = (1.0 - apart) * everyone + apart * np.eye(layout.anchors)
    covariance[np.ix_(scale, scale)] = clocks.range_scale_std**2 * together


@compiled
def predict_clocks(layout: Layout, mean: Array, covariance: Array, step_s: float, clocks: ClockModel) -> None:
    """Change the biases of a Gaussian, in place: walk, and forget what is new in every epoch.

    Of biases ``b = c + f`` the free part f goes and another comes: of c, constant and each anchor's own,
    what is left is its expectation given b. How biases differ stays known.
    """
    walk = clocks.walk_m2_s * step_s
    together, apart = (walk, 0.0) if clocks.common else (0.0, walk)
    first, count = FIRST_ANCHOR + 3, layout.anchors
    if clocks.free_m2 > 0.0:
        share = clocks.free_m2 / (clocks.constant_m2 + count * clocks.free_m2)
        mean[first : first + PER_ANCHOR * count : PER_ANCHOR] -= (
            share * mean[first : first + PER_ANCHOR * count : PER_ANCHOR].sum()
        )
        _less_common(covariance, first, count, share)
        together += clocks.free_m2 + share * clocks.constant_m2
    if together + apart == 0.0:
        return
    for k in range(count):
        b = first + PER_ANCHOR * k
        covariance[b, b] += apart
        for other in range(count):
            covariance[b, first + PER_ANCHOR * other] += together


@compiled
def _less_common(covariance: Array, first: int, count: int, share: float) -> None:
    """Take a share of the biases' sum off each of them: the covariance, in place and symmetric to the bit."""
    n = covariance.shape[0]
    total = np.zeros(n)
    for k in range(count):
        total += covariance[first + PER_ANCHOR * k]
    whole = 0.0
    for k in range(count):
        whole += total[first + PER_ANCHOR * k]
    is_bias = np.zeros(n)
    is_bias[first : first + PER_ANCHOR * count : PER_ANCHOR] = share
    for i in range(n):
        for j in range(n):
            if is_bias[i] > 0.0 or is_bias[j] > 0.0:
                covariance[i, j] += is_bias[i] * is_bias[j] * whole - (
                    is_bias[i] * total[j] + is_bias[j] * total[i]
                )
