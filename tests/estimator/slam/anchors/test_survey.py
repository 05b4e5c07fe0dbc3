"""Surveys: an anchor from all that was heard of it along a known track."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.observations import gathered
from estimator.slam.anchors.search import scene_of
from estimator.slam.anchors.survey import survey_anchor
from estimator.slam.models.features import mirror
from estimator.slam.models.noise import MeasurementNoise

CONFIG = AnchorSearchConfig()
NOISE = MeasurementNoise()
WALLS = np.array([[12.0, 0.0], [0.0, 16.0], [-9.0, 0.5]])
EVERYWHERE = np.tile([-np.inf, np.inf], (3, 1))
HEIGHTS = np.array([0.25, 1.0, 4.0, 9.0, 25.0])


def heard(rng, anchor, height2, epochs=24, lost=0.3, clutter=1.0, bias=0.0):
    """Scene of an anchor heard over line of sight and single bounces, some paths lost, some clutter."""
    track = np.stack([np.linspace(0.0, 4.0, epochs), 2.0 * np.sin(np.linspace(0.0, 3.0, epochs))], axis=1)
    parts = []
    for place in track:
        sources = [anchor] + [np.array(mirror(*anchor, *wall)) for wall in WALLS]
        lengths = [np.sqrt(np.sum((place - s) ** 2) + height2) for s in sources if rng.random() > lost]
        lengths = np.array(lengths) + bias + 0.03 * rng.normal(size=len(lengths))
        lengths = np.concatenate([lengths, rng.uniform(1.0, 40.0, rng.poisson(clutter))])
        parts.append((lengths, np.full(lengths.size, 0.03**2), np.ones(lengths.size)))
    seen = gathered(track, np.tile(0.02**2 * np.eye(2), (epochs, 1, 1)), parts)
    return scene_of(seen, WALLS, np.tile(0.01**2 * np.eye(2), (3, 1, 1)), NOISE, CONFIG)


@pytest.mark.parametrize("height2", [0.8, 9.0])
def test_place_and_height_are_found_and_beat_all_others(height2):
    """Errors agree with the covariance: the mean of NEES over seeds is that of three dimensions."""
    anchor, squares = np.array([4.5, 6.0]), []
    for seed in range(8):
        scene = heard(np.random.default_rng(seed), anchor, height2)
        found = survey_anchor(scene, EVERYWHERE, 0.0, HEIGHTS, None, CONFIG)
        error = found.place[0] - [*anchor, height2]
        assert np.hypot(*error[:2]) < 0.3
        assert found.margin(0, CONFIG.survey_apart_m) > CONFIG.survey_nats
        squares.append(error @ np.linalg.solve(found.covariance[0], error))
    # 24 degrees of freedom: standard deviation of the mean 3 +- .87; what paths are whose is not certain
    assert 0.8 < np.mean(squares) < 3.0 + 4.0 * 0.87


def test_a_clock_bias_is_taken_off():
    """The same place."""
    anchor = np.array([4.5, 6.0])
    scene = heard(np.random.default_rng(3), anchor, 1.0, bias=2.5)
    found = survey_anchor(scene, EVERYWHERE, 2.5, HEIGHTS, None, CONFIG)
    assert np.hypot(*(found.place[0, :2] - anchor)) < 0.3


def test_where_the_anchor_was_thought_to_be_is_weighed_too():
    """Its own place is the best one; a wrong one is told, and loses."""
    anchor = np.array([4.5, 6.0])
    scene = heard(np.random.default_rng(4), anchor, 1.0)
    right = survey_anchor(scene, EVERYWHERE, 0.0, HEIGHTS, np.array([*anchor, 1.0]), CONFIG)
    assert right.present >= 0
    assert np.hypot(*(right.place[right.present, :2] - anchor)) < 0.3
    wrong = survey_anchor(scene, EVERYWHERE, 0.0, HEIGHTS, np.array([-6.0, -9.0, 1.0]), CONFIG)
    if wrong.present >= 0 and np.hypot(*(wrong.place[wrong.present, :2] - anchor)) > 1.0:
        assert wrong.log_evidence[0] - wrong.log_evidence[wrong.present] > CONFIG.survey_nats


def test_clutter_alone_convinces_of_nothing():
    """No place beats the others by enough."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        scene = heard(rng, np.array([4.5, 6.0]), 1.0, lost=1.0, clutter=4.0)
        found = survey_anchor(scene, EVERYWHERE, 0.0, HEIGHTS, None, CONFIG)
        assert found.margin(0, CONFIG.survey_apart_m) < CONFIG.survey_nats


def test_a_wall_reflects_where_it_was_seen_to():
    """Paths that would bounce elsewhere on its line are another wall's, and place no anchor."""
    anchor = np.array([4.5, 6.0])
    scene = heard(np.random.default_rng(6), anchor, 1.0, clutter=0.0)
    everywhere = survey_anchor(scene, EVERYWHERE, 0.0, HEIGHTS, np.array([*anchor, 1.0]), CONFIG)
    nowhere = np.tile([200.0, 201.0], (3, 1))
    none = survey_anchor(scene, nowhere, 0.0, HEIGHTS, np.array([*anchor, 1.0]), CONFIG)
    at = [found.log_evidence[found.present] for found in (everywhere, none)]
    assert at[0] - at[1] > CONFIG.survey_nats


def test_a_place_moves_with_the_track_it_was_surveyed_from():
    """The levers say how far: all positions off by the same way, the anchor is, too."""
    anchor, off = np.array([4.5, 6.0]), np.array([1e-3, -2e-3])
    scene = heard(np.random.default_rng(2), anchor, 1.0, lost=0.0, clutter=0.0)
    none = np.zeros((0, 2))
    walls_away = scene_of(scene.seen, none, np.zeros((0, 2, 2)), NOISE, CONFIG)
    shifted = scene.seen._replace(position_m=scene.seen.position_m + off)
    moved = scene_of(shifted, none, np.zeros((0, 2, 2)), NOISE, CONFIG)
    start = np.array([*anchor, 1.0])
    before, after = (survey_anchor(s, none, 0.0, HEIGHTS, start, CONFIG) for s in (walls_away, moved))
    told = before.lever[0].sum(axis=0) @ off
    np.testing.assert_allclose(told[:2], off, rtol=1e-3)
    np.testing.assert_allclose(after.place[0, :2] - before.place[0, :2], off, rtol=0.1, atol=1e-4)
