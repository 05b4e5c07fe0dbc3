"""Relocation: the agent put elsewhere in a room that it has mapped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.geometry import rotation_matrix
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.map_search import Known
from estimator.slam.gaussian.relocation import Seen, is_explained, place_scores, relocated
from estimator.slam.gaussian.start import start
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.models.state_vector import HEADING
from estimator.waveform import SPEED_OF_LIGHT_M_S

CONFIG = GaussianConfig()
NORMALS = np.deg2rad([0.0, 90.0, 180.0, 262.0])
OFFSETS = np.array([2.0, 5.0, 7.0, 3.0])  # an odd angle and no symmetry: one place alone fits
ANCHOR = np.array([4.0, 3.0])
NOISE = np.diag([0.04**2, 0.04**2])


def flashes(place, heading=0.0):
    """What a sweep shows at a place, in the agent's axes."""
    normals = np.stack([np.cos(NORMALS), np.sin(NORMALS)], axis=-1)
    images = 2.0 * (OFFSETS - normals @ place)[:, None] * normals
    return [GaussianVrp(image, NOISE) for image in images @ rotation_matrix(heading)]


@pytest.fixture
def mapped():
    """A state that knows four walls and an anchor, its agent at RP."""
    walls = [GaussianVrp(image, 1e-4 * np.eye(2)) for image in (f.mean_m for f in flashes(np.zeros(2)))]
    return start(walls, ("a",), 28e9, CONFIG, anchors_m=ANCHOR[None])


def places(state, place, heading=0.0, held=True, trusted=True, driven=False):
    """The places proposed at an epoch taken at a place, and the hypotheses."""
    length = np.array([np.linalg.norm(place - ANCHOR)])
    paths = AnchorPaths(length / SPEED_OF_LIGHT_M_S, np.full(1, 0.05 / SPEED_OF_LIGHT_M_S))
    epoch = Epoch(1, 1.0, (paths,), heading_held=held)
    known = state.hypotheses.mean.copy()
    known[:, state.layout.height2(0)] = 0.0
    state = state.but(hypotheses=state.hypotheses._replace(mean=known))
    found = relocated(
        state,
        flashes(place, heading),
        stack_paths(epoch, 28e9, state.bearing_rad),
        np.array([0.05]),
        CONFIG.sweeps.new_flash_density,
        CONFIG.relocation,
        CONFIG.visibility,
        0.5,
        trusted,
        driven,
    )
    return None if found is None else (found.mean[:, :2] @ rotation_matrix(state.bearing_rad).T, found)


def test_a_sweep_that_is_explained_asks_for_nothing(mapped):
    """The agent is where it is thought to be; only a suspect run looks elsewhere."""
    assert places(mapped, np.zeros(2)) is None
    assert places(mapped, np.zeros(2), held=False) is None
    where, _ = places(mapped, np.zeros(2), trusted=False)
    assert np.linalg.norm(where[0]) < 0.2


@pytest.mark.parametrize("place", [(-5.0, 2.0), (1.0, -1.5), (-3.0, 4.0)])
def test_the_agent_is_found_where_its_sweep_fits(mapped, place):
    """The best cell is beside the true place; the hypothesis weighs little, knows no speed, keeps the map."""
    where, found = places(mapped, np.array(place))
    assert np.linalg.norm(where[0] - place) < 0.25
    assert found.log_weight.max() < np.log(CONFIG.relocation.elsewhere_probability)
    assert np.all(found.mean[:, 2:4] == 0.0)
    assert np.all(found.covariance[:, :4, 4:] == 0.0)
    assert np.allclose(found.covariance[:, 2, 2], 0.25)
    np.testing.assert_array_equal(
        found.mean[0, mapped.layout.walls], mapped.hypotheses.mean[0, mapped.layout.walls]
    )


def test_an_unknown_heading_is_voted_for(mapped):
    """The body may stand any way: angles between flashes tell."""
    where, _ = places(mapped, np.array([-5.0, 2.0]), heading=2.0, held=False, trusted=False)
    assert np.linalg.norm(where - [-5.0, 2.0], axis=1).min() < 0.4


def test_odometry_asks_which_way_the_body_stands(mapped):
    """Every place once for each way, which share its weight and are as wide as they lie apart."""
    _, one = places(mapped, np.array([-5.0, 2.0]))
    _, found = places(mapped, np.array([-5.0, 2.0]), driven=True)
    ways = CONFIG.relocation.most_headings
    assert found.number == ways * one.number
    assert np.exp(found.log_weight).sum() == pytest.approx(np.exp(one.log_weight).sum())
    first = found.mean[:: one.number, HEADING]
    np.testing.assert_allclose(np.diff(first), 2.0 * np.pi / ways)
    assert np.allclose(found.covariance[:, HEADING, HEADING], (np.pi / ways) ** 2)


def test_scores_are_log_likelihood_ratios(mapped):
    """At the exact place, of one flash: a Gaussian in range and bearing over the density of new ones."""
    layout, mean = mapped.layout, mapped.hypotheses.mean[0]
    turn = rotation_matrix(-mapped.bearing_rad)
    flash = flashes(np.zeros(2))[1]
    none = np.zeros((1, 1))
    seen = Seen(
        (turn @ flash.mean_m)[None],
        NOISE[None],
        0.004,
        np.zeros(1, dtype=np.int64),
        none,
        none + 1.0,
        none[0],
    )
    cells = np.array([[0.0, 0.0], [200.0, 200.0]])
    known = Known(mean, mapped.hypotheses.present[0], np.zeros(1, dtype=bool))
    score = place_scores(layout, known, cells, 1e-9, seen)
    size = np.linalg.norm(flash.mean_m)
    expected = -np.log(2.0 * np.pi * 0.02 * (0.04 / size)) - np.log(0.004)
    assert score[0] == pytest.approx(expected, abs=0.01)
    assert score[1] == 0.0


def test_enough_flashes_must_fit(mapped):
    """Three of four explain a sweep, two do not."""
    seen = np.array([flash.mean_m for flash in flashes(np.zeros(2))]) @ rotation_matrix(mapped.bearing_rad)
    noise = np.tile(NOISE, (4, 1, 1))
    for wrong, explained in ((1, True), (2, False)):
        moved = seen.copy()
        moved[:wrong] *= 3.0
        assert is_explained(mapped.layout, mapped.hypotheses, moved, noise, 4.0, 0.75) == explained


def test_cells_are_bounded(mapped):
    """However large the map is: a wall a kilometre away makes cells larger, not more."""
    far = mapped.hypotheses.mean.copy()
    far[:, mapped.layout.wall(2)] *= 200.0
    state = mapped.but(hypotheses=mapped.hypotheses._replace(mean=far))
    few = replace(CONFIG.relocation, most_cells=2_000)
    paths = stack_paths(Epoch(1, 1.0, (AnchorPaths.none(),)), 28e9)
    sweep = flashes(np.array([-5.0, 2.0]))
    new = CONFIG.sweeps.new_flash_density
    found = relocated(state, sweep, paths, np.ones(1), new, few, CONFIG.visibility, 0.5, True, False)
    assert found is not None
    assert found.number <= few.most_places
