"""One path on 200 tones: NOMP against the bound and against maximum likelihood, down to the threshold."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import pytest
import scipy.fft

from estimator.channel.bounds import range_variance
from estimator.channel.nomp import NompConfig, estimate_delays
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

GRID = OfdmGrid(28e9, 120e3, 200)
ONE_PATH = NompConfig(false_alarm=0.5, max_paths=1, floor_m=0.0)
SEED = int(os.environ.get("HAPSLAM_TEST_SEED", "7"))
HALF_LIGHT = 0.5 * SPEED_OF_LIGHT_M_S
REACH_M = HALF_LIGHT * GRID.unambiguous_s


def wrapped(error_m: np.ndarray) -> np.ndarray:
    return (error_m + 0.5 * REACH_M) % REACH_M - 0.5 * REACH_M


def most_likely(cfr: np.ndarray) -> np.ndarray:
    """Delays in turns at the periodogram's maximum: a 32-fold grid, then the vertex of a parabola."""
    bins = 32 * GRID.tones
    found = []
    for part in np.array_split(cfr, -(-len(cfr) // 500)):
        power = np.abs(scipy.fft.ifft(part, bins, axis=1)) ** 2
        peak = np.argmax(power, axis=1)
        left, middle, right = (power[np.arange(len(part)), (peak + d) % bins] for d in (-1, 0, 1))
        found.append((peak + 0.5 * (left - right) / (left - 2.0 * middle + right)) / bins)
    return np.concatenate(found)


def errors(snr_db: float, runs: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Range errors of NOMP and of maximum likelihood on the same data, metres, and the bound's deviation."""
    rng = np.random.default_rng([SEED, 77, round(1000 + 10 * snr_db)])
    noise = 10.0 ** (-0.1 * snr_db)
    range_m = rng.uniform(20.0, 400.0, runs)
    phase = np.exp(2j * np.pi * rng.uniform(size=runs))
    clean = phase[:, None] * np.exp(-2j * np.pi * (range_m / HALF_LIGHT)[:, None] * GRID.offsets_hz())
    cfr = clean + np.sqrt(0.5 * noise) * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
    nomp = np.empty(runs)
    for first in range(0, runs, 256):
        for i, e in enumerate(estimate_delays(cfr[first : first + 256], noise, GRID, ONE_PATH), first):
            nomp[i] = HALF_LIGHT * e.delay_s[0] - range_m[i] if len(e) else 0.5 * REACH_M
    likeliest = REACH_M * most_likely(cfr) - range_m
    bound = float(np.sqrt(range_variance(GRID, 1.0 / noise, two_way=True)))
    return wrapped(nomp), wrapped(likeliest), bound


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def threshold_db(ratio: np.ndarray, snr_db: np.ndarray, level: float = 2.0) -> float:
    """SNR at which the RMSE over the bound falls below a level, interpolated."""
    last = int(np.flatnonzero(ratio > level)[-1])
    over, under = np.log(ratio[last] / level), np.log(ratio[last + 1] / level)
    return float(snr_db[last] + over / (over - under) * (snr_db[last + 1] - snr_db[last]))


def test_one_path_is_as_good_as_maximum_likelihood() -> None:
    """From -8 dB up at the bound; at -10 dB, within the threshold, as few outliers as maximum likelihood."""
    runs = 1500
    mc = 4.0 / np.sqrt(2.0 * runs)
    for snr_db in (-7.0, 5.0):
        nomp, _, bound = errors(snr_db, runs)
        assert rms(nomp) < (1.05 + mc) * bound
    nomp, likeliest, bound = errors(-11.0, runs)
    lost = [int(np.sum(np.abs(error) > 10.0 * bound)) for error in (nomp, likeliest)]
    assert lost[1] > 10
    assert lost[0] <= lost[1] + 4.0 * np.sqrt(lost[1])


@pytest.mark.soak
def test_one_path_in_ten_thousand_runs(record_property: Callable[[str, object], None]) -> None:
    """RMSE <= 1.05 of the bound from -8 dB up; the threshold is within 1 dB of maximum likelihood's."""
    runs, snr_db = 10_000, np.arange(-14.0, 1.0)
    table = [errors(float(snr), runs) for snr in snr_db]
    nomp, likeliest = (np.array([rms(row[which]) / row[2] for row in table]) for which in (0, 1))
    columns = zip(snr_db, nomp, likeliest, strict=True)
    record_property("rmse_over_bound", [f"{s:.0f} dB: {a:.3f}, ML {b:.3f}" for s, a, b in columns])
    assert np.all(nomp[snr_db >= -8.0] <= 1.05)
    assert threshold_db(nomp, snr_db) <= threshold_db(likeliest, snr_db) + 1.0
