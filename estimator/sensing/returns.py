"""Point returns in one sweep of beams: range, azimuth and gain, jointly over all beams.

A return from range ``r`` and azimuth ``phi``, leaving and arriving in the same direction, gives
beam ``b`` on tone ``n`` the response ``g w_b(phi) exp(-j 2 pi n' x)``: ``w`` the two-way response of
the beams (:meth:`estimator.arrays.BeamSet.two_way`) and ``x`` the delay ``2 r / c`` in turns. The atom is
the product of a beam pattern and a delay atom, so that inner products of atoms are
products of small matrices and Dirichlet kernels. :class:`EchoPursuit` pursues returns as
:mod:`estimator.channel.nomp` pursues paths: the strongest first, all refined jointly.

Two things keep the pursuit to what may be a wall. What arrives from within the *blind range*
(the device itself, floor and ceiling underneath and above) is projected out of the data first.
And a candidate must be *plausible*: its gain is compared with the one of a perfect mirror
at its range, ``lambda / (4 pi 2 r)``; the ratio is the return's *reflectivity*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from estimator.arrays import BeamSet
from estimator.channel.detection import delay_length, detection_threshold
from estimator.channel.model import ToneCorrelator, dirichlet
from estimator.errors import ConfigurationError, InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["EchoPursuit", "PursuitConfig", "ReturnSet"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_AZIMUTH_STEP_RAD = 1e-4  # of the central difference of beam responses
_AZIMUTHS_PER_BEAM = 4
_BLIND_LEAK = 1e-4  # amplitude that the blind zone's projection lets pass
_STEP_LIMIT_CELLS = 0.25
_CONVERGED_CELLS = 1e-4


@dataclass(frozen=True)
class PursuitConfig:
    """Settings of the pursuit.

    Parameters
    ----------
    false_alarm : float
        Probability that noise alone gives a return, per sweep.
    blind_range_m : float
        What is nearer is removed from the data, metres; 0 keeps everything.
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
    blind_range_m: float = 2.0
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


@dataclass(frozen=True, eq=False)
class _Fit:
    """Returns at given delays and azimuths with their least-squares gains, and what scoring needs."""

    turns: Real  # (K,)
    azimuth: Real  # (K,)
    gain: Complex  # (K,)
    energy: float  # explained by the atoms
    gradient: Real  # half its gradient in (turns, azimuths), (2 K,)
    information: Real  # (2 K, 2 K), for unit noise


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
        self._turns_per_m = 2.0 / SPEED_OF_LIGHT_M_S * grid.tone_spacing_hz
        self.range_cell_m = 1.0 / (grid.tones * self._turns_per_m)
        self.azimuth_cell_rad = min(1.0 / (beams.elements * beams.spacing_wavelengths), 1.0)
        self._correlator = ToneCorrelator(grid.tones)
        self._blind = self._blind_zone()

        count = _AZIMUTHS_PER_BEAM * beams.beams
        self._azimuths = 2.0 * np.pi * np.arange(count) / count - np.pi
        response, slope = self._beam_response(self._azimuths)
        norm = np.linalg.norm(response, axis=1)
        self._patterns = response / norm[:, None]
        along = np.sum(self._patterns.conj() * slope, axis=1, keepdims=True) * self._patterns
        directions = 2.0 * np.pi * np.mean(np.linalg.norm(slope - along, axis=1) / norm)

        self._bins = scipy.fft.next_fast_len(self.config.oversampling * grid.tones)
        first = int(np.ceil(self.config.blind_range_m * self._turns_per_m * self._bins)) + 1
        last = int(min(self.config.max_range_m * self._turns_per_m, 1.0 - 2.0 / grid.tones) * self._bins)
        if first > last:
            raise ConfigurationError(
                f"blind_range_m: expected less than the longest range of the tones, "
                f"{last / (self._bins * self._turns_per_m):.2f} m, got {self.config.blind_range_m}"
            )
        self._delays = np.arange(first, last + 1) / self._bins
        lengths = delay_length(grid.tones, float(np.ptp(self._delays))), float(directions)
        self.threshold = detection_threshold(self.config.false_alarm, *lengths)
        # Least |z|^2 of a plausible return: its gain is at least the mirror's times the reflectivity.
        mirror = grid.wavelength_m / (8.0 * np.pi * self._delays / self._turns_per_m)
        least = mirror * 10.0 ** (self.config.min_reflectivity_db / 20.0) * grid.tones
        self._plausible = (norm[:, None] * least) ** 2

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
        data = self._blank(data)
        fit = _Fit(np.zeros(0), np.zeros(0), np.zeros(0, np.complex128), 0.0, np.zeros(0), np.zeros((0, 0)))
        residual = data
        for _ in range(self.config.max_returns):
            peak = self._detect(residual, fit, noise_variance)
            if peak is None:
                break
            start = np.append(fit.turns, peak[0]), np.append(fit.azimuth, peak[1])
            fit = self._polish(data, self._project(data, *start), self.config.steps)
            residual = data - self._blank(self._synthesise(fit))
        if len(fit.turns):
            fit = self._polish(data, fit, self.config.final_steps)
            residual = data - self._blank(self._synthesise(fit))
        return self._returns(fit, max(noise_variance, float(np.mean(np.abs(residual) ** 2))))

    def _blind_zone(self) -> Complex:
        """Orthonormal basis of all delays within the blind range, shape (tones, n)."""
        reach = self.config.blind_range_m * self._turns_per_m
        if reach == 0.0:
            return np.zeros((self.grid.tones, 0), dtype=np.complex128)
        turns = np.linspace(0.0, reach, 4 * int(np.ceil(reach * self.grid.tones)) + 2)
        numbers = np.arange(self.grid.tones) - 0.5 * (self.grid.tones - 1)
        atoms = np.exp(-2j * np.pi * numbers[:, None] * turns)
        basis, strength, _ = np.linalg.svd(atoms, full_matrices=False)
        return np.asarray(basis[:, strength > _BLIND_LEAK * strength[0]])

    def _blank(self, data: Complex) -> Complex:
        """Data (beams, tones) without what the blind zone may hold."""
        return np.asarray(data - (data @ self._blind.conj()) @ self._blind.T)

    def _tone_products(self, turns: Real) -> tuple[Complex, Complex, Complex]:
        """Inner products of blanked delay atoms ``e_k^H e_l``, ``e_k^H e'_l`` and ``e'_k^H e'_l``, (K, K)."""
        kernel, slope, curvature = dirichlet(turns[:, None] - turns, self.grid.tones)
        phase = -2j * np.pi * (np.arange(self.grid.tones) - 0.5 * (self.grid.tones - 1))[:, None]
        atoms = np.exp(phase * turns)
        lost, lost_slope = self._blind.conj().T @ atoms, self._blind.conj().T @ (phase * atoms)
        return (
            kernel - lost.conj().T @ lost,
            -slope - lost.conj().T @ lost_slope,
            -curvature - lost_slope.conj().T @ lost_slope,
        )

    def _beam_response(self, azimuth: Real) -> tuple[Complex, Complex]:
        """Two-way response of the beams and its derivative, each (K, beams)."""
        ahead, behind = (
            self.beams.two_way(azimuth + step) for step in (_AZIMUTH_STEP_RAD, -_AZIMUTH_STEP_RAD)
        )
        return self.beams.two_way(azimuth), (ahead - behind) / (2.0 * _AZIMUTH_STEP_RAD)

    def _synthesise(self, fit: _Fit) -> Complex:
        """Noiseless responses of the returns, (beams, tones)."""
        tones = self._correlator.synthesise(fit.turns[:, None], fit.gain[:, None])
        return np.asarray(self.beams.two_way(fit.azimuth).T @ tones)

    def _detect(self, residual: Complex, fit: _Fit, noise_variance: float) -> tuple[float, float] | None:
        """Delay and azimuth of the strongest plausible return away from those found, or None."""
        spectrum = scipy.fft.ifft(residual, self._bins, axis=1, norm="forward")
        window = spectrum[:, np.rint(self._delays * self._bins).astype(np.intp)]
        power = np.abs(self._patterns.conj() @ window) ** 2  # (azimuths, delays)
        power[power < np.maximum(self._plausible, self.threshold * self.grid.tones * noise_variance)] = 0.0
        for turns, azimuth in zip(fit.turns, fit.azimuth, strict=True):
            delays = np.abs(self._delays - turns) * self.grid.tones < 1.0
            azimuths = np.abs(_wrap(self._azimuths - azimuth)) < self.azimuth_cell_rad
            power[np.ix_(azimuths, delays)] = 0.0
        azimuth_bin, delay_bin = np.unravel_index(np.argmax(power), power.shape)
        if power[azimuth_bin, delay_bin] == 0.0:
            return None
        return float(self._delays[delay_bin]), float(self._azimuths[azimuth_bin])

    def _project(self, data: Complex, turns: Real, azimuth: Real) -> _Fit:
        """Least squares of the gains, and the score and information of delays and azimuths.

        As in :func:`estimator.channel.model.delay_information`, with one more parameter per atom:
        inner products of atoms are those of beam patterns times those of delay atoms.
        """
        beam, beam_slope = self._beam_response(azimuth)
        tones, tones_slope, tones_curved = self._tone_products(turns)
        own = turns[:, None]
        z, z_turns = (
            part[:, 0]
            for part in self._correlator.correlate(self._correlator.split(beam.conj() @ data), own)[:2]
        )
        z_azimuth = self._correlator.correlate(self._correlator.split(beam_slope.conj() @ data), own)[0][:, 0]
        flat, mixed, curved = (
            a.conj() @ b.T for a, b in ((beam, beam), (beam, beam_slope), (beam_slope,) * 2)
        )
        atoms = flat * tones
        cross = np.concatenate([flat * tones_slope, mixed * tones], axis=1)
        corner = mixed * tones_slope.conj().T
        derivatives = np.block([[flat * tones_curved, corner], [corner.conj().T, curved * tones]])
        gain = np.asarray(np.linalg.solve(atoms, z), dtype=np.complex128)
        both = np.concatenate([gain, gain])
        projected = derivatives - cross.conj().T @ np.linalg.solve(atoms, cross)
        score = np.concatenate([z_turns, z_azimuth]) - cross.conj().T @ gain
        return _Fit(
            turns,
            azimuth,
            gain,
            float(np.real(np.vdot(gain, z))),
            np.real(both.conj() * score),
            np.real(both.conj()[:, None] * both * projected),
        )

    def _polish(self, data: Complex, fit: _Fit, steps: int) -> _Fit:
        """Joint Fisher scoring with Levenberg-Marquardt damping; cells bound the steps and the closeness."""
        count = len(fit.turns)
        cells = np.repeat([1.0 / self.grid.tones, self.azimuth_cell_rad], count)
        limit, damping = _STEP_LIMIT_CELLS * cells, 1e-3
        for _ in range(steps):
            diagonal = damping * np.abs(np.diag(fit.information))
            step = np.clip(np.linalg.solve(fit.information + np.diag(diagonal), fit.gradient), -limit, limit)
            turns, azimuth = fit.turns + step[:count], fit.azimuth + step[count:]
            trial = self._project(data, turns, azimuth) if self._apart(turns, azimuth) else None
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

    def _returns(self, fit: _Fit, noise_variance: float) -> ReturnSet:
        count = len(fit.turns)
        scale = np.repeat([1.0 / self._turns_per_m, 1.0], count)
        bound = 0.5 * noise_variance * np.linalg.inv(fit.information) * scale * scale[:, None]
        own = np.arange(count)[:, None] + np.array([0, count])
        distance = fit.turns / self._turns_per_m
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


def _wrap(angle_rad: Real) -> Real:
    """Angles in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angle_rad, 2.0 * np.pi))
