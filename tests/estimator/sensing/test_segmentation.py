"""Walls found in sweeps of a room, without knowing how many there are."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import vrp_of_line
from estimator.sensing.ranges import EchoLaw, variance_published
from estimator.sensing.segmentation import SegmentationConfig, segment_walls
from estimator.waveform import OfdmGrid

ROOM = np.array(
    [
        [[0.0, 0.0], [0.0, 40.0]],
        [[0.0, 40.0], [50.0, 40.0]],
        [[80.0, 0.0], [80.0, 60.0]],
        [[0.0, 0.0], [80.0, 0.0]],
        [[50.0, 60.0], [80.0, 60.0]],
        [[50.0, 40.0], [50.0, 60.0]],
    ]
)
AZIMUTH = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
WIDE = OfdmGrid(28e9, 120e3, 3276)


def cast(position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ranges, incidences and walls (M,) that pencil beams meet first."""
    towards = np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH)], axis=-1)
    distance, incidence = np.full(64, np.inf), np.zeros(64)
    wall = np.full(64, -1)
    for number, (start, end) in enumerate(ROOM):
        along = end - start
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        reach = ((start - position) @ normal) / (towards @ normal)
        share = (position + reach[:, None] * towards - start) @ along / (along @ along)
        hit = (reach > 0.0) & (share >= 0.0) & (share <= 1.0) & (reach < distance)
        distance[hit], wall[hit] = reach[hit], number
        incidence[hit] = np.arccos(np.abs(towards @ normal))[hit]
    return distance, incidence, wall


@pytest.mark.parametrize(("position", "walls"), [((10.0, 15.0), 4), ((60.0, 30.0), 6)])
def test_all_walls_are_found_among_false_returns(position, walls):
    """Every wall that enough beams meet, no other, NEES near 1; one return in sixteen is false."""
    position = np.array(position)
    distance, incidence, met = cast(position)
    std = np.sqrt(variance_published(WIDE, EchoLaw().at(distance, incidence)))
    truth = vrp_of_line(ROOM[:, 0], ROOM[:, 1], position) - position
    rng = np.random.default_rng(5)
    runs, squares, found = 8, [], 0
    for _ in range(runs):
        measured = distance + std * rng.normal(size=64)
        wrong = rng.choice(64, 4, replace=False)
        measured[wrong] = rng.uniform(1.0, 100.0, 4)
        result = segment_walls(measured, std, AZIMUTH)
        for number, wall in enumerate(result.walls):
            error = wall.mean_m - truth
            square = np.einsum("li,ij,lj->l", error, np.linalg.inv(wall.covariance_m2), error)
            nearest = int(np.argmin(square))
            assert square[nearest] < 25.0
            squares.append(square[nearest] / 2.0)
            beams = np.setdiff1d(np.flatnonzero(result.label == number), wrong)
            assert np.mean(met[beams] == nearest) > 0.8
        found += len(result.walls)
    assert found >= walls * runs - runs // 3  # the shortest wall may lose its beams to false returns
    # a false return near a wall, or the neighbour's at a corner, adds a little to the error
    assert np.mean(squares) == pytest.approx(1.0, abs=4.0 / np.sqrt(len(squares)) + 0.1)


def test_order_of_the_beams_does_not_matter():
    """The same labels and walls when the beams come shuffled, as panels deliver them."""
    distance, incidence, _ = cast(np.array([10.0, 15.0]))
    std = np.sqrt(variance_published(WIDE, EchoLaw().at(distance, incidence)))
    rng = np.random.default_rng(6)
    measured = distance + std * rng.normal(size=64)
    shuffle = rng.permutation(64)
    plain = segment_walls(measured, std, AZIMUTH)
    shuffled = segment_walls(measured[shuffle], std[shuffle], AZIMUTH[shuffle])
    np.testing.assert_array_equal(shuffled.label, plain.label[shuffle])
    for one, other in zip(plain.walls, shuffled.walls, strict=True):
        np.testing.assert_allclose(one.mean_m, other.mean_m, atol=1e-6)


def test_corner_returns_do_not_become_a_wall():
    """Four beams about the corner of two walls hear the corner itself, whose range mimics a wall across."""
    position = np.array([10.0, 15.0])
    distance, incidence, _ = cast(position)
    std = np.maximum(np.sqrt(variance_published(WIDE, EchoLaw().at(distance, incidence))), 0.02)
    corner = -position
    towards = np.arctan2(corner[1], corner[0])
    beams = np.argsort(np.abs(np.angle(np.exp(1j * (AZIMUTH - towards)))))[:4]
    measured = distance + std * np.random.default_rng(7).normal(size=64)
    measured[beams] = np.linalg.norm(corner) / np.cos(AZIMUTH[beams] - towards) + 0.02 * np.array(
        [1, -1, 1, -1]
    )
    result = segment_walls(measured, std, AZIMUTH)
    assert len(result.walls) == 4
    assert set(result.label[beams]) == {-1}
    # without the rule it would be a fifth wall, so the rule is what removes it
    lax = segment_walls(measured, std, AZIMUTH, SegmentationConfig(corner_span_rad=1e-6))
    assert len(lax.walls) == 5


def test_an_interrupted_wall_is_one_wall():
    """A pillar in front of the middle of a wall does not make two walls of it."""
    azimuth = np.deg2rad(np.linspace(-60.0, 60.0, 25))
    distance = 8.0 / np.cos(azimuth)
    distance[10:15] = [3.0, 2.9, 3.2, 3.1, 2.8]
    result = segment_walls(distance, 0.02, azimuth)
    assert len(result.walls) == 1
    np.testing.assert_allclose(result.walls[0].mean_m, [16.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(np.flatnonzero(result.label == -1), np.arange(10, 15))


def test_scattered_returns_make_no_wall():
    """Where false returns are as likely as true ones, chance alignments of three are not believed."""
    rng = np.random.default_rng(9)
    config = SegmentationConfig(outlier_probability=0.5)
    walls = [len(segment_walls(rng.uniform(1.0, 150.0, 64), 0.05, AZIMUTH, config).walls) for _ in range(20)]
    assert sum(walls) <= 1


def test_bad_input_is_named():
    """Shapes and settings out of range."""
    with pytest.raises(InputError, match="at least 3 ranges"):
        segment_walls([1.0, 2.0], 0.1, [0.0, 0.1])
    with pytest.raises(InputError, match="expected shape"):
        segment_walls(np.ones((2, 3)), 0.1, 0.0)
    with pytest.raises(ConfigurationError, match="outlier_probability"):
        SegmentationConfig(outlier_probability=1.0)
    with pytest.raises(ConfigurationError, match="wall_cost"):
        SegmentationConfig(wall_cost=-1.0)
    with pytest.raises(ConfigurationError, match="least_points"):
        SegmentationConfig(least_points=2)
