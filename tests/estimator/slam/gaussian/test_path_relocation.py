"""Relocation by paths: the agent put elsewhere in a room that it has mapped, and no sweep comes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from estimator.experiments.room import make_room
from estimator.geometry import rotation_matrix
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp
from estimator.simulate import SimulationConfig
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.map_search import Known
from estimator.slam.gaussian.path_relocation import path_scores, places_by_paths
from estimator.slam.gaussian.start import start
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.models.state_vector import THETA
from estimator.slam.run import run_slam
from estimator.waveform import SPEED_OF_LIGHT_M_S

CONFIG = GaussianConfig()
NORMALS = np.deg2rad([0.0, 90.0, 180.0, 262.0])
IMAGES = 2.0 * np.array([2.0, 5.0, 7.0, 3.0])[:, None] * np.stack([np.cos(NORMALS), np.sin(NORMALS)], axis=-1)
ANCHORS = np.array([[1.0, 3.0], [-6.0, 4.0]])
CLUTTER = np.array([0.05, 0.05])
STD_M = 0.03


@pytest.fixture
def mapped():
    """A state that knows four walls and two anchors at its height, its agent at RP."""
    walls = [GaussianVrp(image, 1e-4 * np.eye(2)) for image in IMAGES]
    state = start(walls, ("a", "b"), 28e9, CONFIG, anchors_m=ANCHORS)
    mean = state.hypotheses.mean.copy()
    mean[:, [state.layout.height2(k) for k in range(2)]] = 0.0
    return state.but(hypotheses=state.hypotheses._replace(mean=mean))


def heard(state, place, bounces=True, anchors=(True, True)):
    """The paths of an epoch at a place: lines of sight, and bounces off all walls."""
    paths = []
    for anchor, speaks in zip(ANCHORS, anchors, strict=True):
        share = 1.0 - 2.0 * (IMAGES @ anchor) / np.sum(IMAGES**2, axis=1)
        sources = np.concatenate(
            [anchor[None], anchor + share[:, None] * IMAGES] if bounces else [anchor[None]]
        )
        length = np.linalg.norm(sources - place, axis=1)[: None if speaks else 0]
        paths.append(
            AnchorPaths(length / SPEED_OF_LIGHT_M_S, np.full(len(length), STD_M / SPEED_OF_LIGHT_M_S))
        )
    return stack_paths(Epoch(1, 1.0, tuple(paths)), 28e9, state.bearing_rad)


def found(state, paths):
    told = places_by_paths(state, paths, CLUTTER, CONFIG.relocation, CONFIG.visibility)
    if told is None:
        return None
    return SimpleNamespace(places_m=told[0].place_m, cell_m=told[0].cell_m, here=told[1])


def in_frame(state, gauge):
    """Places of the gauge frame in the estimator's."""
    return gauge @ rotation_matrix(state.bearing_rad).T


@pytest.mark.parametrize("place", [(-5.0, 2.0), (1.0, -1.5), (-3.0, 3.0)])
def test_the_agent_is_found_where_its_paths_fit(mapped, place):
    """The best place is the true one, to the size of a cell; it is not where the agent is thought to be."""
    places = found(mapped, heard(mapped, np.array(place)))
    assert np.linalg.norm(in_frame(mapped, places.places_m)[0] - place) < places.cell_m
    assert not places.here


def test_an_agent_that_its_paths_single_out_is_here(mapped):
    """Bounces off walls of four directions fit one place alone: the one where the agent is."""
    assert found(mapped, heard(mapped, np.zeros(2))).here


def test_few_paths_single_nothing_out(mapped):
    """One line of sight fits a circle, two their two crossings; that is no proof."""
    one = found(mapped, heard(mapped, np.zeros(2), bounces=False, anchors=(True, False)))
    two = found(mapped, heard(mapped, np.zeros(2), bounces=False))
    assert not one.here
    assert not two.here
    mirrored = in_frame(mapped, two.places_m)
    along = (ANCHORS[1] - ANCHORS[0]) / np.linalg.norm(ANCHORS[1] - ANCHORS[0])
    image = 2.0 * (ANCHORS[0] + (along @ -ANCHORS[0]) * along)
    assert np.linalg.norm(mirrored - image, axis=1).min() < 0.5


def test_scores_are_log_likelihood_ratios(mapped):
    """Of one path at one place: clutter, or a line of sight or bounce with its probability and density."""
    layout, mean = mapped.layout, mapped.hypotheses.mean[0]
    paths = heard(mapped, np.array([0.5, 0.5]), bounces=False, anchors=(True, False))
    cell, cell_m = np.array([[0.3, 0.1]]), 0.2
    located, present = mapped.hypotheses.located[0], np.zeros(layout.slots, dtype=bool)
    score = path_scores(layout, Known(mean, present, located), cell, cell_m, paths, CLUTTER, 0.9, 0.6)
    gap = paths.length_m[0, 0] - np.linalg.norm(mean[layout.anchor_xy(0)] - cell[0])
    variance = STD_M**2 + cell_m**2 / 6.0
    density = np.exp(-0.5 * gap**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    assert score[0] == pytest.approx(np.log(1.0 + 0.9 * density / CLUTTER[0]), rel=1e-9)


def test_directions_tell_mirrored_places_apart(mapped):
    """Two lines of sight fit two places alike; with their directions, one, if the heading is held."""
    layout, mean = mapped.layout, mapped.hypotheses.mean[0]
    gauge = np.array([mean[layout.anchor_xy(k)] for k in range(2)])
    along = (gauge[1] - gauge[0]) / np.linalg.norm(gauge[1] - gauge[0])
    image = 2.0 * (gauge[0] - (along @ gauge[0]) * along)
    places, none = np.array([[0.0, 0.0], image]), np.zeros(layout.slots, dtype=bool)
    paths = heard(mapped, np.zeros(2), bounces=False)
    bearing = np.arctan2(gauge[:, 1], gauge[:, 0])[:, None] + mean[THETA]
    told = paths._replace(azimuth_rad=bearing, azimuth_std_rad=np.full((2, 1), 0.02))

    def lead(paths):
        located = mapped.hypotheses.located[0]
        score = path_scores(layout, Known(mean, none, located), places, 0.05, paths, CLUTTER, 0.9, 0.6)
        return score[0] - score[1]

    assert abs(lead(paths)) < 1e-9
    gained = 2.0 * np.log(np.sqrt(2.0 * np.pi) / 0.02)
    assert lead(told) > gained - 1.0
    assert abs(lead(told._replace(heading_held=False))) < 1e-9


def test_without_a_map_there_is_nowhere_to_look():
    """No anchor located: None."""
    state = start([GaussianVrp(image, 1e-4 * np.eye(2)) for image in IMAGES], ("a", "b"), 28e9, CONFIG)
    assert found(state, heard(state, np.zeros(2))) is None


def test_a_kidnapped_agent_is_found_again_without_sweeps():
    """Put 25 m away in the middle of a run with one sweep: said in 5 epochs, found again, the map kept."""
    corners = np.array([[0.0, 0.0], [80.0, 0.0], [80.0, 60.0], [50.0, 60.0], [50.0, 40.0], [0.0, 40.0]])
    walk = np.linspace([10.0, 15.0], [70.0, 9.0], 121)
    back = np.linspace([60.0, 32.0], [20.0, 28.0], 81)
    anchors = np.array([[68.0, 6.0], [42.0, 36.0], [6.0, 6.0]])
    ends = np.roll(corners, -1, axis=0)
    room = make_room("kidnapped", corners, ends, anchors, np.concatenate([walk, back]))
    for seed in (1, 2, 3):
        result = run_slam(room.measure(SimulationConfig(), seed))
        true = np.concatenate([walk, back]) - walk[0]
        error = np.linalg.norm(result.agent_mean[:, :2] - true, axis=1)
        assert result.flagged[121:126].any()
        assert not result.flagged[40:120].any()
        assert error[110:121].mean() < 1.0
        assert error[150:].max() < 2.0, seed
        assert result.wall_valid[-1].sum() <= 6
