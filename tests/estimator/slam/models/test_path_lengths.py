"""Path lengths of features against the image method and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import mirror
from estimator.slam.models import features
from estimator.slam.models.directions import predict_azimuths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import THETA, Layout
from estimator.specular import specular_paths


def state_of(room, position, height2=0.0):
    """A state vector with the true anchors and all six walls, RP at the origin."""
    layout = Layout(2, 6)
    mean = np.zeros(layout.size)
    mean[:2] = position - room.track[0]
    for k in range(2):
        mean[layout.anchor(k)] = *(room.anchors[k] - room.track[0]), height2, 0.0
    mean[layout.walls] = room.vrps.ravel()
    return mean, layout


def test_the_compiled_mirror_is_the_papers():
    """The compiled mirror equals equation (2) with RP at the origin, and is its own inverse."""
    rng = np.random.default_rng(1)
    points, vrps = rng.normal(size=(50, 2)) * 20, rng.normal(size=(50, 2)) * 20
    for point, vrp in zip(points, vrps, strict=True):
        image = features.mirror(*point, *vrp)
        assert np.allclose(image, mirror(point, vrp[None])[0], atol=1e-9)
        assert np.allclose(features.mirror(*image, *vrp), point, atol=1e-9)
        assert features.side_of_wall(*point, *vrp) == pytest.approx(-features.side_of_wall(*image, *vrp))


def test_lengths_are_those_of_the_image_method(room):
    """Every visible path of up to two bounces has its feature, as long, and called possible."""
    positions = room.track[[0, 60, 120, 200, 235]]
    paths = specular_paths(room.walls[:, 0], room.walls[:, 1], room.anchors, positions, 2)
    compared = 0
    for t, position in enumerate(positions):
        mean, layout = state_of(room, position)
        prediction = predict_paths(mean[None], layout)
        for f, walls in enumerate(paths.walls):
            feature = {0: lambda w: 0, 1: lambda w: 1 + w[0], 2: lambda w: 7 + 6 * w[0] + w[1]}[len(walls)](
                walls
            )
            for k in np.flatnonzero(paths.visible[t, :, f]):
                assert abs(prediction.length_m[0, k, feature] - paths.length_m[t, k, f]) < 1e-9
                assert prediction.possible[0, k, feature]
                compared += 1
    assert compared > 80


def test_height_lengthens_a_path(room):
    """A squared height difference adds under the root."""
    mean, layout = state_of(room, room.track[50])
    flat = predict_paths(mean[None], layout).length_m
    mean, layout = state_of(room, room.track[50], height2=4.0)
    assert np.allclose(predict_paths(mean[None], layout).length_m, np.sqrt(flat**2 + 4.0))


def test_jacobian_matches_central_differences():
    """Analytic derivatives agree with central differences for random states."""
    rng = np.random.default_rng(2)
    layout = Layout(2, 3)
    mean = rng.normal(size=(4, layout.size)) * 15
    mean[:, [layout.height2(k) for k in range(2)]] = 1.0
    jacobian = predict_paths(mean, layout).jacobian
    pairs = np.concatenate([np.ones(4, dtype=bool), ~np.eye(3, dtype=bool).ravel()])
    for column in range(layout.size):
        shift = np.zeros(layout.size)
        shift[column] = 1e-5
        ahead, behind = (predict_paths(mean + s * shift, layout).length_m for s in (1, -1))
        difference = (ahead - behind) / 2e-5
        assert np.allclose(jacobian[..., column][:, :, pairs], difference[:, :, pairs], atol=1e-6)


def test_azimuths_point_at_the_sources(room):
    """The azimuth of each visible path is the direction of the anchor's image; theta adds to it."""
    mean, layout = state_of(room, room.track[100])
    mean[THETA] = 0.02
    azimuth, _ = predict_azimuths(mean[None], layout)
    here = room.track[100]
    for k, anchor in enumerate(room.anchors):
        sources = [anchor, *(mirror(anchor - room.track[0], vrp) + room.track[0] for vrp in room.vrps)]
        for f, source in enumerate(sources):
            expected = np.arctan2(*(source - here)[::-1]) + 0.02
            assert abs(np.angle(np.exp(1j * (azimuth[0, k, f] - expected)))) < 1e-9


def test_azimuth_jacobian_matches_central_differences():
    """Analytic derivatives of directions agree with central differences."""
    rng = np.random.default_rng(8)
    layout = Layout(2, 3)
    mean = rng.normal(size=(4, layout.size)) * 15
    _, jacobian = predict_azimuths(mean, layout)
    pairs = np.concatenate([np.ones(4, dtype=bool), ~np.eye(3, dtype=bool).ravel()])
    for column in range(layout.size):
        shift = np.zeros(layout.size)
        shift[column] = 1e-5
        ahead, behind = (predict_azimuths(mean + s * shift, layout)[0] for s in (1, -1))
        difference = np.angle(np.exp(1j * (ahead - behind))) / 2e-5
        assert np.allclose(jacobian[..., column][:, :, pairs], difference[:, :, pairs], atol=1e-6)


def test_rotation_is_invisible():
    """No path length depends on theta, and turning everything about RP changes none."""
    rng = np.random.default_rng(3)
    layout = Layout(2, 3)
    mean = rng.normal(size=(1, layout.size)) * 15
    mean[:, [layout.height2(k) for k in range(2)]] = 1.0
    prediction = predict_paths(mean, layout)
    assert np.all(prediction.jacobian[..., THETA] == 0.0)
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = mean.copy()
    for part in (slice(0, 2), *(layout.anchor_xy(k) for k in range(2))):
        turned[0, part] = turn @ mean[0, part]
    turned[0, layout.walls] = (mean[0, layout.walls].reshape(-1, 2) @ turn.T).ravel()
    assert np.allclose(predict_paths(turned, layout).length_m, prediction.length_m)
