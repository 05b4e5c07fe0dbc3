"""The threshold of a constant false-alarm rate over all delays (and directions) at once.

In noise of variance ``s2`` the statistic ``T = |z|^2 / (||a||^2 s2)``, ``z`` the correlation of the
data with an atom ``a``, is exponential with mean 1 for every atom. Over a continuum of
atoms the mean Euler characteristic of the places where it exceeds ``t`` bounds and, for small
probabilities, equals the chance that it does so anywhere (K. J. Worsley, "Local maxima and the
expected Euler characteristic of excursion sets of chi-square, F and t fields", Adv. Appl.
Probab. 26 (1994)); for delays ``L`` and directions ``W``,

    (1 + (L + W) sqrt(t / pi) + L W (2 t - 1) / (2 pi)) exp(-t).

``L`` and ``W`` are the lengths of the paths that the normalised atom takes as delay and
direction vary, their phase removed: ``L = pi sqrt((N^2 - 1) / 3)`` for all delays of N tones.
Without directions the middle term is Rice's mean number of up-crossings. Crossings of a high
level come apart like events of a Poisson process, so that ``1 - exp(-bound)`` is accurate
where the bound is not small. Oversampling is thereby accounted for in full: the grid of any FFT
sees at most what the continuum holds.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from estimator.errors import ConfigurationError, InputError

__all__ = ["delay_length", "detection_threshold", "false_alarm_probability"]


def delay_length(tones: int, turns: float = 1.0) -> float:
    """Length ``L`` of the path of a delay atom over a range of delays.

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


def _log_excursions(threshold: float, delays: float, directions: float) -> float:
    """Logarithm of the bound in the head of this module."""
    lines = (delays + directions) * np.sqrt(threshold / np.pi)
    areas = delays * directions * max(2.0 * threshold - 1.0, 0.0) / (2.0 * np.pi)
    return float(np.log1p(lines + areas) - threshold)


def false_alarm_probability(threshold: float, delays: float, directions: float = 0.0) -> float:
    """Probability that noise alone exceeds a threshold somewhere.

    Parameters
    ----------
    threshold : float
        Level of ``T``, positive.
    delays : float
        Length of the delays searched, see :func:`delay_length`.
    directions : float
        Length of the directions searched.

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
    _check_lengths(delays, directions)
    return float(-np.expm1(-np.exp(_log_excursions(threshold, delays, directions))))


def detection_threshold(false_alarm: float, delays: float, directions: float = 0.0) -> float:
    """Threshold of ``T`` for a probability of any false alarm.

    The inverse of :func:`false_alarm_probability`.

    Raises
    ------
    ConfigurationError
        If ``false_alarm`` is not in (0, 0.5].
    InputError
        If a length is negative or not finite.
    """
    if not 0.0 < false_alarm <= 0.5:
        raise ConfigurationError(f"false_alarm: expected a probability in (0, 0.5], got {false_alarm}")
    _check_lengths(delays, directions)
    target = np.log(-np.log1p(-false_alarm))
    return float(brentq(lambda t: _log_excursions(t, delays, directions) - target, 1e-3, 800.0, xtol=1e-10))


def _check_lengths(delays: float, directions: float) -> None:
    for name, length in (("delays", delays), ("directions", directions)):
        if not 0.0 <= length < np.inf:
            raise InputError(f"{name}: expected a length of 0 or more, got {length}")
