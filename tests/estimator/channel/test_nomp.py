"""NOMP against the Cramer-Rao bound, its stated false-alarm rate, and its own rules."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from estimator.channel.bounds import joint_delay_variance, range_variance
from estimator.channel.model import delay_atoms
from estimator.channel.nomp import DelayEstimate, NompConfig, NompPlan, estimate_delays
from estimator.errors import ConfigurationError, InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

GRID = OfdmGrid(28e9, 120e3, 200)
NO_FLOOR = NompConfig(floor_m=0.0)
SEED = int(os.environ.get("HAPSLAM_TEST_SEED", "7"))


def noisy(
    rng: np.random.Generator, grid: OfdmGrid, delay: np.ndarray, gain: np.ndarray, noise: float
) -> np.ndarray:
    """CFRs (C, tones) of paths (C, K) in noise."""
    cfr = np.einsum("ck,ckn->cn", gain, delay_atoms(grid, delay))
    return cfr + np.sqrt(0.5 * noise) * (rng.normal(size=cfr.shape) + 1j * rng.normal(size=cfr.shape))


def random_gains(rng: np.random.Generator, count: int, amplitudes: list[float]) -> np.ndarray:
    return np.array(amplitudes) * np.exp(2j * np.pi * rng.uniform(size=(count, len(amplitudes))))


def assert_mean_square(values: np.ndarray, slack: float = 0.0, sigmas: float = 4.0) -> None:
    """The mean of squared normalised errors is 1 within its Monte-Carlo error (plus ``slack``)."""
    error = sigmas * np.sqrt(np.var(values) / values.size) + slack
    assert abs(np.mean(values) - 1.0) < error, f"mean {np.mean(values):.3f}, tolerance {error:.3f}"


@pytest.mark.parametrize("snr_db", [-6.0, 0.0, 10.0, 20.0])
def test_single_path_meets_the_bound(snr_db: float) -> None:
    """One path of random delay and phase: the error meets (16), and the claimed variance the error."""
    rng = np.random.default_rng([SEED, int(snr_db) + 100])
    trials, noise = 1500, 10.0 ** (-snr_db / 10.0)
    delay = rng.uniform(1e-7, 2e-6, (trials, 1))
    cfr = noisy(rng, GRID, delay, random_gains(rng, trials, [1.0]), noise)
    estimates = estimate_delays(cfr, noise, GRID, NO_FLOOR)
    assert min(map(len, estimates)) >= 1
    strongest = [int(np.argmax(np.abs(e.gain))) for e in estimates]
    error = np.array([e.delay_s[k] for e, k in zip(estimates, strongest, strict=True)]) - delay[:, 0]
    claimed = np.array([e.variance_s2[k] for e, k in zip(estimates, strongest, strict=True)])
    bound = range_variance(GRID, 1.0 / noise, two_way=True)
    # 5 %: false alarms beside the path, and second-order terms at -6 dB
    assert_mean_square((0.5 * SPEED_OF_LIGHT_M_S * error) ** 2 / bound, slack=0.05)
    # 15 %: the residual's level, averaged over few cells, only ever raises the claim
    assert_mean_square(error**2 / claimed, slack=0.15)


@pytest.mark.parametrize("cells", [0.4, 0.8, 1.5])
def test_two_close_paths_meet_the_joint_bound(cells: float) -> None:
    """Two paths inside or about one resolution cell: both found, no third, errors at the joint bound."""
    rng = np.random.default_rng([SEED, int(10 * cells)])
    trials, noise = 400, 1e-3
    delay = rng.uniform(1e-7, 2e-6, (trials, 1)) + np.array([0.0, cells]) * GRID.resolution_s
    gain = random_gains(rng, trials, [1.0, 0.7])
    estimates = estimate_delays(noisy(rng, GRID, delay, gain, noise), noise, GRID, NO_FLOOR)
    both = np.array([len(e) == 2 for e in estimates])
    assert np.mean(both) > 0.99
    error = np.array([e.delay_s for e in estimates if len(e) == 2]) - delay[both]
    claimed = np.array([e.variance_s2 for e in estimates if len(e) == 2])
    bound = joint_delay_variance(GRID, delay, gain, np.full(trials, noise))[both]
    assert_mean_square(error**2 / bound, slack=0.05)
    assert_mean_square(error**2 / claimed, slack=0.15)


@pytest.mark.parametrize("false_alarm", [0.2, 0.02])
def test_noise_alone_gives_paths_at_the_stated_rate(false_alarm: float) -> None:
    """Channels without paths: the share with a detection is the false-alarm probability."""
    rng = np.random.default_rng([SEED, 3])
    trials = 5000
    cfr = noisy(rng, GRID, np.zeros((trials, 0)), np.zeros((trials, 0)), 2.5)
    estimates = estimate_delays(cfr, 2.5, GRID, NompConfig(false_alarm=false_alarm))
    rate = np.mean([len(e) > 0 for e in estimates])
    assert (
        abs(rate - false_alarm)
        < 4.0 * np.sqrt(false_alarm * (1.0 - false_alarm) / trials) + 0.03 * false_alarm
    )


def crowded(
    rng: np.random.Generator, grid: OfdmGrid, channels: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """CFRs of 10 paths over 27 dB, at least 1.5 cells apart, with delays and gains."""
    cells = np.sort(rng.uniform(10.0, 200.0, (channels, 10)), axis=1) + 1.5 * np.arange(10)
    delay = cells * grid.resolution_s
    gain = rng.permuted(random_gains(rng, channels, list(10.0 ** (-0.05 * 3.0 * np.arange(10)))), axis=1)
    return noisy(rng, grid, delay, gain, 1e-4), delay, gain


def test_crowded_channels_are_taken_apart() -> None:
    """Ten paths over 27 dB: all are found, in ascending order, with honest variances and no extra ones."""
    rng = np.random.default_rng([SEED, 4])
    grid = OfdmGrid(28e9, 120e3, 3276, comb=4)
    cfr, delay, gain = crowded(rng, grid, 64)
    estimates = estimate_delays(cfr, 1e-4, grid, NO_FLOOR)
    whole = np.array([len(e) == 10 for e in estimates])
    assert np.mean(whole) > 0.95
    found = [e for e in estimates if len(e) == 10]
    error = np.array([e.delay_s for e in found]) - delay[whole]
    assert np.all(np.abs(error) < 0.5 * grid.resolution_s)
    assert_mean_square(error**2 / np.array([e.variance_s2 for e in found]), slack=0.15)
    np.testing.assert_allclose(np.array([e.gain for e in found]), gain[whole], atol=0.02)


@pytest.mark.interpreted
def test_dynamic_range_limits_what_is_reported() -> None:
    """Paths beyond the dynamic range are dropped, and do not disturb those reported."""
    rng = np.random.default_rng([SEED, 5])
    delay = np.array([[3e-7, 3e-7 + 1.6 * GRID.resolution_s, 9e-7]])
    gain = random_gains(rng, 1, [1.0, 0.028, 0.05])  # 0, -31 and -26 dB
    cfr = noisy(rng, GRID, delay, gain, 1e-7)
    (estimate,) = estimate_delays(cfr, 1e-7, GRID, NO_FLOOR)
    np.testing.assert_allclose(estimate.delay_s, delay[0, [0, 2]], atol=1e-3 * GRID.resolution_s)
    (wide,) = estimate_delays(cfr, 1e-7, GRID, NompConfig(dynamic_range_db=40.0))
    assert len(wide) == 3
    (narrow,) = estimate_delays(cfr, 1e-7, GRID, NompConfig(max_paths=1))
    assert len(narrow) == 1


def test_floor_is_added_to_the_bound() -> None:
    """The floor enters every variance as the square of a path length."""
    rng = np.random.default_rng([SEED, 6])
    cfr = noisy(rng, GRID, np.array([[5e-7]]), np.ones((1, 1)), 1e-3)
    (bare,) = estimate_delays(cfr, 1e-3, GRID, NO_FLOOR)
    (floored,) = estimate_delays(cfr, 1e-3, GRID, NompConfig(floor_m=0.03))
    np.testing.assert_allclose(floored.variance_s2 - bare.variance_s2, (0.03 / SPEED_OF_LIGHT_M_S) ** 2)


def test_unresolved_energy_widens_the_claim() -> None:
    """A diffuse cluster that the pursuit may not resolve raises the variance of the path inside it."""
    rng = np.random.default_rng([SEED, 8])
    delay = np.concatenate([[5e-7], 5e-7 + rng.uniform(-3.0, 3.0, 40) * GRID.resolution_s, [12e-7]])[None]
    gain = random_gains(rng, 1, [1.0] + [0.02] * 40 + [1.0])
    (estimate,) = estimate_delays(
        noisy(rng, GRID, delay, gain, 1e-6), 1e-6, GRID, NompConfig(floor_m=0.0, max_paths=2)
    )
    assert estimate.variance_s2[0] > 5.0 * estimate.variance_s2[1]


@pytest.mark.interpreted
@pytest.mark.parametrize("tones", [199, 200])
def test_delays_around_the_turn_keep_delay_and_gain(tones: int) -> None:
    """A delay just above zero or below the longest is reported in range, and its atom fits the data."""
    grid = OfdmGrid(28e9, 120e3, tones)
    rng = np.random.default_rng([SEED, 9])
    delay = np.array([[1e-10], [grid.unambiguous_s - 1e-10]])
    gain = random_gains(rng, 2, [1.0])
    estimates = estimate_delays(noisy(rng, grid, delay, gain, 1e-8), 1e-8, grid, NO_FLOOR)
    for estimate, tau, g in zip(estimates, delay[:, 0], gain[:, 0], strict=True):
        assert estimate.delay_s[0] == pytest.approx(tau, abs=1e-12)
        np.testing.assert_allclose(estimate.gain, [g], atol=1e-3)


def test_same_input_gives_the_same_bits() -> None:
    """Two runs agree bit for bit, and a channel does not depend on its companions beyond rounding."""
    rng = np.random.default_rng([SEED, 10])
    cfr, _, _ = crowded(rng, GRID, 8)
    plan = NompPlan(GRID)
    first, second = plan.estimate(cfr, 1e-4), plan.estimate(cfr, 1e-4)
    for a, b in zip(first, second, strict=True):
        for name in ("delay_s", "gain", "variance_s2"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    alone: DelayEstimate = plan.estimate(cfr[3:4], 1e-4)[0]
    np.testing.assert_allclose(alone.delay_s, first[3].delay_s, rtol=1e-9)


def test_noise_variance_may_differ_between_channels() -> None:
    """A variance per channel is used for that channel alone."""
    rng = np.random.default_rng([SEED, 11])
    delay, gain = np.full((2, 1), 4e-7), np.ones((2, 1))
    cfr = np.repeat(noisy(rng, GRID, delay[:1], gain[:1], 1e-2), 2, axis=0)
    loud, quiet = estimate_delays(cfr, np.array([100.0, 1e-2]), GRID)
    assert (len(loud), len(quiet)) == (0, 1)


def test_an_empty_batch_is_no_error() -> None:
    """No channels in, no estimates out."""
    assert estimate_delays(np.zeros((0, GRID.tones)), 1.0, GRID) == []


def test_an_819_tone_channel_takes_less_than_10_ms() -> None:
    """Sixty-four crowded 819-tone channels, one by one and together: far below 10 ms each (1 ms measured)."""
    grid = OfdmGrid(28e9, 120e3, 3276, comb=4)
    cfr, _, _ = crowded(np.random.default_rng([SEED, 12]), grid, 64)
    plan = NompPlan(grid)
    plan.estimate(cfr[:1], 1e-4)  # compiled or loaded
    start = time.process_time()
    together = plan.estimate(cfr, 1e-4)
    assert (time.process_time() - start) / 64 < 0.01
    start = time.process_time()
    alone = [plan.estimate(each[None], 1e-4)[0] for each in cfr]
    assert (time.process_time() - start) / 64 < 0.01
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_array_equal(one.delay_s, other.delay_s)


def test_bad_channels_are_refused() -> None:
    """Wrong shapes, values that are not finite and variances that are not positive: what came is named."""
    good = np.zeros((2, GRID.tones), dtype=complex)
    with pytest.raises(InputError, match=r"expected shape \(n, 200\), got \(2, 7\)"):
        estimate_delays(good[:, :7], 1.0, GRID)
    bad = good.copy()
    bad[1, 5] = np.nan
    with pytest.raises(InputError, match=r"got \(?nan.* in row 1, tone 5"):
        estimate_delays(bad, 1.0, GRID)
    with pytest.raises(InputError, match=r"noise_variance: expected positive numbers, got 0\.0"):
        estimate_delays(good, 0.0, GRID)
    with pytest.raises(InputError, match=r"noise_variance: expected a number or shape \(2,\), got \(3,\)"):
        estimate_delays(good, np.ones(3), GRID)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("false_alarm", 0.0),
        ("dynamic_range_db", -1.0),
        ("margin_db", np.nan),
        ("floor_m", np.inf),
        ("closest_cells", 0.0),
        ("max_paths", 0),
        ("oversampling", 1),
        ("newton_steps", 0),
        ("cycles", 0),
        ("polish_steps", -1),
        ("final_steps", -1),
    ],
)
def test_bad_settings_are_refused(name: str, value: float) -> None:
    """Every setting is checked when the configuration is made, and named in the message."""
    with pytest.raises(ConfigurationError, match=name):
        NompConfig(**{name: value})


def test_a_measured_channel_has_variances_that_can_be_believed() -> None:
    """A measured CFR of dense paths: all variances positive, none beyond that of a delay not known at all."""
    file = Path(__file__).parents[4] / "shared/benchmarks/measured/uwb-cirs-2018/negative-variance.npz"
    if not file.exists():
        pytest.skip(f"no measured channel: {file} is not there")
    measured = np.load(file)
    grid = OfdmGrid(3993.6e6, 998.4e6 / 128, 61)
    (found,) = estimate_delays(measured["cfr"][None], float(measured["noise_variance"]), grid)
    assert len(found) > 0
    assert np.all(found.variance_s2 > 0.0)
    assert np.all(found.variance_s2 <= 1.001 / 12.0 / grid.tone_spacing_hz**2)
