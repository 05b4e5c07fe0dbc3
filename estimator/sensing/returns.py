"""Point returns in one sweep of beams: range, azimuth and gain, jointly over all beams.

:class:`EchoPursuit` pursues the returns of :mod:`estimator.sensing.echo_model` as
:mod:`estimator.channel.nomp` pursues paths: the strongest first, all refined jointly. A candidate
must be *plausible* as a wall: its gain is compared with the one of a perfect mirror at its
range, ``lambda / (4 pi 2 r)``; the ratio is the return's *reflectivity*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from estimator.arrays import BeamSet
from estimator.channel.detection import delay_length, detection_threshold
from estimator.errors import ConfigurationError, InputError
from estimator.sensing.echo_model import EchoFit, EchoModel
from estimator.waveform import OfdmGrid

__all__ = ["EchoPursuit", "PursuitConfig", "ReturnSet", "echo_pursuit"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_AZIMUTHS_PER_BEAM = 4
_RICHEST_DELAYS = 64  # searched first: where a return is strong, all others have less energy than it
_RESOLVED = 1e-12  # of the power of a sweep: what single precision still tells apart, 120 dB
_STEP_LIMIT_CELLS = 0.25
_CONVERGED_CELLS = 1e-4
_RAISED = 1.5  # a beam's noise counts as raised above this multiple of the noise stated: four deviations


@dataclass(frozen=True)
class PursuitConfig:
    """Settings of the pursuit.

    Parameters
    ----------
    false_alarm : float
        Probability that noise alone gives a return, per sweep.
    blind_range_m : float
        What is nearer is removed from the data, metres; 0 keeps everything. The transmitter's leakage
        has to lie within: by default, delays up to 1 ns and a front-end error of 0.05 m.
    max_range_m : float
        Returns are searched up to here, or to where ranges become ambiguous, metres.
    min_reflectivity_db : float
        Weaker returns (against a perfect mirror at their range) are not pursued, dB.
    max_returns : int
        Largest number of returns.
    oversampling : int
        Points of the detection grid per resolution cell of the delay.
    steps, final_steps : int
        Joint refinement steps after each detection and at the end.
    """

    false_alarm: float = 0.01
    blind_range_m: float = 0.2
    max_range_m: float = 150.0
    min_reflectivity_db: float = -26.0
    max_returns: int = 24
    oversampling: int = 4
    steps: int = 5
    final_steps: int = 20

    def __post_init__(self) -> None:
        if not 0.0 < self.false_alarm <= 0.5:
            raise ConfigurationError(f"false_alarm: expected a number in (0, 0.5], got {self.false_alarm}")
        if not 0.0 <= self.blind_range_m < self.max_range_m < np.inf:
            raise ConfigurationError(
                "blind_range_m, max_range_m: expected 0 <= blind < max, "
                f"got {self.blind_range_m} and {self.max_range_m}"
            )
        if not np.isfinite(self.min_reflectivity_db):
            raise ConfigurationError(
                f"min_reflectivity_db: expected a finite number, got {self.min_reflectivity_db}"
            )
        for name, least in (("max_returns", 1), ("oversampling", 2), ("steps", 0), ("final_steps", 0)):
            if getattr(self, name) < least:
                raise ConfigurationError(f"{name}: expected at least {least}, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class ReturnSet:
    """Returns of one sweep, the strongest first.

    Parameters
    ----------
    range_m : ndarray, shape (n,)
        One-way ranges, metres.
    azimuth_rad : ndarray, shape (n,)
        Azimuths in (-pi, pi], in the frame of the beams, radians.
    gain : ndarray of complex128, shape (n,)
        Gains between isotropic antennas, dimensionless.
    reflectivity_db : ndarray, shape (n,)
        Gains against those of a perfect mirror at the same range, dB.
    power_db : ndarray, shape (n,)
        Received over transmitted power, summed over beams, dB.
    covariance : ndarray, shape (n, 2, 2)
        Cramer-Rao bound of (range, azimuth) of all returns together, m^2, m rad, rad^2; what is
        left of the data counts as noise.
    """

    range_m: Real
    azimuth_rad: Real
    gain: Complex
    reflectivity_db: Real
    power_db: Real
    covariance: Real

    def __len__(self) -> int:
        return int(self.range_m.size)


class EchoPursuit:
    """Pursuit of returns prepared for one grid of tones and one set of beams.

    Parameters
    ----------
    grid : OfdmGrid
        Tones of the echo.
    beams : BeamSet
        The beams, in the order of the sweep.
    config : PursuitConfig, optional
        Settings.

    Raises
    ------
    ConfigurationError
        If the blind range covers all ranges that these tones can tell.
    """

    def __init__(self, grid: OfdmGrid, beams: BeamSet, config: PursuitConfig | None = None) -> None:
        self.grid, self.beams = grid, beams
        self.config = PursuitConfig() if config is None else config
        self._model = EchoModel(grid, beams, self.config.blind_range_m)
        turns_per_m = self._model.turns_per_m
        self.range_cell_m = 1.0 / (grid.tones * turns_per_m)
        self.azimuth_cell_rad = min(1.0 / (beams.elements * beams.spacing_wavelengths), 1.0)

        count = _AZIMUTHS_PER_BEAM * beams.beams
        self._azimuths = 2.0 * np.pi * np.arange(count) / count - np.pi
        response, slope = self._model.beam_response(self._azimuths)
        self._responses = response
        norm = np.linalg.norm(response, axis=1)
        patterns = response / norm[:, None]
        along = np.sum(patterns.conj() * slope, axis=1, keepdims=True) * patterns
        directions = 2.0 * np.pi * np.mean(np.linalg.norm(slope - along, axis=1) / norm)

        self._bins = scipy.fft.next_fast_len(self.config.oversampling * grid.tones)
        first = int(np.ceil(self.config.blind_range_m * turns_per_m * self._bins)) + 1
        last = int(min(self.config.max_range_m * turns_per_m, 1.0 - 2.0 / grid.tones) * self._bins)
        if first > last:
            raise ConfigurationError(
                f"blind_range_m: expected less than the longest range of the tones, "
                f"{last / (self._bins * turns_per_m):.2f} m, got {self.config.blind_range_m}"
            )
        self._window = slice(first, last + 1)
        self._delays = np.arange(first, last + 1) / self._bins
        lengths = delay_length(grid.tones, float(np.ptp(self._delays))), float(directions)
        self.threshold = detection_threshold(self.config.false_alarm, *lengths)
        # Of a plausible return: its gain is at least the mirror's times the reflectivity.
        mirror = grid.wavelength_m / (8.0 * np.pi * self._delays / turns_per_m)
        self._least = mirror * 10.0 ** (self.config.min_reflectivity_db / 20.0) * grid.tones

    def find(self, echo: Complex, noise_variance: float) -> ReturnSet:
        """Find the returns of one sweep.

        Parameters
        ----------
        echo : ndarray of complex, shape (beams, tones)
            Response of every beam, sending and receiving.
        noise_variance : float
            Variance of its noise per tone, positive.

        Returns
        -------
        ReturnSet

        Raises
        ------
        InputError
            If shapes do not fit, the echo is not finite or the variance not positive.
        """
        data = np.asarray(echo, dtype=np.complex128)
        if data.shape != (self.beams.beams, self.grid.tones):
            expected = (self.beams.beams, self.grid.tones)
            raise InputError(f"echo: expected shape {expected}, got {data.shape}")
        if not np.all(np.isfinite(data)):
            raise InputError(f"echo: expected finite numbers, got {data[~np.isfinite(data)][0]}")
        if not 0.0 < noise_variance < np.inf:
            raise InputError(f"noise_variance: expected a positive number, got {noise_variance}")
        data = self._model.blank(data)
        weights = self._whitening(data, noise_variance)
        data, model = weights[:, None] * data, self._model.weighted(weights)
        unit = float(np.sqrt(max(noise_variance, _RESOLVED * float(np.vdot(data, data).real) / data.size)))
        least_power = self.threshold * self.grid.tones * noise_variance / unit**2
        search = _Search(self._responses * weights, self._least / unit, least_power)
        fit = EchoFit.empty()
        left = received = self._spectrum(data / unit)
        for _ in range(self.config.max_returns):
            peak = self._detect(search, left, fit)
            if peak is None:
                break
            start = np.append(fit.turns, peak[0]), np.append(fit.azimuth, peak[1])
            fit = self._polish(model, data, model.project(data, *start), self.config.steps)
            patterns, tones = model.factors(fit)
            left = received - patterns.astype(np.complex64) @ self._spectrum(tones / unit)
        residual = data
        if len(fit.turns):
            fit = self._polish(model, data, fit, self.config.final_steps)
            residual = data - model.synthesise(fit)
        return self._returns(
            fit, max(noise_variance, float(np.vdot(residual, residual).real) / residual.size)
        )

    def _spectrum(self, data: Complex) -> NDArray[np.complex64]:
        """Data (n, tones) over the delays searched, in single precision: it chooses what is then refined."""
        spectrum = scipy.fft.ifft(
            data.astype(np.complex64), self._bins, axis=1, norm="forward", overwrite_x=True
        )
        return np.asarray(spectrum[:, self._window])

    def _whitening(self, data: Complex, noise_variance: float) -> Real:
        """Weights of the beams that make the noise of all as stated: phase noise of the leakage raises it.

        A beam's noise is the median over all delays, of which returns fill a small part (the window
        keeps their sidelobes there), of what is exponentially distributed for noise.
        """
        window = np.hanning(self.grid.tones + 2)[1:-1]
        spectrum = scipy.fft.ifft(data * window, axis=1, norm="ortho")
        floor = np.median(np.abs(spectrum) ** 2, axis=1) / np.mean(window**2) / np.log(2.0)
        raised = np.where(floor > _RAISED * noise_variance, floor, noise_variance)
        return np.asarray(np.sqrt(noise_variance / raised))

    def _detect(
        self, search: _Search, window: NDArray[np.complex64], fit: EchoFit
    ) -> tuple[float, float] | None:
        """Delay and azimuth of the strongest plausible return away from those found, or None.

        ``window`` is the spectrum of what no return found explains, (beams, delays).
        """
        energy = _power(window).sum(axis=0)
        # No azimuth has more than a delay's energy: the richest delays first, then those that may still win.
        enough = energy >= search.least_energy
        first = np.zeros(len(energy), dtype=bool)
        first[np.argsort(-energy, kind="stable")[:_RICHEST_DELAYS]] = True
        best = 0.0
        place: tuple[float, float] | None = None
        for chosen in (first, ~first):
            delays = np.flatnonzero(chosen & enough & (energy > best))
            power = search.power(window, delays)
            for turns, azimuth in zip(fit.turns, fit.azimuth, strict=True):
                near = np.abs(self._delays[delays] - turns) * self.grid.tones < 1.0
                beside = np.abs(_wrap(self._azimuths - azimuth)) < self.azimuth_cell_rad
                power[np.ix_(beside, near)] = 0.0
            if power.size and power.max() > best:
                azimuth_bin, column = np.unravel_index(np.argmax(power), power.shape)
                best = float(power[azimuth_bin, column])
                place = float(self._delays[delays[column]]), float(self._azimuths[azimuth_bin])
        return place

    def _polish(self, model: EchoModel, data: Complex, fit: EchoFit, steps: int) -> EchoFit:
        """Joint Fisher scoring with Levenberg-Marquardt damping; cells bound the steps and the closeness."""
        count = len(fit.turns)
        cells = np.repeat([1.0 / self.grid.tones, self.azimuth_cell_rad], count)
        limit, damping = _STEP_LIMIT_CELLS * cells, 1e-3
        for _ in range(steps):
            diagonal = damping * np.abs(np.diag(fit.information))
            step = np.clip(np.linalg.solve(fit.information + np.diag(diagonal), fit.gradient), -limit, limit)
            turns, azimuth = fit.turns + step[:count], fit.azimuth + step[count:]
            trial = model.project(data, turns, azimuth) if self._apart(turns, azimuth) else None
            if trial is not None and trial.energy >= fit.energy:
                fit, damping = trial, max(0.2 * damping, 1e-9)
            else:
                damping = min(10.0 * damping, 1e6)
            if np.all(np.abs(step) < _CONVERGED_CELLS * cells):
                break
        return fit

    def _apart(self, turns: Real, azimuth: Real) -> bool:
        """Whether no two returns have come closer than half a cell in both delay and azimuth."""
        delays = np.abs(turns[:, None] - turns) * self.grid.tones
        azimuths = np.abs(_wrap(azimuth[:, None] - azimuth)) / self.azimuth_cell_rad
        close = np.maximum(delays, azimuths) < 0.5
        return not np.any(close & ~np.eye(len(turns), dtype=bool))

    def _returns(self, fit: EchoFit, noise_variance: float) -> ReturnSet:
        count = len(fit.turns)
        scale = np.repeat([1.0 / self._model.turns_per_m, 1.0], count)
        bound = 0.5 * noise_variance * np.linalg.inv(fit.information) * scale * scale[:, None]
        own = np.arange(count)[:, None] + np.array([0, count])
        distance = fit.turns / self._model.turns_per_m
        amplitude = np.abs(fit.gain)
        norm = np.linalg.norm(self.beams.two_way(fit.azimuth), axis=-1)
        found = ReturnSet(
            distance,
            _wrap(fit.azimuth),
            fit.gain,
            20.0 * np.log10(amplitude * 8.0 * np.pi * distance / self.grid.wavelength_m),
            20.0 * np.log10(amplitude * norm),
            bound[own[:, :, None], own[:, None, :]],
        )
        order = np.argsort(-found.power_db, kind="stable")
        return replace(found, **{name: getattr(found, name)[order] for name in found.__dataclass_fields__})


class _Search:
    """Beam patterns of the azimuths searched, of unit norm, and what a return is at least, once a sweep."""

    def __init__(self, response: Complex, least_gain: Real, least_power: float) -> None:
        norm = np.linalg.norm(response, axis=1)
        self._matched = (response / norm[:, None]).conj().astype(np.complex64)
        # Least |z|^2 of a plausible return: its gain is at least the mirror's times the reflectivity.
        self._squared_norm = np.square(norm / norm.max()).astype(np.float32)
        self._squared_gain = np.square(norm.max() * least_gain).astype(np.float32)
        self._least_power = np.float32(least_power)
        self.least_energy = np.maximum(self._squared_norm.min() * self._squared_gain, self._least_power)

    def power(self, spectrum: NDArray[np.complex64], delays: NDArray[np.intp]) -> NDArray[np.float32]:
        """``|z|^2`` of each azimuth and the delays given, shape (azimuths, n); 0 if no return's."""
        power = _power(self._matched @ spectrum[:, delays])
        power *= power >= self._least_power
        power *= power >= self._squared_norm[:, None] * self._squared_gain[delays]
        return power


@lru_cache(maxsize=8)
def echo_pursuit(grid: OfdmGrid, beams: BeamSet, config: PursuitConfig) -> EchoPursuit:
    """The pursuit of this grid, beams and settings, prepared once for all sweeps of a run."""
    return EchoPursuit(grid, beams, config)


def _power(value: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Squared magnitudes."""
    power = np.square(value.real)
    power += np.square(value.imag)
    return power


def _wrap(angle_rad: Real) -> Real:
    """Angles in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angle_rad, 2.0 * np.pi))
