"""The false-alarm rate of the detection threshold, by formula and by simulation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft

from estimator.channel.detection import delay_length, detection_threshold, false_alarm_probability
from estimator.errors import ConfigurationError, InputError


@pytest.mark.parametrize("tones", [2, 200, 3276])
@pytest.mark.parametrize("false_alarm", [0.5, 0.01, 1e-9])
def test_threshold_inverts_the_probability(tones: int, false_alarm: float) -> None:
    """The threshold of a probability has that probability."""
    length = delay_length(tones)
    for directions in (0.0, 70.0):
        threshold = detection_threshold(false_alarm, length, directions)
        probability = false_alarm_probability(threshold, length, directions)
        assert probability == pytest.approx(false_alarm, rel=1e-6)


def test_oversampling_is_accounted_for() -> None:
    """The continuum crosses more often than N independent bins, and less than a union over fine ones."""
    tones, threshold = 819, 12.0
    independent = 1.0 - (1.0 - np.exp(-threshold)) ** tones
    assert independent < false_alarm_probability(threshold, delay_length(tones)) < 8 * independent


@pytest.mark.parametrize("false_alarm", [0.3, 0.05])
def test_noise_exceeds_the_threshold_as_often_as_stated(false_alarm: float) -> None:
    """The maximum of 16-fold oversampled noise spectra exceeds the threshold at the stated rate."""
    rng = np.random.default_rng(4)
    tones, trials = 128, 6000
    noise = np.sqrt(0.5) * (rng.normal(size=(trials, tones)) + 1j * rng.normal(size=(trials, tones)))
    spectrum = scipy.fft.fft(noise, 16 * tones, axis=1)
    peak = np.max(np.abs(spectrum) ** 2, axis=1) / tones
    rate = np.mean(peak > detection_threshold(false_alarm, delay_length(tones)))
    deviation = np.sqrt(false_alarm * (1.0 - false_alarm) / trials)
    # The formula is a bound; it was found less than 3 % above the truth at a rate of 0.3.
    assert -4.0 * deviation - 0.03 * false_alarm < rate - false_alarm < 4.0 * deviation


@pytest.mark.parametrize("false_alarm", [0.0, 0.6, np.nan])
def test_bad_probabilities_are_refused(false_alarm: float) -> None:
    """A false-alarm probability outside (0, 0.5] is a configuration error that shows the value."""
    with pytest.raises(ConfigurationError, match=r"expected a probability in \(0, 0.5\]"):
        detection_threshold(false_alarm, delay_length(100))


def test_delays_and_directions_together() -> None:
    """Noise over delays and the directions of an antenna array: the two-dimensional rate holds."""
    rng = np.random.default_rng(5)
    tones, elements, trials, false_alarm = 24, 12, 3000, 0.1
    shape = (trials, tones, elements)
    noise = np.sqrt(0.5) * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    spectrum = scipy.fft.fft2(noise, (6 * tones, 6 * elements))  # all delays, all sines of angles
    peak = np.max(np.abs(spectrum) ** 2, axis=(1, 2)) / (tones * elements)
    threshold = detection_threshold(false_alarm, delay_length(tones), delay_length(elements))
    rate = np.mean(peak > threshold)
    deviation = np.sqrt(false_alarm * (1.0 - false_alarm) / trials)
    # The grid misses up to 0.1 dB of a peak, about a sixth of the crossings.
    assert -4.0 * deviation - 0.17 * false_alarm < rate - false_alarm < 4.0 * deviation


def test_bad_levels_and_lengths_are_refused() -> None:
    """Thresholds must be positive, lengths not negative, and one tone has no delay."""
    with pytest.raises(InputError, match="threshold: expected a positive number, got -1"):
        false_alarm_probability(-1.0, 10.0)
    with pytest.raises(InputError, match="lengths: expected 0 or more, got -2"):
        false_alarm_probability(1.0, 10.0, -2.0)
    with pytest.raises(InputError, match="lengths: expected 0 or more, got nan"):
        detection_threshold(0.1, np.nan)
    with pytest.raises(InputError, match="tones: expected at least 2, got 1"):
        delay_length(1)
