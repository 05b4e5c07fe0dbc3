"""The threshold of a constant false-alarm rate over all delays at once.

In noise of variance ``s2`` the statistic ``T(x) = |z(x)|^2 / (N s2)``, ``z`` the correlation
of a CFR with the atom of delay ``x``, is exponential with mean 1 at every ``x``. Its maximum
over the continuum of delays exceeds ``t`` with a probability of at most

    (1 + sqrt(pi t (N^2 - 1) / 3)) exp(-t),

the chance of starting above ``t`` plus the mean number of up-crossings in one turn (S. O. Rice,
"Mathematical analysis of random noise", 1945; ``(N^2 - 1) / 12`` is the mean square tone number).
Since crossings of a high level come apart like events of a Poisson process, ``1 - exp(-bound)`` is
accurate where the bound itself is not small. Oversampling is thereby accounted for in full:
the grid of any FFT sees at most what the continuum holds.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from estimator.errors import ConfigurationError, InputError

__all__ = ["detection_threshold", "false_alarm_probability"]


def _log_crossings(threshold: float, tones: int) -> float:
    """Logarithm of the bound in the head of this module."""
    return float(np.log1p(np.sqrt(np.pi * threshold * (tones**2 - 1.0) / 3.0)) - threshold)


def false_alarm_probability(threshold: float, tones: int) -> float:
    """Probability that noise alone exceeds ``threshold`` at some delay.

    Parameters
    ----------
    threshold : float
        Level of ``|z|^2 / (N s2)``, positive.
    tones : int
        Number of tones, at least 2.

    Returns
    -------
    float
        Probability for one CFR over the whole unambiguous range of delays.

    Raises
    ------
    InputError
        If ``tones`` or ``threshold`` is out of range.
    """
    if tones < 2:
        raise InputError(f"tones: expected at least 2, got {tones}")
    if not threshold > 0.0:
        raise InputError(f"threshold: expected a positive number, got {threshold}")
    return float(-np.expm1(-np.exp(_log_crossings(threshold, tones))))


def detection_threshold(false_alarm: float, tones: int) -> float:
    """Threshold of ``|z|^2 / (N s2)`` for a false-alarm probability per CFR.

    The inverse of :func:`false_alarm_probability`.

    Raises
    ------
    ConfigurationError
        If ``false_alarm`` is not in (0, 0.5].
    InputError
        If ``tones`` is less than 2.
    """
    if not 0.0 < false_alarm <= 0.5:
        raise ConfigurationError(f"false_alarm: expected a probability in (0, 0.5], got {false_alarm}")
    if tones < 2:
        raise InputError(f"tones: expected at least 2, got {tones}")
    target = np.log(-np.log1p(-false_alarm))
    return float(brentq(lambda t: _log_crossings(t, tones) - target, 0.5, 800.0, xtol=1e-10))
