"""The diffuse tail of a channel, with its first path, by maximum likelihood.

The parameters of :mod:`estimator.channel.tail` are those of the largest likelihood of what the paths leave,
their gains integrated out (restricted likelihood, H. D. Patterson and R. Thompson, Biometrika 58, 1971):
paths that explain the data do not make the tail look weaker than it is. The search starts at the best of a
few profiles against the channel's impulse response (P. Whittle's likelihood) and goes on by the simplex of
Nelder and Mead: at most ``steps`` whitenings of O(K N^2) each for a tail that begins with the first path, and
as many for one that begins later.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.channel.model import tone_atoms
from estimator.channel.tail import TailConfig, TailProfile, tail_column
from estimator.channel.toeplitz import Whitened, whiten

__all__ = ["TailFit", "fit_tail", "noise_floor"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
_QUARTILE = -np.log(0.75)  # of an exponential law of mean 1: what a quarter of noise's energies are below


class TailFit(NamedTuple):
    """A fitted profile.

    Parameters
    ----------
    profile : TailProfile
        The profile.
    log_likelihood : float
        Its restricted log-likelihood, nats.
    edge : float
        Delay of the first path, turns.
    tied : bool
        Whether the tail begins with it.
    """

    profile: TailProfile
    log_likelihood: float
    edge: float
    tied: bool = False


def noise_floor(cfr: Complex) -> float:
    """Variance of the noise per tone of a channel (N,), if a quarter of its delays have nothing else."""
    energy = np.abs(np.fft.ifft(cfr, norm="ortho")) ** 2
    return max(float(np.quantile(energy, 0.25) / _QUARTILE), float(np.finfo(float).tiny))


def fit_tail(
    cfr: Complex,
    turns: Real,
    first: int,
    noise: float | None,
    config: TailConfig,
    start: TailProfile | None = None,
) -> TailFit:
    """The tail of the largest restricted likelihood, or noise alone where a tail gains too little.

    It begins with the first path, whose delay is then estimated with it, or later if that is more likely.

    Parameters
    ----------
    cfr : ndarray of complex128, shape (N,)
        The channel.
    turns : ndarray, shape (K,)
        Delays of its paths, at least one and fewer than tones, turns.
    first : int
        The path that comes first.
    noise : float or None
        Variance of the noise floor; None if it is not known.
    config : TailConfig
        Settings.
    start : TailProfile, optional
        Where the search starts, if it has a tail.
    """
    tones, edge = len(cfr), float(turns[first])
    least, most = config.shortest_cells / tones, config.longest_turns
    vectors = np.concatenate([cfr[None], tone_atoms(turns, tones)])
    alone = TailFit(*_scaled(vectors, TailProfile(1.0), noise), edge)
    if start is None or not start.power > 0.0:
        start = _start(vectors, noise, np.geomspace(least, most, max(int(np.log2(most / least)) + 1, 2)))
    shape = np.log([start.power / start.noise, start.decay])
    later = max(start.onset - edge - float(np.rint(start.onset - edge)), 0.0)

    def profile(values: Real, onset: float) -> TailProfile:
        power, decay = np.exp(np.clip(values[:2], -50.0, 50.0))
        return TailProfile(1.0, float(power), onset, float(np.clip(decay, least, most)))

    def together(values: Real) -> TailFit:
        place = edge + float(values[2]) / tones
        vectors[1 + first] = tone_atoms(np.array([place]), tones)[0]
        return TailFit(*_scaled(vectors, profile(values, place), noise), place, True)

    def apart(values: Real) -> TailFit:
        onset = edge + min(abs(float(values[2])) / tones, 0.5)
        return TailFit(*_scaled(vectors, profile(values, onset), noise), edge)

    free = _highest(apart, np.append(shape, later * tones), config)
    best = _highest(together, np.append(shape, 0.0), config)
    if free.log_likelihood > best.log_likelihood + config.onset_evidence:
        best = free
    return best if best.log_likelihood > alone.log_likelihood + config.evidence else alone


def _highest(fit: Callable[[Real], TailFit], start: Real, config: TailConfig) -> TailFit:
    """The fit of the largest likelihood about a start."""
    from scipy.optimize import minimize

    def cost(values: Real) -> float:
        return -fit(values).log_likelihood

    simplex = start + np.vstack([np.zeros(len(start)), 0.5 * np.eye(len(start))])
    tolerance = {"xatol": config.tolerance, "fatol": config.tolerance}
    options: Any = {"initial_simplex": simplex, "maxfev": config.steps, **tolerance}
    found = minimize(cost, start, method="Nelder-Mead", options=options)
    return fit(found.x)


def _scaled(vectors: Complex, ratio: TailProfile, noise: float | None) -> tuple[TailProfile, float]:
    """A profile of given ratios to its noise, the noise as known or as most likely, and its likelihood."""
    tones, paths = vectors.shape[1], len(vectors) - 1
    white = whiten(tail_column(ratio, tones), vectors)
    energy, log_gram = _left(white)
    free = tones - paths
    scale = noise if noise is not None else energy / free
    value = -free * np.log(scale) - white.log_determinant - log_gram - energy / scale
    onset = ratio.onset - float(np.floor(ratio.onset))
    return TailProfile(scale, scale * ratio.power, onset, ratio.decay), float(value)


def _left(white: Whitened) -> tuple[float, float]:
    """Energy that atoms leave of a channel, and log-determinant of their Gram matrix, all whitened."""
    channel, atoms = white.values[0], white.values[1:]
    energy = float(np.vdot(channel, channel).real)
    if len(atoms) == 0:
        return energy, 0.0
    basis, triangle = np.linalg.qr(atoms.T)
    explained = np.conj(basis.T) @ channel
    log_gram = 2.0 * float(np.sum(np.log(np.abs(np.diag(triangle)))))
    return energy - float(np.vdot(explained, explained).real), log_gram


def _start(vectors: Complex, noise: float | None, decays: Real) -> TailProfile:
    """The best of a few profiles against the impulse response that the paths leave."""
    cfr, atoms = vectors[0], vectors[1:]
    left = cfr
    if len(atoms):
        left = cfr - atoms.T @ np.linalg.lstsq(atoms.T, cfr, rcond=None)[0]
    tones = len(cfr)
    energy = np.abs(np.fft.ifft(left, norm="ortho")) ** 2
    floor = noise if noise is not None else noise_floor(left)
    spectrum, best, chosen = np.fft.rfft(energy), -np.inf, TailProfile(floor, floor, 0.0, float(decays[0]))
    excess = max(float(energy.mean()) - floor, 1e-3 * floor)
    for decay in decays:
        shape = np.exp(-np.arange(tones) / (tones * decay))
        shape *= tones / shape.sum()
        for power in (0.5 * excess, excess, 2.0 * excess):
            expected = floor + power * shape
            matched = np.fft.irfft(spectrum * np.conj(np.fft.rfft(1.0 / expected)), tones)
            onset = int(np.argmin(matched))
            value = -np.sum(np.log(expected)) - matched[onset]
            if value > best:
                best, chosen = value, TailProfile(floor, power, onset / tones, float(decay))
    return chosen
