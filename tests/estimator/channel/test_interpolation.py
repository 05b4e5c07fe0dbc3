"""Correlations interpolated between those of a grid, against direct sums over the tones."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.channel.interpolation import SpectrumPlan, interpolate

pytestmark = pytest.mark.interpreted


@pytest.mark.parametrize("tones", [2, 7, 33, 64, 819])
def test_interpolated_correlations_are_the_sums(tones: int) -> None:
    """Anywhere, also at whole turns and beside them, for even and odd numbers: value and derivatives."""
    rng = np.random.default_rng(tones)
    channel = rng.normal(size=(2, 3, tones)) + 1j * rng.normal(size=(2, 3, tones))
    spectra, out = SpectrumPlan(tones).of(channel), np.empty((2, 3, 3), dtype=complex)
    phase = 2j * np.pi * (np.arange(tones) - 0.5 * (tones - 1.0))
    for turns in [*rng.uniform(-3.0, 3.0, 50), 0.0, 1.0, -1.0, 0.5, 1.0 - 1e-12, -1e-15]:
        interpolate(spectra, turns, out)
        for m in range(3):
            expected = np.sum(channel * phase**m * np.exp(phase * turns), axis=-1)
            np.testing.assert_allclose(out[..., m], expected, rtol=0, atol=1e-11 * tones ** (m + 1))
