"""The exponential of negative numbers in single precision, in a form that compilers vectorise.

``exp(x) = 2^k 2^f`` with ``k`` the whole number next to ``x log2(e)`` and ``f`` in [-1/2, 1/2]: ``2^f``
is the polynomial of degree 5 with the smallest largest relative error (7.5e-8), and ``k`` is added to its
exponent bits.
"""

from __future__ import annotations

import numpy as np

from estimator.compiled import compiled

__all__ = ["EXP_RELATIVE_ERROR", "exp_negative"]

EXP_RELATIVE_ERROR = 4e-6
"""Largest relative error of :func:`exp_negative` on [-55, 0]: near 0 less than 4e-7, then that of rounding
``x log2(e)``."""

_LOG2_E = np.float32(1.4426950408889634)
_LEAST = np.float32(-80.0)  # results stay clear of subnormal numbers, which processors are slow at
_TO_WHOLE = np.float32(1.5 * 2.0**23)  # added to and taken from a number, it leaves the nearest whole one
_C0 = np.float32(1.00000007)
_C1 = np.float32(0.693146967)
_C2 = np.float32(0.240221197)
_C3 = np.float32(0.0555071327)
_C4 = np.float32(0.00967554133)
_C5 = np.float32(0.0013276472)


@compiled
def exp_negative(x: np.float32) -> np.float32:
    """``exp(x)`` for ``x`` from -55 to 0; below, 2^-80, about 8e-25.

    Parameters
    ----------
    x : float32
        Not positive.
    """
    power = max(x * _LOG2_E, _LEAST)
    shifted = np.float32(power + _TO_WHOLE)
    whole = np.float32(shifted - _TO_WHOLE)
    f = np.float32(power - whole)
    root = np.float32(_C0 + f * (_C1 + f * (_C2 + f * (_C3 + f * (_C4 + f * _C5)))))
    bits = np.int64(root.view(np.int32)) + (np.int64(shifted.view(np.int32)) << 23)
    return np.int32(bits).view(np.float32)
