"""Walls from the ranges of single beams."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.arrays import BeamSet
from estimator.errors import ConfigurationError
from estimator.sensing.beam_ranges import BeamRangeConfig, beam_ranges, walls_of_beams
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

GRID = OfdmGrid(28e9, 120e3, 3276, comb=4)
WALLS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
DISTANCES = np.array([25.0, 12.0, 9.0, 15.0])


def pencil_sweep(beams, rng):
    """One echo per beam, from where its axis meets the nearest wall of a rectangle; noise of 1e-4."""
    axis = np.stack([np.cos(beams.azimuths()), np.sin(beams.azimuths())], axis=1)
    towards = axis @ WALLS.T
    hits = np.where(towards > 1e-9, DISTANCES / np.maximum(towards, 1e-9), np.inf)
    distance = hits.min(axis=1)
    turns = 2.0 * distance[:, None] / SPEED_OF_LIGHT_M_S * GRID.offsets_hz()
    noise = rng.standard_normal((2, len(distance), GRID.tones)) * np.sqrt(0.5e-4)
    return np.exp(-2j * np.pi * turns) + noise[0] + 1j * noise[1], distance


def test_every_beam_gives_the_range_of_its_wall():
    """Ranges of strong single returns are right to a centimetre; what is claimed covers more."""
    beams = BeamSet()
    echo, distance = pencil_sweep(beams, np.random.default_rng(1))
    found, std, beam = beam_ranges(echo, 1e-4, GRID)
    assert np.array_equal(beam, np.arange(64))
    assert np.abs(found - distance).max() < 0.01
    assert np.all(std >= 0.2)


def test_a_rectangle_is_four_walls():
    """All walls of a rectangle are found, none else, within what their covariances allow."""
    beams = BeamSet()
    echo, _ = pencil_sweep(beams, np.random.default_rng(2))
    walls = walls_of_beams(echo, 1e-4, GRID, beams)
    assert len(walls) == 4
    truth = 2.0 * DISTANCES[:, None] * WALLS
    for wall in walls:
        gaps = truth - wall.mean_m
        nearest = gaps[np.argmin(np.linalg.norm(gaps, axis=1))]
        assert nearest @ np.linalg.solve(wall.covariance_m2, nearest) < 16.0
        assert np.linalg.norm(nearest) < 2.0


def test_noise_alone_gives_no_wall():
    """Without returns there are no ranges and no walls."""
    rng = np.random.default_rng(3)
    noise = (rng.standard_normal((64, GRID.tones)) + 1j * rng.standard_normal((64, GRID.tones))) * 1e-2
    assert walls_of_beams(noise, 2e-4, GRID, BeamSet()) == ()


def test_settings_are_checked():
    """Claims of zero are refused."""
    with pytest.raises(ConfigurationError, match="range_std_m: expected a positive number"):
        BeamRangeConfig(range_std_m=0.0)
