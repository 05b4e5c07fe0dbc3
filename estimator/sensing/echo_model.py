"""The signal model of a beam sweep: atoms of point returns, and their least squares.

A return from range ``r`` and azimuth ``phi``, leaving and arriving in the same direction, gives
beam ``b`` on tone ``n`` the response ``g w_b(phi) exp(-j 2 pi n' x)``: ``w`` the two-way response of
the beams (:meth:`estimator.arrays.BeamSet.two_way`) and ``x`` the delay ``2 r / c`` in turns (see
:mod:`estimator.channel.model`). The atom is the product of a beam pattern and a delay atom, so that
inner products of atoms are products of small matrices and Dirichlet kernels.

What arrives from within the *blind range* (the transmitter's leakage, the device itself) comes in
any pattern over the beams. All delays up to that range are projected out of
the data, and of the atoms alike, so that nothing else is disturbed.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import BeamSet
from estimator.channel.model import ToneCorrelator, dirichlet
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["EchoFit", "EchoModel"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_AZIMUTH_STEP_RAD = 1e-4  # of the central difference of beam responses
# Amplitude that the projection lets pass: leakage of 40 dB of isolation falls below the flash of a near wall.
_BLIND_LEAK = 1e-2


@dataclass(frozen=True, eq=False)
class EchoFit:
    """Returns at given delays and azimuths with their least-squares gains, and what scoring needs.

    Parameters
    ----------
    turns, azimuth : ndarray, shape (K,)
        Delays in turns, and azimuths, radians.
    gain : ndarray of complex128, shape (K,)
        Gains.
    energy : float
        Energy of the data that the atoms explain.
    gradient : ndarray, shape (2 K,)
        Half the gradient of the energy in (turns, azimuths).
    information : ndarray, shape (2 K, 2 K)
        Fisher information of (turns, azimuths), the gains eliminated, for unit noise; twice this
        over the noise variance is the information.
    """

    turns: Real
    azimuth: Real
    gain: Complex
    energy: float
    gradient: Real
    information: Real

    @classmethod
    def empty(cls) -> EchoFit:
        """No returns at all."""
        none = np.zeros(0)
        return cls(none, none, none.astype(np.complex128), 0.0, none, np.zeros((0, 0)))


class EchoModel:
    """Atoms of one grid of tones and one set of beams.

    Parameters
    ----------
    grid : OfdmGrid
        Tones of the echo.
    beams : BeamSet
        The beams, in the order of the sweep.
    blind_range_m : float
        What is nearer is projected out, metres; 0 keeps everything.
    """

    def __init__(self, grid: OfdmGrid, beams: BeamSet, blind_range_m: float) -> None:
        self.grid, self.beams = grid, beams
        self.turns_per_m = 2.0 / SPEED_OF_LIGHT_M_S * grid.tone_spacing_hz
        self._correlator = ToneCorrelator(grid.tones)
        self._phase = -2j * np.pi * (np.arange(grid.tones) - 0.5 * (grid.tones - 1))[:, None]
        self._blind = self._blind_zone(blind_range_m * self.turns_per_m)
        self._weights = np.ones(beams.beams)

    def weighted(self, weights: Real) -> EchoModel:
        """The model of data (beams, tones) that were multiplied by weights (beams,): whitened data."""
        model = copy.copy(self)
        model._weights = weights
        return model

    def blank(self, data: Complex) -> Complex:
        """Data (beams, tones) without what the blind range may hold."""
        return np.asarray(data - (data @ self._blind.conj()) @ self._blind.T)

    def factors(self, fit: EchoFit) -> tuple[Complex, Complex]:
        """Patterns (beams, K) and blanked tones (K, tones), whose product is what the returns send."""
        tones = self._correlator.synthesise(fit.turns[:, None], fit.gain[:, None])
        return self._two_way(fit.azimuth).T, self.blank(tones)

    def synthesise(self, fit: EchoFit) -> Complex:
        """Noiseless, blanked responses of the returns, (beams, tones)."""
        patterns, tones = self.factors(fit)
        return np.asarray(patterns @ tones)

    def beam_response(self, azimuth: Real) -> tuple[Complex, Complex]:
        """Two-way response of the beams, weighted, and its derivative, each (K, beams)."""
        steps = _AZIMUTH_STEP_RAD * np.array([0.0, 1.0, -1.0])
        here, ahead, behind = self._two_way(azimuth + steps[:, None])
        return here, (ahead - behind) / (2.0 * _AZIMUTH_STEP_RAD)

    def _two_way(self, azimuth: Real) -> Complex:
        return self.beams.two_way(azimuth) * self._weights

    def project(self, data: Complex, turns: Real, azimuth: Real) -> EchoFit:
        """Least squares of the gains, and the score and information of delays and azimuths.

        As in :func:`estimator.channel.atoms.AtomKernels.information`, with one more parameter per atom:
        inner products of atoms are those of beam patterns times those of delay atoms.

        Parameters
        ----------
        data : ndarray of complex128, shape (beams, tones)
            Blanked data.
        turns, azimuth : ndarray, shape (K,)
            Delays in turns, and azimuths, radians, of at least one return; all different.
        """
        beam, beam_slope = self.beam_response(azimuth)
        tones, tones_slope, tones_curved = self._tone_products(turns)
        heard = (np.concatenate([beam, beam_slope]).conj() @ data).reshape(2, len(turns), -1).swapaxes(0, 1)
        (z, z_azimuth), (z_turns, _), _ = (
            part[:, :, 0].T
            for part in self._correlator.correlate(self._correlator.split(heard), turns[:, None])
        )
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
        return EchoFit(
            turns,
            azimuth,
            gain,
            float(np.real(np.vdot(gain, z))),
            np.real(both.conj() * score),
            np.real(both.conj()[:, None] * both * projected),
        )

    def _tone_products(self, turns: Real) -> tuple[Complex, Complex, Complex]:
        """Inner products of blanked delay atoms ``e_k^H e_l``, ``e_k^H e'_l`` and ``e'_k^H e'_l``, (K, K)."""
        kernel, slope, curvature = dirichlet(turns[:, None] - turns, self.grid.tones)
        atoms = np.exp(self._phase * turns)
        lost, lost_slope = self._blind.conj().T @ atoms, self._blind.conj().T @ (self._phase * atoms)
        return (
            kernel - lost.conj().T @ lost,
            -slope - lost.conj().T @ lost_slope,
            -curvature - lost_slope.conj().T @ lost_slope,
        )

    def _blind_zone(self, reach: float) -> Complex:
        """Orthonormal basis of all delays up to ``reach`` turns, shape (tones, n)."""
        if reach == 0.0:
            return np.zeros((self.grid.tones, 0), dtype=np.complex128)
        turns = np.linspace(0.0, reach, 4 * int(np.ceil(reach * self.grid.tones)) + 2)
        basis, strength, _ = np.linalg.svd(np.exp(self._phase * turns), full_matrices=False)
        return np.asarray(basis[:, strength > _BLIND_LEAK * strength[0]])
