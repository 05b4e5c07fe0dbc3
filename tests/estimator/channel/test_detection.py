"""The false-alarm rate of the detection threshold, by formula and by simulation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft

from estimator.channel.detection import detection_threshold, false_alarm_probability
from estimator.errors import ConfigurationError, InputError


@pytest.mark.parametrize("tones", [2, 200, 3276])
@pytest.mark.parametrize("false_alarm", [0.5, 0.01, 1e-9])
def test_threshold_inverts_the_probability(tones: int, false_alarm: float) -> None:
    """The threshold of a probability has that probability."""
    threshold = detection_threshold(false_alarm, tones)
    assert false_alarm_probability(threshold, tones) == pytest.approx(false_alarm, rel=1e-6)


def test_oversampling_is_accounted_for() -> None:
    """The continuum crosses more often than N independent bins, and less than a union over fine ones."""
    tones, threshold = 819, 12.0
    independent = 1.0 - (1.0 - np.exp(-threshold)) ** tones
    assert independent < false_alarm_probability(threshold, tones) < 8 * independent


@pytest.mark.parametrize("false_alarm", [0.3, 0.05])
def test_noise_exceeds_the_threshold_as_often_as_stated(false_alarm: float) -> None:
    """The maximum of 16-fold oversampled noise spectra exceeds the threshold at the stated rate."""
    rng = np.random.default_rng(4)
    tones, trials = 128, 6000
    noise = np.sqrt(0.5) * (rng.normal(size=(trials, tones)) + 1j * rng.normal(size=(trials, tones)))
    spectrum = scipy.fft.fft(noise, 16 * tones, axis=1)
    peak = np.max(np.abs(spectrum) ** 2, axis=1) / tones
    rate = np.mean(peak > detection_threshold(false_alarm, tones))
    deviation = np.sqrt(false_alarm * (1.0 - false_alarm) / trials)
    # The formula is a bound; it was found less than 3 % above the truth at a rate of 0.3.
    assert -4.0 * deviation - 0.03 * false_alarm < rate - false_alarm < 4.0 * deviation


@pytest.mark.parametrize("false_alarm", [0.0, 0.6, np.nan])
def test_bad_probabilities_are_refused(false_alarm: float) -> None:
    """A false-alarm probability outside (0, 0.5] is a configuration error that shows the value."""
    with pytest.raises(ConfigurationError, match=r"expected a probability in \(0, 0.5\]"):
        detection_threshold(false_alarm, 100)


def test_bad_levels_and_tone_numbers_are_refused() -> None:
    """Thresholds must be positive, and one tone has no delay."""
    with pytest.raises(InputError, match="threshold: expected a positive number, got -1"):
        false_alarm_probability(-1.0, 10)
    with pytest.raises(InputError, match="tones: expected at least 2, got 1"):
        false_alarm_probability(1.0, 1)
    with pytest.raises(InputError, match="tones: expected at least 2, got 1"):
        detection_threshold(0.1, 1)
