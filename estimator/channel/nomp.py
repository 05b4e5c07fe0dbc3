"""Newtonised orthogonal matching pursuit (NOMP) for path delays, batched over channels.

After B. Mamandipoor, D. Ramasamy and U. Madhow, "Newtonized orthogonal matching pursuit:
frequency estimation over the continuum", IEEE Trans. Signal Processing 64 (2016), for the
delays of :mod:`estimator.channel.model`. A channel's paths are found one by one:

1. *detect* the peak of the residual's correlation on an oversampled grid, by FFT;
2. *refine* this delay by Newton steps on the residual;
3. *stop* unless it exceeds the threshold of a constant false-alarm rate
   (:mod:`estimator.channel.detection`) and the dynamic range pursued;
4. *cycle* through all paths with Newton steps, then *polish* all delays jointly
   (:mod:`estimator.channel.refinement`).

Polishing is an addition to the published algorithm: two paths inside a resolution cell couple
so strongly that cycling alone leaves a residual, in which further paths would be detected.

Data enter only through correlations at the current delays, and paths interact through the
Dirichlet kernel, so that a cycle over K paths costs of the order of K^2, not K times
the number of tones. All channels of a batch advance together: in round k each channel still
in work has k paths.

*Variance.* Each delay gets the Cramer-Rao bound of all found paths together, with
unknown gains, and two terms for what was not resolved, both from the level of the residual around
the path. Energy there acts on the path like noise of that level. And where it exceeds the noise, there
are more images than were told apart, some of them inside the path's own resolution cell: an
image of relative amplitude ``a`` and distance ``d`` (in cells) displaces the path by about
``a d`` and leaves a residual of relative amplitude ``e`` of about ``1.5 a d^2``. An excess ``e`` thus
tells of displacements of the order of ``sqrt(e)`` cells, which is what is claimed. A floor is added.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from estimator.channel.bounds import joint_delay_variance
from estimator.channel.detection import delay_length, detection_threshold
from estimator.channel.model import ToneCorrelator
from estimator.channel.refinement import Fit, cycle, newton_step, polish, widely_spaced
from estimator.errors import ConfigurationError, InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["DelayEstimate", "NompConfig", "NompPlan", "estimate_delays"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NEIGHBOURHOOD_CELLS = np.array([-2.0, -1.0, 1.0, 2.0])  # where the residual's level is taken
_SIGNIFICANT_LEVEL = 3.0  # of the residual, over the noise: four standard deviations of its mean


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
    oversampling: int = 4
    newton_steps: int = 3
    cycles: int = 1
    polish_steps: int = 4
    final_steps: int = 20

    def __post_init__(self) -> None:
        if not 0.0 < self.false_alarm <= 0.5:
            raise ConfigurationError(f"false_alarm: expected a number in (0, 0.5], got {self.false_alarm}")
        for name in ("dynamic_range_db", "margin_db", "floor_m"):
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
    """The paths of one CFR, in ascending order of delay.

    Parameters
    ----------
    delay_s : ndarray, shape (n,)
        Delays in [0, 1 / tone spacing), seconds.
    gain : ndarray of complex128, shape (n,)
        Complex gains, dimensionless.
    variance_s2 : ndarray, shape (n,)
        Variances of the delays, square seconds.
    """

    delay_s: Real
    gain: Complex
    variance_s2: Real

    def __len__(self) -> int:
        return int(self.delay_s.size)


class NompPlan:
    """NOMP prepared for one grid of tones: see the head of this module.

    Parameters
    ----------
    grid : OfdmGrid
        The tones of the CFRs.
    config : NompConfig, optional
        Settings.
    """

    def __init__(self, grid: OfdmGrid, config: NompConfig | None = None) -> None:
        self.grid = grid
        self.config = NompConfig() if config is None else config
        self.threshold = detection_threshold(self.config.false_alarm, delay_length(grid.tones))
        self._correlator = ToneCorrelator(grid.tones)
        self._bins = scipy.fft.next_fast_len(self.config.oversampling * grid.tones)

    def estimate(self, cfr: ArrayLike, noise_variance: ArrayLike) -> list[DelayEstimate]:
        """Estimate the paths of a batch of CFRs.

        Batches of about 64 are fastest; larger ones fall out of the processor's caches.

        Parameters
        ----------
        cfr : array_like of complex, shape (C, tones)
            Channel frequency responses, dimensionless.
        noise_variance : array_like, scalar or shape (C,)
            Known variance of their noise per tone, positive.

        Returns
        -------
        list of DelayEstimate
            One per CFR.

        Raises
        ------
        InputError
            If shapes do not fit, a CFR is not finite or a variance not positive.
        """
        channels = np.asarray(cfr, dtype=np.complex128)
        if channels.ndim != 2 or channels.shape[1] != self.grid.tones:
            raise InputError(f"cfr: expected shape (n, {self.grid.tones}), got {channels.shape}")
        if not np.all(np.isfinite(channels)):
            row, tone = np.argwhere(~np.isfinite(channels))[0]
            value = channels[row, tone]
            raise InputError(f"cfr: expected finite numbers, got {value} in row {row}, tone {tone}")
        noise = np.asarray(noise_variance, dtype=np.float64)
        if noise.shape not in ((), channels.shape[:1]):
            raise InputError(
                f"noise_variance: expected a number or shape {channels.shape[:1]}, got {noise.shape}"
            )
        if not np.all((noise > 0.0) & np.isfinite(noise)):
            raise InputError(f"noise_variance: expected positive numbers, got {noise.min()}")
        found: dict[int, DelayEstimate] = {}
        for fit in self._pursue(channels, np.broadcast_to(noise, channels.shape[:1])):
            for same in self._without_duplicates(fit):
                polished = polish(self._correlator, same, self.config.final_steps, self.config.closest_cells)
                found.update(self._report(polished))
        nothing = DelayEstimate(np.zeros(0), np.zeros(0, dtype=np.complex128), np.zeros(0))
        return [found.get(i, nothing) for i in range(len(channels))]

    def _pursue(self, channels: Complex, noise: Real) -> Iterator[Fit]:
        """Find the paths of all channels, one more in each round; yield those that are done."""
        tones, config = self.grid.tones, self.config
        range_ratio = 10.0 ** (-(config.dynamic_range_db + config.margin_db) / 10.0)
        none = np.zeros((len(channels), 0))
        blocks = self._correlator.split(channels)
        fit = Fit(np.arange(len(channels)), channels, blocks, noise, none, none.astype(np.complex128))
        for number in range(config.max_paths):
            turns, gain = self._detect(fit)
            strongest = np.max(np.abs(fit.gain) ** 2, axis=1, initial=0.0)
            power = np.abs(gain) ** 2
            more = (power * tones > self.threshold * fit.noise_variance) & (power > strongest * range_ratio)
            if number > 0 and not np.all(more):
                yield fit.take(~more)
            if not np.any(more):
                return
            fit = fit.take(
                more,
                np.column_stack([fit.turns, turns])[more],
                np.column_stack([fit.gain, gain])[more],
            )
            fit = cycle(self._correlator, fit, config.cycles)
            fit = polish(self._correlator, fit, config.polish_steps, config.closest_cells)
        yield fit

    def _detect(self, fit: Fit) -> tuple[Real, Complex]:
        """The strongest delay in each residual and its gain, each of shape (C,)."""
        residual = fit.residual(self._correlator)
        spectrum = scipy.fft.ifft(residual, self._bins, axis=1)  # |z| at turns i / bins, scaled
        peak = np.argmax(spectrum.real**2 + spectrum.imag**2, axis=1)
        turns = peak[:, None] / self._bins
        blocks = self._correlator.split(residual)
        for _ in range(self.config.newton_steps):
            turns = turns + newton_step(*self._correlator.correlate(blocks, turns), self.grid.tones)
        z = self._correlator.correlate(blocks, turns)[0]
        return turns[:, 0], z[:, 0] / self.grid.tones

    def _without_duplicates(self, fit: Fit) -> Iterator[Fit]:
        """Drop paths too close to stronger ones; channels come grouped by what is left."""
        kept = widely_spaced(fit.turns, fit.gain, self.grid.tones, self.config.closest_cells)
        count = np.sum(kept, axis=1)
        for number in np.unique(count):
            rows = count == number
            mask = kept[rows]
            yield fit.take(
                rows,
                fit.turns[rows][mask].reshape(-1, number),
                fit.gain[rows][mask].reshape(-1, number),
            )

    def _variance(self, fit: Fit) -> Real:
        """Variances of all delays of a batch, shape (C, K), square seconds."""
        delay = fit.turns / self.grid.tone_spacing_hz
        bound = joint_delay_variance(self.grid, delay, fit.gain, fit.noise_variance)
        around = fit.turns[:, :, None] + _NEIGHBOURHOOD_CELLS / self.grid.tones
        blocks = self._correlator.split(fit.residual(self._correlator))
        z = self._correlator.correlate(blocks, around.reshape(len(around), -1))[0]
        noise = fit.noise_variance[:, None]
        level = np.mean(np.abs(z.reshape(around.shape)) ** 2, axis=2) / self.grid.tones
        excess = np.maximum(0.0, level - _SIGNIFICANT_LEVEL * noise) / self.grid.tones
        unresolved = np.sqrt(excess) / np.abs(fit.gain) * self.grid.resolution_s**2
        floor = (self.config.floor_m / SPEED_OF_LIGHT_M_S) ** 2
        return np.asarray(bound * np.maximum(1.0, level / noise) + unresolved + floor)

    def _report(self, fit: Fit) -> Iterator[tuple[int, DelayEstimate]]:
        """Estimates by channel: paths in the dynamic range, sorted, delays in the first turn."""
        variance = self._variance(fit)
        turns = fit.turns - np.floor(fit.turns)
        gain = fit.gain
        if self.grid.tones % 2 == 0:  # half-integer tone numbers: atoms change sign from turn to turn
            gain = gain * (1.0 - 2.0 * np.mod(np.floor(fit.turns), 2.0))
        power_db = 20.0 * np.log10(np.abs(gain))
        reported = power_db >= np.max(power_db, axis=1, keepdims=True) - self.config.dynamic_range_db
        for row, index in enumerate(fit.index):
            chosen = np.flatnonzero(reported[row])
            chosen = chosen[np.argsort(turns[row, chosen], kind="stable")]
            delay = turns[row, chosen] / self.grid.tone_spacing_hz
            yield int(index), DelayEstimate(delay, gain[row, chosen], variance[row, chosen])


def estimate_delays(
    cfr: ArrayLike, noise_variance: ArrayLike, grid: OfdmGrid, config: NompConfig | None = None
) -> list[DelayEstimate]:
    """Estimate the paths of CFRs in one call; :meth:`NompPlan.estimate` says the rest."""
    return NompPlan(grid, config).estimate(cfr, noise_variance)
