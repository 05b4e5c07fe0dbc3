"""Walls from the ranges of single beams: active sensing as the paper does it, for real beams.

Each beam's response is taken alone: its strongest return gives one range, (8), and the
ranges of all beams are segmented into walls. This is the processing for echoes that
follow the radar equation (7), where every beam hears the wall it looks at; where
a wall flashes at normal incidence, :mod:`estimator.sensing.flash` knows far more.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import BeamSet
from estimator.channel.nomp import DelayEstimate, NompConfig, NompPlan
from estimator.errors import ConfigurationError
from estimator.measurements import GaussianVrp
from estimator.sensing.linefit import BeamFan
from estimator.sensing.segmentation import SegmentationConfig, segment_walls
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["BeamRangeConfig", "beam_ranges", "walls_of_beams"]


@dataclass(frozen=True)
class BeamRangeConfig:
    """Settings of the ranges of single beams.

    Parameters
    ----------
    range_std_m, range_std_share : float
        Standard deviation claimed of a range on top of the bound, metres, and as a share of
        the range: a wide beam that meets a wall at a slant returns a spread that grows
        with the range, of which one range is a summary.
    nearest_m : float
        Returns from nearer are not walls but the transmitter's leakage, metres.
    nomp : NompConfig
        Settings of the delay estimation.
    segmentation : SegmentationConfig
        Settings of the segmentation into walls.
    """

    range_std_m: float = 0.2
    range_std_share: float = 0.02
    nearest_m: float = 0.5
    nomp: NompConfig = field(default_factory=lambda: NompConfig(dynamic_range_db=12.0, max_paths=12))
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)

    def __post_init__(self) -> None:
        for name in ("range_std_m", "range_std_share", "nearest_m"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")


def beam_ranges(
    echo: NDArray[np.complex128], noise_variance: float, grid: OfdmGrid, config: BeamRangeConfig | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """The range of the strongest return of every beam that has one.

    Parameters
    ----------
    echo : ndarray of complex128, shape (B, N)
        Two-way responses of the beams on the tones.
    noise_variance : float
        Noise variance of an entry.
    grid : OfdmGrid
        The tones.
    config : BeamRangeConfig, optional
        Settings.

    Returns
    -------
    range_m, std_m : ndarray, shape (M,)
        One-way ranges and their standard deviations, metres.
    beam : ndarray of int64, shape (M,)
        The beams they belong to, ascending.
    """
    config = config or BeamRangeConfig()
    estimates = NompPlan(grid, config.nomp).estimate(echo, noise_variance)
    nearest_s = 2.0 * config.nearest_m / SPEED_OF_LIGHT_M_S
    heard = [(b, found, found.delay_s > nearest_s) for b, found in enumerate(estimates)]
    rows = [(b, *_strongest(found, far, config)) for b, found, far in heard if far.any()]
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return table[:, 1], table[:, 2], table[:, 0].astype(np.int64)


def _strongest(found: DelayEstimate, far: NDArray[np.bool_], config: BeamRangeConfig) -> tuple[float, float]:
    """Range and standard deviation of the strongest return of those that are no leakage."""
    best = int(np.argmax(np.where(far, np.abs(found.gain), 0.0)))
    half = 0.5 * SPEED_OF_LIGHT_M_S
    distance = half * float(found.delay_s[best])
    bound = half * float(np.sqrt(found.variance_s2[best]))
    return distance, float(np.hypot(bound, np.hypot(config.range_std_m, config.range_std_share * distance)))


def walls_of_beams(
    echo: NDArray[np.complex128],
    noise_variance: float,
    grid: OfdmGrid,
    beams: BeamSet,
    config: BeamRangeConfig | None = None,
) -> tuple[GaussianVrp, ...]:
    """Walls from a beam sweep, nearest first.

    Parameters
    ----------
    echo, noise_variance, grid, config
        As for :func:`beam_ranges`.
    beams : BeamSet
        The beams.

    Returns
    -------
    tuple of GaussianVrp
        In the agent's frame, the agent at its origin.
    """
    config = config or BeamRangeConfig()
    distance, std, beam = beam_ranges(echo, noise_variance, grid, config)
    if len(distance) < config.segmentation.least_points:
        return ()
    fan = BeamFan.of(beams).take(beam)
    return segment_walls(distance, std, beams.azimuths()[beam], config.segmentation, fan).walls
