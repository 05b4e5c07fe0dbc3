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
        return ClockModel(walk**2, bool(self.clock_bias_common), self.clock_free_std_m**2)

    @property
    def constant(self) -> bool:
        """Whether biases do not change, and lengths are to scale."""
        return self.clock_walk_ppm == 0.0 and self.clock_free_std_m == 0.0 and self.range_scale_std == 0.0


class ClockModel(NamedTuple):
    """How biases change: variance of the walk in a second, whether it is common, variance of a free bias."""

    walk_m2_s: float
    common: bool
    free_m2: float


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
def predict_clocks(layout: Layout, covariance: Array, step_s: float, clocks: ClockModel) -> None:
    """Widen the biases of a Gaussian by what they may change in a step, in place."""
    walk = clocks.walk_m2_s * step_s
    together = clocks.free_m2 + (walk if clocks.common else 0.0)
    apart = 0.0 if clocks.common else walk
    if together + apart == 0.0:
        return
    first = FIRST_ANCHOR + 3
    for k in range(layout.anchors):
        b = first + PER_ANCHOR * k
        covariance[b, b] += apart
        for other in range(layout.anchors):
            covariance[b, first + PER_ANCHOR * other] += together
