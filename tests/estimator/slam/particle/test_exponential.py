"""The exponential of the particle engine against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.compiled import compiled
from estimator.slam.particle.exponential import EXP_RELATIVE_ERROR, exp_negative

pytestmark = pytest.mark.interpreted


@compiled
def _every(x, out):
    for i in range(x.size):
        out[i] = exp_negative(x[i])


def exponentials(x):
    """Of an array, in single precision."""
    out = np.empty(len(x), np.float32)
    _every(np.asarray(x, dtype=np.float32), out)
    return out


def test_error_is_what_is_stated():
    """On a dense grid of the range and around its powers of two; near 0 the error is much less."""
    whole = -np.log(2.0) * np.arange(159) / 2.0
    edges = (whole[:, None] + 1e-4 * np.linspace(-1.0, 1.0, 101)).ravel()
    x = np.concatenate([-np.linspace(0.0, 55.0, 200_001), edges])
    x = x[(x <= 0.0) & (x > -55.0)].astype(np.float32)
    error = np.abs(exponentials(x) / np.exp(x.astype(np.float64)) - 1.0)
    assert error.max() < EXP_RELATIVE_ERROR
    assert error[x > -1.0].max() < 4e-7


def test_far_below_it_is_small_and_normal():
    """From -56 to minus infinity: positive, below 1e-24, never a subnormal number."""
    values = exponentials([-56.0, -87.0, -104.0, -1e6, -np.inf])
    assert np.all((values > 1e-30) & (values < 1e-24))


def test_it_never_rises_as_its_argument_falls():
    """Over the joints of its pieces: a particle further off its path never weighs more."""
    values = exponentials(-np.arange(0.0, 50.0, 1e-3)).astype(np.float64)
    assert np.all(np.diff(values) <= 1e-6 * values[:-1])
