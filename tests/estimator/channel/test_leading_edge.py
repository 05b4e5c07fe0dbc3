"""Leading edges against pulses that are known: alone, in noise, and before a dense tail."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.channel.leading_edge import LeadingEdgeConfig, leading_edges
from estimator.errors import ConfigurationError, InputError

TAPS, WIDTH = 512, 1.4  # of a Gaussian pulse, whose band is well inside that of the taps


def pulse(tap):
    """A pulse at a fraction of a tap."""
    return np.exp(-0.5 * ((np.arange(TAPS) - tap) / WIDTH) ** 2).astype(complex)


def rise():
    """From the edge, at half the top, to the top."""
    return WIDTH * np.sqrt(2.0 * np.log(2.0))


def test_a_pulse_alone_is_found_wherever_it_is():
    """Between taps as on them."""
    tap = 200.0 + np.linspace(0.0, 1.0, 11)
    found = leading_edges(np.array([pulse(t) for t in tap]), np.round(tap))
    np.testing.assert_allclose(found.tap, tap - rise(), atol=2e-3)


def test_the_scatter_is_what_is_claimed():
    """400 pulses in noise: no bias, and the scatter claimed (25 %, seven of its Monte-Carlo errors)."""
    rng, runs = np.random.default_rng(5), 400
    tap = 200.0 + rng.random(runs)
    noise = 0.01 * (rng.normal(size=(runs, TAPS)) + 1j * rng.normal(size=(runs, TAPS)))
    found = leading_edges(np.array([pulse(t) for t in tap]) + noise, tap)
    error = found.tap - tap + rise()
    claimed = np.sqrt(np.mean(found.std_taps**2))
    assert abs(error.mean()) < 4.0 * claimed / np.sqrt(runs)
    assert error.std() == pytest.approx(claimed, rel=0.25)


def test_what_comes_later_hardly_moves_it():
    """A dense tail from three taps on, stronger than the first path in sum."""
    rng, runs = np.random.default_rng(6), 100
    tap = 200.0 + rng.random(runs)
    responses = []
    for t in tap:
        late = t + 4.0 + 20.0 * rng.random(40)
        gain = 0.3 * np.exp(-(late - t) / 15.0) * np.exp(2j * np.pi * rng.random(40))
        responses.append(pulse(t) + sum(g * pulse(x) for g, x in zip(gain, late, strict=True)))
    error = leading_edges(np.array(responses), tap).tap - tap + rise()
    assert np.median(np.abs(error)) < 0.1
    assert np.percentile(np.abs(error), 95) < 0.5


def test_noise_alone_has_no_edge():
    """What would be told of nothing is NaN; in one of a hundred at most noise is taken for a path."""
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(100, TAPS)) + 1j * rng.normal(size=(100, TAPS))
    found = leading_edges(noise, np.full(100, 200.0))
    assert np.isnan(found.tap).mean() >= 0.99


def test_mistakes_are_told():
    """Shapes and settings that cannot be meant."""
    with pytest.raises(InputError, match=r"expected shapes \(N, taps\) and \(N,\)"):
        leading_edges(np.ones((2, TAPS), dtype=complex), np.ones(3))
    with pytest.raises(InputError, match="more than 60 taps"):
        leading_edges(np.ones((2, 40), dtype=complex), np.ones(2))
    with pytest.raises(ConfigurationError, match="shares between 0 and 1"):
        LeadingEdgeConfig(edge_share=1.0)
    with pytest.raises(ConfigurationError, match="positive numbers"):
        LeadingEdgeConfig(oversampling=0)
