"""Pursuit of the paths of a channel together with its diffuse tail.

As in :mod:`estimator.channel.pursuit` paths are found one by one, but in the noise that tail and noise floor
(:mod:`estimator.channel.tail`) make: after every path the tail is fitted anew, so that what stands out of it
is a path and what does not is no path. In the end paths that the tail has made insignificant are taken out,
the least significant first. Of K paths found this takes at most 2 K fits of the tail.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from estimator.channel.coloured import ColouredFit, fit_gains, refine, strongest_in
from estimator.channel.model import tone_atoms
from estimator.channel.refinement import Refinement
from estimator.channel.tail import TailConfig, TailProfile, tail_column
from estimator.channel.tail_fit import TailFit, fit_tail, noise_floor
from estimator.channel.toeplitz import inverse_of

__all__ = ["TailPaths", "TailPursuit", "pursue_in_tail"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class TailPursuit:
    """Settings of a pursuit.

    Parameters
    ----------
    threshold : float
        Significance of a path.
    range_ratio : float
        Least power of a path over that of the strongest.
    forerunner_ratio : float
        Least power, over that of the strongest, of the path with which the tail begins.
    max_paths : int
        Largest number of paths.
    oversampling : int
        Delays searched per resolution cell.
    polish_steps, final_steps : int
        Joint steps after each path, and at the end.
    tail : TailConfig
        Settings of the tail.
    limits : Refinement
        Limits of joint steps.
    """

    threshold: float
    range_ratio: float
    forerunner_ratio: float
    max_paths: int
    oversampling: int
    polish_steps: int
    final_steps: int
    tail: TailConfig
    limits: Refinement


class TailPaths(NamedTuple):
    """Paths and tail of a channel.

    Parameters
    ----------
    turns, gain : ndarray, shape (K,)
        Delays in turns, and complex gains.
    variance : ndarray, shape (K,)
        Of the delays, square turns, given the tail.
    profile : TailProfile
        The tail and the noise floor.
    """

    turns: Real
    gain: Complex
    variance: Real
    profile: TailProfile


def pursue_in_tail(cfr: Complex, noise: float | None, settings: TailPursuit) -> TailPaths:
    """The paths and the tail of a channel.

    Parameters
    ----------
    cfr : ndarray of complex128, shape (N,)
        The channel.
    noise : float or None
        Variance of its noise floor per tone; None if it is to be estimated.
    settings : TailPursuit
        When to stop.
    """
    tones = len(cfr)
    bins = scipy.fft.next_fast_len(settings.oversampling * tones)
    column = tail_column(TailProfile(noise if noise is not None else noise_floor(cfr)), tones)
    found, fit = fit_gains(cfr, np.zeros(0), column), None
    most = min(settings.max_paths, tones // 3)
    while len(found.turns) < most:
        left = cfr - found.gain @ tone_atoms(found.turns, tones)
        least = settings.range_ratio * float(np.max(np.abs(found.gain) ** 2, initial=0.0))
        closest = settings.limits.closest_cells / tones
        place, statistic = strongest_in(left, inverse_of(column), bins, found.turns, least, closest)
        if statistic < settings.threshold:
            break
        found, fit, column = _refit(cfr, np.append(found.turns, place), column, noise, fit, settings)
    while len(found.turns) > 1:
        significance = found.significance.copy()
        significance[_lead(found.turns, found.gain, tones, settings.forerunner_ratio)] = np.inf
        significance[_crowded(found, settings.limits.closest_cells / tones)] = 0.0
        weakest = int(np.argmin(significance))
        if significance[weakest] >= settings.threshold:
            break
        found, fit, column = _refit(cfr, np.delete(found.turns, weakest), column, noise, fit, settings)
    if fit is None:
        return TailPaths(found.turns, found.gain, np.zeros(0), TailProfile(column[0].real))
    held = _lead(found.turns, found.gain, tones, settings.forerunner_ratio) if fit.tied else -1
    found = refine(cfr, found.turns, column, settings.final_steps, settings.limits, held)
    variance = 0.5 * np.diag(np.linalg.pinv(found.information, hermitian=True))
    return TailPaths(found.turns, found.gain, variance, fit.profile)


def _refit(
    cfr: Complex,
    turns: Real,
    column: Complex,
    noise: float | None,
    fit: TailFit | None,
    settings: TailPursuit,
) -> tuple[ColouredFit, TailFit, Complex]:
    """Paths refined in the tail, the tail fitted to what they leave, and the paths once more."""
    found = refine(cfr, turns, column, settings.polish_steps, settings.limits)
    first = _lead(found.turns, found.gain, len(cfr), settings.forerunner_ratio)
    profile = None if fit is None else fit.profile
    fit = fit_tail(cfr, found.turns, first, noise, settings.tail, profile)
    column = tail_column(fit.profile, len(cfr))
    turns = found.turns.copy()
    turns[first] = fit.edge
    held = first if fit.tied else -1
    return refine(cfr, turns, column, settings.polish_steps, settings.limits, held), fit, column


def _lead(turns: Real, gain: Complex, tones: int, forerunner_ratio: float) -> int:
    """The path with which the tail begins: the first one that is no forerunner of a much stronger one."""
    power = np.abs(gain) ** 2
    since = turns + 1.0 / tones  # a delay just below 0 is no late one
    since = np.where(power >= forerunner_ratio * np.max(power), since - np.floor(since), np.inf)
    return int(np.argmin(since))


def _crowded(found: ColouredFit, closest: float) -> NDArray[np.bool_]:
    """Which paths (K,) have a stronger one closer than ``closest`` turns."""
    apart, power = found.turns[:, None] - found.turns, np.abs(found.gain) ** 2
    near = np.abs(apart - np.rint(apart)) < closest
    return np.asarray(np.any(near & (power > power[:, None]), axis=1))
