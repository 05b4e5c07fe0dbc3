"""Paths in front of diffuse tails: against their bound given the tail, false alarms, measured links."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from estimator.channel.coloured import fit_gains
from estimator.channel.diffuse import DiffuseConfig, DiffusePlan
from estimator.channel.model import tone_atoms
from estimator.channel.tail import TailConfig, TailProfile, tail_column
from estimator.channel.toeplitz import whiten
from estimator.errors import ConfigurationError, InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

TONES = 61
GRID = OfdmGrid(6e9, 7.8e6, TONES)
NO_FLOOR = DiffuseConfig(floor_m=0.0)
SEED = int(os.environ.get("HAPSLAM_TEST_SEED", "7"))
CELL_S = GRID.resolution_s


def channels(
    rng: np.random.Generator, count: int, profile: TailProfile, gain: float, delay: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """CFRs (C, tones) of a path of random phase and a tail that begins with it, and its delay's bound."""
    cfr, bound = [], []
    for turns in delay * GRID.tone_spacing_hz:
        column = tail_column(profile._replace(onset=turns), TONES)
        lower = np.linalg.cholesky(scipy.linalg.toeplitz(column))
        drawn = rng.normal(size=(2, TONES)) / np.sqrt(2.0)
        atom = tone_atoms(np.array([turns]), TONES)[0]
        path = gain * np.exp(2j * np.pi * rng.uniform())
        cfr.append(path * atom + lower @ (drawn[0] + 1j * drawn[1]))
        slope = -2j * np.pi * (np.arange(TONES) - 0.5 * (TONES - 1)) * atom
        white, moved = whiten(column, np.stack([atom, slope])).values
        moved = moved - white * np.vdot(white, moved) / np.vdot(white, white)
        bound.append(0.5 / (gain**2 * np.vdot(moved, moved).real) / GRID.tone_spacing_hz**2)
    assert len(cfr) == count
    return np.array(cfr), np.array(bound)


@pytest.mark.parametrize("known", [True, False])
def test_a_path_before_its_tail_meets_the_bound_given_the_tail(known: bool) -> None:
    """A path as strong as the tail, 25 dB over the noise: RMSE within 1.1 of the bound, honest claims."""
    rng, runs = np.random.default_rng([SEED, 1]), 300
    profile = TailProfile(1.0, 300.0, 0.0, 8.0 / TONES)
    delay = rng.uniform(0.1, 0.5, runs) / GRID.tone_spacing_hz
    cfr, bound = channels(rng, runs, profile, np.sqrt(300.0), delay)
    found = DiffusePlan(GRID, NO_FLOOR).estimate(cfr, 1.0 if known else None)
    first = [int(np.argmin(np.abs(e.delay_s - d))) for e, d in zip(found, delay, strict=True)]
    error = np.array([e.delay_s[k] for e, k in zip(found, first, strict=True)]) - delay
    claimed = np.array([e.variance_s2[k] for e, k in zip(found, first, strict=True)])
    spread = 4.0 * np.std(error**2) / np.sqrt(runs) / np.mean(error**2)
    assert np.mean(error**2) <= 1.1**2 * np.mean(bound) * (1.0 + spread)
    assert 0.6 < np.mean(error**2 / claimed) < 1.7
    assert np.mean([len(e) for e in found]) < 1.0 + 4.0 * NO_FLOOR.false_alarm
    decay = [e.tail.decay_s for e in found if e.tail is not None]
    assert np.median(decay) == pytest.approx(8.0 * CELL_S, rel=0.1)


def test_noise_alone_gives_paths_at_the_stated_rate() -> None:
    """Without paths and tail: the share of channels with a path is the false-alarm probability."""
    rng, runs = np.random.default_rng([SEED, 2]), 1000
    cfr = rng.normal(size=(runs, TONES)) + 1j * rng.normal(size=(runs, TONES))
    found = DiffusePlan(GRID, replace(NO_FLOOR, false_alarm=0.1)).estimate(cfr, 2.0)
    rate = np.mean([len(e) > 0 for e in found])
    assert abs(rate - 0.1) < 4.0 * np.sqrt(0.09 / runs) + 0.01


def test_later_paths_stand_out_of_the_tail() -> None:
    """Two further paths 20 dB over the tail where they arrive: found, and nothing else."""
    rng, runs = np.random.default_rng([SEED, 3]), 60
    profile = TailProfile(1.0, 100.0, 0.0, 10.0 / TONES)
    delay = np.full(runs, 8.0 * CELL_S)
    cfr, _ = channels(rng, runs, profile, 20.0, delay)
    later = np.array([6.0, 15.0])
    level = 100.0 * TONES / 10.0 * np.exp(-later / 10.0)  # of the tail's correlation, per sample
    gain = np.sqrt(100.0 * level / TONES)
    cfr += gain @ tone_atoms((8.0 + later) / TONES, TONES)
    found = DiffusePlan(GRID).estimate(cfr, 1.0)
    for place in (8.0, 14.0, 23.0):
        near = [np.min(np.abs(e.delay_s / CELL_S - place)) < 0.5 for e in found]
        assert np.mean(near) > 0.9, place
    assert np.mean([len(e) for e in found]) < 3.1


def test_one_path_alone_is_that_of_white_noise() -> None:
    """No tail is made up of one path in noise: its delay is at the bound."""
    rng, runs = np.random.default_rng([SEED, 4]), 300
    delay = rng.uniform(0.1, 0.9, runs) / GRID.tone_spacing_hz
    cfr, bound = channels(rng, runs, TailProfile(1.0), 3.0, delay)
    found = DiffusePlan(GRID, NO_FLOOR).estimate(cfr, 1.0)
    assert np.mean([e.tail is not None and e.tail.power > 0.0 for e in found]) < 0.02
    error = np.array([e.delay_s[np.argmax(np.abs(e.gain))] for e in found]) - delay
    normalised = error**2 / bound
    assert abs(np.mean(normalised) - 1.0) < 4.0 * np.std(normalised) / np.sqrt(runs) + 0.05


def test_a_late_false_alarm_does_not_take_the_tail() -> None:
    """A weak path in the noise behind the tail, nearer to the next turn's: the strong first one stays."""
    rng, runs = np.random.default_rng([SEED, 8]), 100
    profile = TailProfile(1.0, 100.0, 0.0, 6.0 / TONES)
    cfr, _ = channels(rng, runs, profile, 10.0, np.full(runs, 10.0 * CELL_S))
    cfr += 1.0 * tone_atoms(np.array([50.0 / TONES]), TONES)[0]
    found = DiffusePlan(GRID).estimate(cfr, 1.0)
    near = [np.min(np.abs(e.delay_s / CELL_S - 10.0)) < 0.5 for e in found]
    assert np.mean(near) == 1.0
    late = [np.min(np.abs(e.delay_s / CELL_S - 50.0)) < 0.5 for e in found]
    assert np.mean(late) > 0.9


def test_gains_of_given_delays_are_weighted_least_squares() -> None:
    """Against the dense normal equations; the significance is what a path's removal costs."""
    rng = np.random.default_rng([SEED, 5])
    profile, turns = TailProfile(1.0, 50.0, 0.2, 0.1), np.array([0.2, 0.23, 0.5])
    column, atoms = tail_column(profile, TONES), tone_atoms(turns, TONES)
    cfr = np.array([5.0, -3j, 2.0]) @ atoms + rng.normal(size=TONES) + 1j * rng.normal(size=TONES)
    found, inverse = fit_gains(cfr, turns, column), np.linalg.inv(scipy.linalg.toeplitz(column))
    wanted = np.linalg.solve(np.conj(atoms) @ inverse @ atoms.T, np.conj(atoms) @ inverse @ cfr)
    np.testing.assert_allclose(found.gain, wanted, rtol=1e-8)
    for k in range(3):
        fewer = fit_gains(cfr, np.delete(turns, k), column)
        assert found.significance[k] == pytest.approx(fewer.energy - found.energy)


def test_delays_around_the_turn_keep_delay_and_gain() -> None:
    """Just below the longest delay, with an even number of tones: the atom reported fits the data."""
    grid = OfdmGrid(6e9, 7.8e6, 60)
    turns = np.array([1.0 - 1e-4])
    cfr = (2.0 - 1j) * tone_atoms(turns, 60)
    rng = np.random.default_rng([SEED, 6])
    cfr = cfr + 1e-4 * (rng.normal(size=cfr.shape) + 1j * rng.normal(size=cfr.shape))
    (found,) = DiffusePlan(grid).estimate(cfr, 2e-8)
    assert found.delay_s[0] == pytest.approx(turns[0] / grid.tone_spacing_hz, abs=1e-3 * grid.resolution_s)
    np.testing.assert_allclose(found.gain, [2.0 - 1j], atol=1e-3)


def test_measured_links_claim_what_can_be_believed() -> None:
    """36 measured links: no negative variance, <= 3 % of paths claim a metre, <= 5 % of pairs half a cell."""
    file = Path(__file__).parents[4] / "shared/benchmarks/measured/uwb-cirs-2018/cir.npz"
    if not file.exists():
        pytest.skip(f"no measured responses: {file} is not there")
    data = np.load(file)
    cir, edge = data["cir"][::10, :, 0] + 1j * data["cir"][::10, :, 1], data["first_path_tap"][::10]
    first = np.floor(edge).astype(int) - 16
    taps = np.array([row[k : k + 128] for row, k in zip(cir, first, strict=True)])
    cfr = np.fft.fftshift(np.fft.fft(taps, axis=1), axes=1)[:, 64 - 30 : 64 + 31]
    found = DiffusePlan(OfdmGrid(3993.6e6, 998.4e6 / 128, TONES)).estimate(cfr)
    std_m = SPEED_OF_LIGHT_M_S * np.sqrt(np.concatenate([e.variance_s2 for e in found]))
    gap = np.concatenate([np.diff(e.delay_s) for e in found]) * 476e6
    assert min(map(len, found)) >= 1
    assert np.all(std_m > 0.0)
    assert np.mean(std_m > 1.0) <= 0.03
    assert np.mean(gap < 0.5) <= 0.05
    los = np.array([label == "LOS" for label in data["label"][data["link"][::10] - 1]])
    place = (
        SPEED_OF_LIGHT_M_S * (np.array([e.delay_s[0] for e in found]) + (first - edge) / 998.4e6)
        + data["range_m"][::10]
    )
    scatter = [np.std(place[data["link"][::10] == k]) for k in np.unique(data["link"][::10][los])]
    assert np.median(scatter) < 0.06


def test_mistakes_are_told() -> None:
    """Shapes, variances, grids and settings that cannot be meant."""
    plan = DiffusePlan(GRID)
    assert plan.estimate(np.zeros((0, TONES))) == []
    with pytest.raises(InputError, match=r"expected shape \(n, 61\), got \(2, 7\)"):
        plan.estimate(np.ones((2, 7)))
    with pytest.raises(InputError, match="expected one snapshot"):
        plan.estimate(np.ones((2, 3, TONES)))
    with pytest.raises(InputError, match=r"expected finite numbers, got \(?nan"):
        plan.estimate(np.full((1, TONES), np.nan))
    with pytest.raises(InputError, match="expected positive numbers, got 0"):
        plan.estimate(np.ones((1, TONES)), 0.0)
    with pytest.raises(ConfigurationError, match="at least 16 tones"):
        DiffusePlan(OfdmGrid(6e9, 1e6, 8))
    for name in (
        "false_alarm",
        "dynamic_range_db",
        "forerunner_db",
        "floor_m",
        "closest_cells",
        "max_paths",
        "oversampling",
    ):
        with pytest.raises(ConfigurationError, match=name):
            DiffuseConfig(**{name: -1})
    for name in ("evidence", "onset_evidence", "shortest_cells", "longest_turns", "tolerance", "steps"):
        with pytest.raises(ConfigurationError, match=name):
            TailConfig(**{name: 0})
