"""Newtonised orthogonal matching pursuit (NOMP) for paths.

After B. Mamandipoor, D. Ramasamy and U. Madhow, "Newtonized orthogonal matching pursuit:
frequency estimation over the continuum", IEEE Trans. Signal Processing 64 (2016), for the
separable atoms of :mod:`estimator.channel.atoms`: delays, and with an antenna array the direction's
components along its axes; with several snapshots, of which each path has the same delay and
direction and a gain of its own, all are used together. A channel's paths are found one by one:

1. *detect* the peak of the residual's correlation on an oversampled grid, by FFT;
2. *refine* this point by Newton steps on the residual;
3. *stop* unless it exceeds the threshold of a constant false-alarm rate
   (:mod:`estimator.channel.detection`) and the dynamic range pursued;
4. *cycle* through all paths with Newton steps, then *polish* all points jointly
   (:mod:`estimator.channel.refinement`).

Polishing is an addition to the published algorithm: two paths inside a resolution cell couple
so strongly that cycling alone leaves a residual, in which further paths would be detected.

Data enter only through correlations at the current points, which are interpolated between those of one FFT
(:mod:`estimator.channel.interpolation`), and paths interact through Dirichlet kernels: a cycle over K paths
costs of the order of K^2, not K times the number of tones. A channel with K paths takes K searches of the
grid, each of K times its points, and K^4 operations for the joint steps; memory is that of the grid. Channels
are independent of each other: a batch is a loop.

*Variance.* Each coordinate gets the Cramer-Rao bound of all found paths together, with
unknown gains, and two terms for what was not resolved, both from the level of the residual around
the path. Energy there acts on the path like noise of that level. And where it exceeds the noise, there
are more images than were told apart, some of them inside the path's own resolution cell: an
image of relative amplitude ``a`` and distance ``d`` (in cells) displaces the path by about
``a d`` and leaves a residual of relative amplitude ``e`` of about ``1.5 a d^2``. An excess ``e`` thus
tells of displacements of the order of ``sqrt(e)`` cells, which is what is claimed. Floors are added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.arrays import AntennaArray
from estimator.channel.atoms import atoms_of
from estimator.channel.checks import checked_channels, checked_noise
from estimator.channel.detection import delay_length, detection_threshold
from estimator.channel.directions import Directions, directions
from estimator.channel.interpolation import SpectrumPlan
from estimator.channel.pursuit import Pursuit, covariances, pursue
from estimator.channel.refinement import Channel, Refinement
from estimator.channel.search import PeakSearch
from estimator.channel.tail import DiffuseTail
from estimator.errors import ConfigurationError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["DelayEstimate", "NompConfig", "NompPlan", "estimate_delays", "estimate_paths"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class NompConfig:
    """Settings of NOMP.

    Parameters
    ----------
    false_alarm : float
        Probability that noise alone gives a path, per CFR over all delays.
    dynamic_range_db : float
        Paths weaker than the strongest by more are not reported.
    margin_db : float
        How much weaker paths are still estimated, so that they do not disturb those reported.
    max_paths : int
        Largest number of paths of a CFR, unreported ones included.
    closest_cells : float
        Of two paths closer than this (in resolution cells, 1 / bandwidth) the weaker is
        dropped. At high SNR paths are told apart far inside a cell; then their claimed
        variance grows with their closeness.
    floor_m : float
        Standard deviation added to every path length for what the model leaves out, metres.
    floor_rad : float
        The same for directions (their sines against the axes of an array), radians.
    oversampling : int
        Points of the detection grid per resolution cell.
    newton_steps : int
        Newton steps of a newly detected delay.
    cycles, polish_steps : int
        Rounds of cyclic refinement and joint steps after each detection.
    final_steps : int
        Largest number of joint steps at the end.
    """

    false_alarm: float = 0.01
    dynamic_range_db: float = 30.0
    margin_db: float = 6.0
    max_paths: int = 40
    closest_cells: float = 0.1
    floor_m: float = 0.03
    floor_rad: float = 0.002
    oversampling: int = 4
    newton_steps: int = 3
    cycles: int = 1
    polish_steps: int = 4
    final_steps: int = 20

    def __post_init__(self) -> None:
        if not 0.0 < self.false_alarm <= 0.5:
            raise ConfigurationError(f"false_alarm: expected a number in (0, 0.5], got {self.false_alarm}")
        for name in ("dynamic_range_db", "margin_db", "floor_m", "floor_rad"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ConfigurationError(f"{name}: expected 0 or a positive number, got {value}")
        if not 0.0 < self.closest_cells < np.inf:
            raise ConfigurationError(f"closest_cells: expected a positive number, got {self.closest_cells}")
        least_of = {"max_paths": 1, "oversampling": 2, "newton_steps": 1, "cycles": 1}
        for name, least in (*least_of.items(), ("polish_steps", 0), ("final_steps", 0)):
            if getattr(self, name) < least:
                raise ConfigurationError(f"{name}: expected at least {least}, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class DelayEstimate:
    """The paths of one channel, in ascending order of delay.

    Parameters
    ----------
    delay_s : ndarray, shape (n,)
        Delays in [0, 1 / tone spacing), seconds.
    gain : ndarray of complex128, shape (n,), or (S, n) with an axis of snapshots
        Complex gains at the array's phase centre, dimensionless.
    variance_s2 : ndarray, shape (n,)
        Variances of the delays, square seconds.
    directions : Directions or None
        Directions of arrival, in the array's frame, if the channels have an array.
    tail : DiffuseTail or None
        The diffuse tail, if it was estimated with the paths.
    """

    delay_s: Real
    gain: Complex
    variance_s2: Real
    directions: Directions | None = None
    tail: DiffuseTail | None = None

    def __len__(self) -> int:
        return int(self.delay_s.size)


class NompPlan:
    """NOMP prepared for one grid of tones and one array: see the head of this module.

    Parameters
    ----------
    grid : OfdmGrid
        The tones of the CFRs.
    config : NompConfig, optional
        Settings.
    array : AntennaArray, optional
        The antennas; by default a single one.
    """

    def __init__(
        self, grid: OfdmGrid, config: NompConfig | None = None, array: AntennaArray | None = None
    ) -> None:
        self.grid, self.array = grid, array
        self.config = NompConfig() if config is None else config
        shape, spacings = ((), ()) if array is None else (array.shape, array.spacings)
        if min(shape, default=2) < 2:
            raise ConfigurationError(f"array: expected at least 2 elements on each axis, got {shape}")
        self._atoms = atoms_of(grid.tones, shape)
        self._spectra = SpectrumPlan(grid.tones)
        self._limits = Refinement(self.config.closest_cells)
        self._search = PeakSearch(grid.tones, shape, spacings, self.config.oversampling)
        reach = [1.0, *(min(2.0 * spacing, 1.0) for spacing in spacings)]
        self._lengths = [delay_length(n, turns) for n, turns in zip((grid.tones, *shape), reach, strict=True)]
        self._scale = np.array([grid.tone_spacing_hz, *(-spacing for spacing in spacings)])  # turns per unit

    def threshold(self, snapshots: int = 1) -> float:
        """Level that the normalised correlation energy of a path exceeds."""
        return detection_threshold(self.config.false_alarm, *self._lengths, snapshots=snapshots)

    def estimate(self, cfr: ArrayLike, noise_variance: ArrayLike) -> list[DelayEstimate]:
        """Estimate the paths of a batch of channels.

        Parameters
        ----------
        cfr : array_like of complex, shape (C, [S,] [antennas,] tones)
            Channel frequency responses, dimensionless: of C channels in S snapshots (without the axis:
            one), at the plan's antennas (the axis is there if the plan has an array), in the
            order of ``array.steering``.
        noise_variance : array_like, scalar or shape (C,)
            Known variance of their noise per tone and antenna, positive.

        Returns
        -------
        list of DelayEstimate
            One per channel.

        Raises
        ------
        InputError
            If shapes do not fit, a CFR is not finite or a variance not positive.
        """
        single = () if self.array is None else (self.array.elements,)
        channels, snapshots = checked_channels(cfr, (*single, self.grid.tones))
        noise = checked_noise(noise_variance, len(channels))
        count = channels.shape[1] if snapshots else 1
        data = channels.reshape(len(channels), count, self._atoms.places.shape[0], self.grid.tones)
        return [self._one(*each, snapshots) for each in zip(data, noise, strict=True)]

    def _one(self, data: Complex, noise: float, snapshots: bool) -> DelayEstimate:
        """The paths of a channel (S, antennas, tones)."""
        config, count = self.config, len(data)
        settings = Pursuit(
            least_energy=self.threshold(count) * noise,
            range_ratio=10.0 ** (-(config.dynamic_range_db + config.margin_db) / 10.0),
            max_paths=config.max_paths,
            newton_steps=config.newton_steps,
            cycles=config.cycles,
            polish_steps=config.polish_steps,
            final_steps=config.final_steps,
        )
        work = np.empty((*data.shape[:2], 3), dtype=np.complex128)
        channel = Channel(self._atoms, self._spectra.of(data), work)
        points, gain = pursue(channel, self._search.grid, self._search.of(data), settings, self._limits)
        if len(points) == 0:
            return self._nothing(count, snapshots)
        return self._report(points, gain, covariances(channel, points, gain, noise), snapshots)

    def _report(self, points: Real, gain: Complex, claimed: Real, snapshots: bool) -> DelayEstimate:
        """Paths in the dynamic range, in ascending order of delay, points in the first turn."""
        axes = points.shape[1]
        floors = np.full(axes, self.config.floor_rad)
        floors[0] = self.config.floor_m / SPEED_OF_LIGHT_M_S
        covariance = claimed / np.outer(self._scale, self._scale) + floors**2 * np.eye(axes)
        turns = np.floor(points + np.array([0.0] + [0.5] * (axes - 1)))
        points = points - turns
        flips = np.sum(turns * (self._atoms.sizes % 2 == 0), axis=1)  # half-integer numbers: a turn is -1
        gain = gain * (1.0 - 2.0 * np.mod(flips, 2.0))
        power_db = 10.0 * np.log10(np.mean(np.abs(gain) ** 2, axis=0))
        chosen = np.flatnonzero(power_db >= power_db.max() - self.config.dynamic_range_db)
        chosen = chosen[np.argsort(points[chosen, 0], kind="stable")]
        value, spread = points[chosen] / self._scale, covariance[chosen]
        found = None
        if self.array is not None:
            found = directions(self.array, value[:, 1:], spread[:, 1:, 1:])
        own = gain[:, chosen] if snapshots else gain[0, chosen]
        return DelayEstimate(value[:, 0], own, spread[:, 0, 0], found)

    def _nothing(self, snapshots: int, with_axis: bool) -> DelayEstimate:
        """The estimate of a channel without paths."""
        none, shape = np.zeros(0), (snapshots, 0) if with_axis else (0,)
        found = None if self.array is None else Directions(none, none, none, none)
        return DelayEstimate(none, np.zeros(shape, dtype=np.complex128), none, found)


def estimate_delays(
    cfr: ArrayLike, noise_variance: ArrayLike, grid: OfdmGrid, config: NompConfig | None = None
) -> list[DelayEstimate]:
    """Estimate the paths of CFRs of single antennas in one call; :meth:`NompPlan.estimate` says the rest."""
    return NompPlan(grid, config).estimate(cfr, noise_variance)


def estimate_paths(
    cfr: ArrayLike,
    noise_variance: ArrayLike,
    grid: OfdmGrid,
    array: AntennaArray,
    config: NompConfig | None = None,
) -> list[DelayEstimate]:
    """Estimate delays and directions of paths in one call; :meth:`NompPlan.estimate` says the rest."""
    return NompPlan(grid, config, array).estimate(cfr, noise_variance)
