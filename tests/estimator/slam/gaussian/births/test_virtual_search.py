"""Where a virtual anchor may be: mirror images, bends, too little; on made tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.slam.gaussian.births.config import VirtualBirths
from estimator.slam.gaussian.births.virtual_search import Recent, search

CONFIG = VirtualBirths()
POINT = np.array([4.0, 5.0])


def heard_along(track, point, rng, sigma=0.1):
    """What a virtual anchor and clutter (one path per epoch on 30 m) leave along a track."""
    length, step = [], []
    for t, here in enumerate(track):
        paths = [*(30.0 * rng.random(rng.poisson(1.0)))]
        if rng.random() < 0.95:
            paths.append(np.linalg.norm(point - here) + sigma * rng.normal())
        length += paths
        step += [t] * len(paths)
    variance = np.full(len(track), sigma**2)
    rows = np.arange(len(length))
    return Recent(rows, np.array(length), np.array(step), track, variance, variance, 1.0 / 30.0)


def searched(recent):
    return search(recent, 0.95, 1.0, CONFIG)


def places_of(recent, modes):
    """The places (B, 2) of modes."""
    outward = np.stack([np.cos(modes.mean[:, 1]), np.sin(modes.mean[:, 1])], axis=1)
    return recent.position_m[-1] + modes.mean[:, :1] * outward


def test_a_straight_track_leaves_the_mirror_image():
    """Two places as likely as each other, one on either side of the track; errors as large as claimed."""
    rng = np.random.default_rng(3)
    track = np.stack([0.02 * np.arange(80), np.zeros(80)], axis=1)
    scores = []
    for _ in range(40):
        recent = heard_along(track, POINT, rng)
        modes = searched(recent)
        assert len(modes.mean) == 2
        assert np.exp(modes.log_weight).min() > 0.3
        places = places_of(recent, modes)
        assert np.abs(places[:, 1].sum()) < 0.2
        right = int(np.argmax(places[:, 1]))
        here = POINT - track[-1]
        error = modes.mean[right] - [np.linalg.norm(here), np.arctan2(here[1], here[0])]
        scores.append(error @ np.linalg.solve(modes.covariance[right], error))
    # chi-square with 80 degrees of freedom over 80: mean 1, standard deviation 0.16
    assert 0.5 < np.mean(scores) / 2.0 < 1.65


def test_a_bend_decides():
    """After a corner only the true place is left."""
    rng = np.random.default_rng(4)
    way = 0.02 * np.arange(60)
    track = np.concatenate([np.stack([way, 0 * way], axis=1), np.stack([0 * way + 1.2, way], axis=1)])
    recent = heard_along(track, POINT, rng)
    modes = searched(recent)
    assert np.exp(modes.log_weight).max() > 0.999
    best = int(np.argmax(modes.log_weight))
    assert np.linalg.norm(places_of(recent, modes)[best] - POINT) < 0.5
    assert 100 < modes.explained.sum() < 125


def test_too_little_starts_nothing():
    """Clutter alone, and a virtual anchor of which the track has not told the bearing, are no birth."""
    rng = np.random.default_rng(6)
    track = np.stack([0.02 * np.arange(80), np.zeros(80)], axis=1)
    for _ in range(20):
        recent = heard_along(track, POINT, rng)
        clutter = 30.0 * rng.random(recent.length_m.size)
        assert searched(replace(recent, length_m=clutter)) is None
        assert searched(heard_along(track[:15], POINT, rng)) is None
