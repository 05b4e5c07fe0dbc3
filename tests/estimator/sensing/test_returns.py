"""The pursuit of returns against its bound, its false-alarm rate and its own limits."""

from __future__ import annotations

import os

import numpy as np
import pytest

from estimator.arrays import BeamSet
from estimator.channel.model import delay_atoms
from estimator.errors import ConfigurationError, InputError
from estimator.sensing.ranges import sweep_response
from estimator.sensing.returns import EchoPursuit, PursuitConfig
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

GRID = OfdmGrid(28e9, 480e3, 128)  # 61 MHz: cells of 2.4 m, ranges to 312 m
BEAMS = BeamSet(panels=4, elements=6, beams=24, heading_rad=0.1)
ANY_GAIN = PursuitConfig(min_reflectivity_db=-200.0)
SEED = int(os.environ.get("HAPSLAM_TEST_SEED", "11"))


def mirror_gain(range_m: float) -> float:
    """Gain of a perfect mirror at normal incidence, between isotropic antennas."""
    return GRID.wavelength_m / (8.0 * np.pi * range_m)


def echo_of(ranges_m: list[float], azimuths_rad: list[float], gains: list[complex]) -> np.ndarray:
    """Noiseless echo of point returns, (beams, tones)."""
    patterns = BEAMS.two_way(np.array(azimuths_rad)).T * np.array(gains)
    return np.asarray(patterns @ delay_atoms(GRID, 2.0 * np.array(ranges_m) / SPEED_OF_LIGHT_M_S))


def noise(rng: np.random.Generator, variance: float) -> np.ndarray:
    shape = (BEAMS.beams, GRID.tones)
    return np.sqrt(0.5 * variance) * (rng.normal(size=shape) + 1j * rng.normal(size=shape))


@pytest.mark.parametrize("trials", [50, pytest.param(300, marks=pytest.mark.soak)])
def test_errors_meet_the_bound(trials: int) -> None:
    """Range and azimuth of two returns: normalised errors have the size that the covariance claims."""
    rng = np.random.default_rng([SEED, 1])
    pursuit = EchoPursuit(GRID, BEAMS, ANY_GAIN)
    squares = []
    for _ in range(trials):
        ranges = [rng.uniform(8.0, 12.0), rng.uniform(30.0, 50.0)]
        azimuths = rng.uniform(-np.pi, np.pi, 2)
        gains = [0.4 * mirror_gain(r) * np.exp(2j * np.pi * rng.uniform()) for r in ranges]
        variance = np.abs(gains[1]) ** 2 * 10.0
        found = pursuit.find(echo_of(ranges, list(azimuths), gains) + noise(rng, variance), variance)
        assert len(found) >= 2
        for r, azimuth in zip(ranges, azimuths, strict=True):
            k = int(np.argmin(np.abs(found.range_m - r)))
            turned = np.angle(np.exp(1j * (found.azimuth_rad[k] - azimuth)))
            error = np.array([found.range_m[k] - r, turned])
            squares.append(error @ np.linalg.solve(found.covariance[k], error) / 2.0)
    deviation = np.sqrt(np.var(squares) / len(squares))
    assert abs(np.mean(squares) - 1.0) < 4.0 * deviation + 0.05


def test_gain_and_order() -> None:
    """Gains, reflectivities and powers are those put in, and the strongest return comes first."""
    ranges, azimuths = [40.0, 10.0], [2.0, -1.0]
    gains = [0.5 * mirror_gain(40.0), 0.25j * mirror_gain(10.0)]
    rng = np.random.default_rng([SEED, 2])
    found = EchoPursuit(GRID, BEAMS).find(echo_of(ranges, azimuths, gains) + noise(rng, 1e-16), 1e-16)
    np.testing.assert_allclose(found.range_m, [10.0, 40.0], atol=0.02)
    np.testing.assert_allclose(found.azimuth_rad, [-1.0, 2.0], atol=0.002)
    np.testing.assert_allclose(found.gain, gains[::-1], rtol=0.1)
    np.testing.assert_allclose(found.reflectivity_db, 20.0 * np.log10([0.25, 0.5]), atol=0.3)
    power = [np.linalg.norm(g * BEAMS.two_way(a)) for g, a in zip(gains[::-1], azimuths[::-1], strict=True)]
    np.testing.assert_allclose(found.power_db, 20.0 * np.log10(power), atol=0.3)


@pytest.mark.parametrize("trials", [150, pytest.param(600, marks=pytest.mark.soak)])
def test_noise_alone_gives_returns_at_the_stated_rate(trials: int) -> None:
    """Sweeps without returns: false alarms over all ranges and azimuths come at the stated rate."""
    rng = np.random.default_rng([SEED, 3])
    stated = 0.2
    config = PursuitConfig(
        false_alarm=stated, min_reflectivity_db=-300.0, blind_range_m=0.0, max_returns=1, oversampling=6
    )
    pursuit = EchoPursuit(GRID, BEAMS, config)
    rate = np.mean([len(pursuit.find(noise(rng, 3.0), 3.0)) > 0 for _ in range(trials)])
    deviation = np.sqrt(stated * (1.0 - stated) / trials)
    # The grid of azimuths and delays misses part of a peak, and with it up to a third of the alarms.
    assert -4.0 * deviation - 0.33 * stated < rate - stated < 4.0 * deviation


def test_near_clutter_is_blanked() -> None:
    """A return 30 dB above a wall's, from within the blind range and any direction, leaves the wall alone."""
    rng = np.random.default_rng([SEED, 4])
    wall = echo_of([30.0], [0.7], [0.4 * mirror_gain(30.0)])
    pattern = rng.normal(size=(BEAMS.beams, 1)) + 1j * rng.normal(size=(BEAMS.beams, 1))
    near = 30.0 * np.abs(wall).max() * pattern * delay_atoms(GRID, np.array([2.0 * 0.1 / SPEED_OF_LIGHT_M_S]))
    found = EchoPursuit(GRID, BEAMS).find(wall + near + noise(rng, 1e-16), 1e-16)
    assert len(found) == 1
    assert found.range_m[0] == pytest.approx(30.0, abs=0.05)
    assert found.azimuth_rad[0] == pytest.approx(0.7, abs=0.005)


def test_implausibly_weak_returns_are_not_pursued() -> None:
    """A return far above the noise and 40 dB below a mirror's is no wall; with other settings it is found."""
    rng = np.random.default_rng([SEED, 5])
    echo = echo_of([20.0], [0.2], [0.01 * mirror_gain(20.0)]) + noise(rng, 1e-18)
    assert len(EchoPursuit(GRID, BEAMS).find(echo, 1e-18)) == 0
    assert len(EchoPursuit(GRID, BEAMS, ANY_GAIN).find(echo, 1e-18)) == 1


def test_same_sweep_gives_the_same_bits() -> None:
    """Two runs on one sweep agree bit for bit."""
    rng = np.random.default_rng([SEED, 6])
    echo = echo_of([10.0, 25.0], [0.2, 1.9], [mirror_gain(10.0), mirror_gain(25.0)]) + noise(rng, 1e-12)
    first, second = (EchoPursuit(GRID, BEAMS).find(echo, 1e-12) for _ in range(2))
    for name in ("range_m", "azimuth_rad", "gain", "covariance"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_bad_sweeps_are_refused() -> None:
    """Wrong shapes, numbers that are not finite and variances that are not positive are named."""
    pursuit = EchoPursuit(GRID, BEAMS)
    good = np.zeros((BEAMS.beams, GRID.tones), dtype=complex)
    with pytest.raises(InputError, match=r"echo: expected shape \(24, 128\), got \(23, 128\)"):
        pursuit.find(good[:-1], 1.0)
    bad = good.copy()
    bad[0, 0] = np.inf
    with pytest.raises(InputError, match="echo: expected finite numbers, got"):
        pursuit.find(bad, 1.0)
    with pytest.raises(InputError, match="noise_variance: expected a positive number, got 0"):
        pursuit.find(good, 0.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"false_alarm": 0.0}, "false_alarm"),
        ({"blind_range_m": -1.0}, "expected 0 <= blind < max"),
        ({"max_range_m": 0.1}, "expected 0 <= blind < max"),
        ({"min_reflectivity_db": np.nan}, "min_reflectivity_db"),
        ({"max_returns": 0}, "max_returns"),
        ({"oversampling": 1}, "oversampling"),
        ({"steps": -1}, "steps"),
        ({"final_steps": -1}, "final_steps"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, float], message: str) -> None:
    """Every setting is checked when the configuration is made."""
    with pytest.raises(ConfigurationError, match=message):
        PursuitConfig(**settings)


def test_ranges_end_where_they_become_ambiguous() -> None:
    """The largest range may exceed what the tones can tell; a return short of that is found at its place."""
    rng = np.random.default_rng([SEED, 7])
    pursuit = EchoPursuit(GRID, BEAMS, PursuitConfig(max_range_m=1000.0))
    gain = mirror_gain(300.0)
    found = pursuit.find(echo_of([300.0], [0.4], [gain]) + noise(rng, 0.1 * gain**2), 0.1 * gain**2)
    assert len(found) == 1
    assert found.range_m[0] == pytest.approx(300.0, abs=0.2)


def test_a_blind_range_over_all_ranges_is_refused() -> None:
    """Nothing can be found where everything is blanked."""
    with pytest.raises(ConfigurationError, match="blind_range_m: expected less than the longest range"):
        EchoPursuit(GRID, BEAMS, PursuitConfig(blind_range_m=400.0, max_range_m=500.0))


@pytest.mark.parametrize("first", [1, 64, 100_000])
def test_the_strongest_return_is_found_whichever_delays_are_searched_first(
    first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two returns of one delay have more energy together than the strongest, which still comes first."""
    monkeypatch.setattr("estimator.sensing.returns._RICHEST_DELAYS", first)
    grid, beams = OfdmGrid(28e9, 120e3, 816, comb=4, symbols=14), BeamSet(panels=4, elements=8, beams=32)
    azimuth, distance = np.deg2rad([0.0, 180.0, 90.0]), np.array([12.0, 12.0, 30.0])
    gain = np.array([0.8, 0.8, 1.0]) * grid.wavelength_m / (8.0 * np.pi * 20.0)
    echo = sweep_response(grid, beams, azimuth, distance, gain)
    found = EchoPursuit(grid, beams, PursuitConfig(max_returns=1)).find(
        echo, 1e-3 * np.mean(np.abs(echo) ** 2)
    )
    assert found.range_m == pytest.approx([30.0], abs=0.1)
    assert found.azimuth_rad == pytest.approx([np.pi / 2.0], abs=0.02)


@pytest.mark.filterwarnings("error")
def test_noise_far_below_single_precision_is_no_harm() -> None:
    """The search in single precision neither overflows nor loses a return if hardly any noise is claimed."""
    gain = mirror_gain(5.0)
    for variance in (1e-30, 1e-60):
        found = EchoPursuit(GRID, BEAMS, PursuitConfig(max_returns=1)).find(
            echo_of([5.0], [0.4], [gain]), variance
        )
        assert found.range_m[0] == pytest.approx(5.0, abs=1e-6)
        assert found.azimuth_rad[0] == pytest.approx(0.4, abs=1e-6)
