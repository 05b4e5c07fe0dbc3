"""The threshold of a constant false-alarm rate over all delays (and directions) at once.

In noise of variance ``s2`` the statistic ``T = sum_s |z_s|^2 / (||a||^2 s2)``, ``z_s`` the correlation of
snapshot ``s`` of the data with an atom ``a``, is half a chi-square of ``2 S`` degrees of freedom for every
atom: exponential with mean 1 for one snapshot. Over a continuum of
atoms the mean Euler characteristic of the places where it exceeds ``t`` bounds and, for small
probabilities, equals the chance that it does so anywhere (K. J. Worsley, "Local maxima and the
expected Euler characteristic of excursion sets of chi-square, F and t fields", Adv. Appl.
Probab. 26 (1994), Theorem 3.5). For delays ``L`` and directions ``W`` and one snapshot,

    (1 + (L + W) sqrt(t / pi) + L W (2 t - 1) / (2 pi)) exp(-t).

``L`` and ``W`` are the lengths of the paths that the normalised atom takes as one coordinate
varies, its phase removed: ``pi sqrt((N^2 - 1) / 3)`` for all turns of an axis of N samples.
Without directions the middle term is Rice's mean number of up-crossings. Crossings of a high
level come apart like events of a Poisson process, so that ``1 - exp(-bound)`` is accurate
where the bound is not small. Oversampling is thereby accounted for in full: the grid of any FFT
sees at most what the continuum holds.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincc, gammaln

from estimator.errors import ConfigurationError, InputError

__all__ = ["delay_length", "detection_threshold", "false_alarm_probability"]


def delay_length(tones: int, turns: float = 1.0) -> float:
    """Length of the path of an atom over a range of delays, or of turns along any axis of samples.

    Parameters
    ----------
    tones : int
        Number of tones, at least 2.
    turns : float
        Range of delays in turns; 1 for all delays.

    Raises
    ------
    InputError
        If ``tones`` is less than 2.
    """
    if tones < 2:
        raise InputError(f"tones: expected at least 2, got {tones}")
    return float(turns * np.pi * np.sqrt((tones**2 - 1.0) / 3.0))


def _log_excursions(threshold: float, lengths: tuple[float, ...], snapshots: int) -> float:
    """Logarithm of the bound in the head of this module: intrinsic volumes times Worsley's densities."""
    volumes = np.ones(1)  # of a box: the elementary symmetric polynomials of its sides
    for length in lengths:
        volumes = np.append(volumes, 0.0) + length * np.append(0.0, volumes)
    freedom, u = 2.0 * snapshots, 2.0 * threshold
    # Theorem 3.5, 0 to 3 dimensions, each over the factor t^(S - 1) e^-t / Gamma(S).
    common = (snapshots - 1.0) * np.log(threshold) - threshold - gammaln(snapshots)
    densities = [
        1.0 if snapshots == 1 else float(gammaincc(snapshots, threshold)) * np.exp(-common),
        np.sqrt(u / (2.0 * np.pi)),
        (u - (freedom - 1.0)) / (2.0 * np.pi),
        (u**2 - (2.0 * freedom - 1.0) * u + (freedom - 1.0) * (freedom - 2.0))
        / ((2.0 * np.pi) ** 1.5 * np.sqrt(u)),
    ]
    total = sum(v * max(d, 0.0) for v, d in zip(volumes, densities, strict=False))
    return float(np.log(total) + common)


def false_alarm_probability(threshold: float, *lengths: float, snapshots: int = 1) -> float:
    """Probability that noise alone exceeds a threshold somewhere.

    Parameters
    ----------
    threshold : float
        Level of ``T``, positive.
    *lengths : float
        Length of the delays searched, see :func:`delay_length`, and of up to two directions.
    snapshots : int
        Snapshots over which ``T`` sums.

    Returns
    -------
    float

    Raises
    ------
    InputError
        If an argument is out of range.
    """
    if not threshold > 0.0:
        raise InputError(f"threshold: expected a positive number, got {threshold}")
    _check(lengths, snapshots)
    return float(-np.expm1(-np.exp(min(_log_excursions(threshold, lengths, snapshots), 700.0))))


def detection_threshold(false_alarm: float, *lengths: float, snapshots: int = 1) -> float:
    """Threshold of ``T`` for a probability of any false alarm.

    The inverse of :func:`false_alarm_probability`.

    Raises
    ------
    ConfigurationError
        If ``false_alarm`` is not in (0, 0.5].
    InputError
        If a length is negative or not finite, or there is no snapshot.
    """
    if not 0.0 < false_alarm <= 0.5:
        raise ConfigurationError(f"false_alarm: expected a probability in (0, 0.5], got {false_alarm}")
    _check(lengths, snapshots)
    target = np.log(-np.log1p(-false_alarm))
    least = 1e-3 if snapshots == 1 else float(snapshots)  # below its mean a sum crosses for sure
    most = 500.0 + 4.0 * snapshots

    def excess(threshold: float) -> float:
        return _log_excursions(threshold, lengths, snapshots) - float(target)

    from scipy.optimize import brentq

    level: float = brentq(excess, least, most, xtol=1e-10)
    return level


def _check(lengths: tuple[float, ...], snapshots: int) -> None:
    if not 1 <= len(lengths) <= 3:
        raise InputError(f"lengths: expected one to three, got {len(lengths)}")
    for length in lengths:
        if not 0.0 <= length < np.inf:
            raise InputError(f"lengths: expected 0 or more, got {length}")
    if snapshots < 1:
        raise InputError(f"snapshots: expected at least 1, got {snapshots}")
