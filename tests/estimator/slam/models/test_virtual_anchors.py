"""Virtual anchors as features: their path lengths, directions and walls, by complex step and differences."""

from __future__ import annotations

import numpy as np

from estimator.geometry import mirror, vrp_by_image, vrp_by_point, vrp_of_image
from estimator.slam.models.directions import predict_azimuths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import THETA, Layout
from estimator.slam.models.virtual_anchors import (
    VirtualAnchors,
    implied_walls,
)

TINY = 1e-30  # complex step
LAYOUT = Layout(2, 3, shared=False)
OWNER = np.array([0, 1, 1])


def some_state():
    """Random state vectors with virtual anchors."""
    mean = np.random.default_rng(5).normal(size=(4, LAYOUT.size)) * 10.0
    mean[:, [LAYOUT.height2(k) for k in range(2)]] = 1.0
    mean[:, [LAYOUT.scale(k) for k in range(2)]] *= 0.01
    return mean


def sources(mean):
    """Where the paths (R, K, F) come from, by the book, of complex state vectors too."""
    slots = mean[:, LAYOUT.walls].reshape(len(mean), 3, 4)
    outward = np.stack([np.cos(slots[..., 1]), np.sin(slots[..., 1])], axis=-1)
    points = slots[..., 2:] + slots[..., :1] * outward
    anchors = np.stack([mean[:, LAYOUT.anchor_xy(k)] for k in range(2)], axis=1)
    both = np.repeat(points[:, None], 2, axis=1)
    return np.concatenate([anchors[:, :, None], both], axis=2)


def lengths(mean):
    """Path lengths by the book."""
    offset = mean[:, None, None, :2] - sources(mean)
    height2 = np.stack([mean[:, LAYOUT.height2(k)] for k in range(2)], axis=1)
    bias = np.stack([mean[:, LAYOUT.bias(k)] for k in range(2)], axis=1)
    scale = np.stack([1.0 + mean[:, LAYOUT.scale(k)] for k in range(2)], axis=1)
    return scale[:, :, None] * np.sqrt(np.sum(offset**2, axis=-1) + height2[:, :, None]) + bias[:, :, None]


def test_lengths_and_their_derivatives():
    """A wrong derivative of a virtual anchor's path length would bend every map of method `va`."""
    mean = some_state()
    prediction = predict_paths(mean, LAYOUT)
    np.testing.assert_allclose(prediction.length_m, lengths(mean), rtol=1e-14)
    for column in range(LAYOUT.size):
        shifted = mean.astype(complex)
        shifted[:, column] += 1j * TINY
        expected = lengths(shifted).imag / TINY
        np.testing.assert_allclose(prediction.jacobian[..., column], expected, atol=1e-12)
    assert prediction.possible.all()


def test_directions_and_their_derivatives():
    """Directions point at the sources; wrong ones would turn the map."""
    mean = some_state()
    azimuth, jacobian = predict_azimuths(mean, LAYOUT)
    toward = sources(mean) - mean[:, None, None, :2]
    expected = np.arctan2(toward[..., 1], toward[..., 0]) + mean[:, None, None, THETA]
    np.testing.assert_allclose(np.exp(1j * azimuth), np.exp(1j * expected), atol=1e-12)
    for column in range(LAYOUT.size):
        step = np.zeros(LAYOUT.size)
        step[column] = 1e-6
        ahead, behind = (predict_azimuths(mean + s * step, LAYOUT)[0] for s in (1, -1))
        difference = np.angle(np.exp(1j * (ahead - behind))) / 2e-6
        np.testing.assert_allclose(jacobian[..., column], difference, atol=1e-6)


def test_a_path_knows_the_agent_and_its_own_point_alone():
    """A derivative by another slot or anchor would move what a path says nothing of."""
    jacobian = predict_paths(some_state(), LAYOUT).jacobian
    for k in range(2):
        for slot in range(3):
            own = np.zeros(LAYOUT.size, dtype=bool)
            own[:2] = own[LAYOUT.wall(slot)] = True
            own[[LAYOUT.height2(k), LAYOUT.bias(k), LAYOUT.scale(k)]] = True
            assert np.all(jacobian[:, k, 1 + slot, ~own] == 0.0)


def test_the_wall_half_way():
    """A VRP that did not mirror the anchor into its image would tell a wall where none stands."""
    mean = some_state()
    places = VirtualAnchors.of(mean, LAYOUT)
    np.testing.assert_allclose(places.point_m, sources(mean)[:, 0, 1:], atol=1e-12)
    vrps = implied_walls(mean, LAYOUT, OWNER)
    back = mirror(places.anchor_m[:, OWNER].reshape(-1, 2), vrps.reshape(-1, 2))
    np.testing.assert_allclose(back, places.point_m.reshape(-1, 2), atol=1e-9)
    walls = Layout(2, 3)
    shared = np.random.default_rng(1).normal(size=(2, walls.size))
    assert np.array_equal(implied_walls(shared, walls, OWNER).reshape(2, -1), shared[:, walls.walls])


def test_derivatives_of_the_wall_and_of_the_point():
    """Covariances of implied walls are these derivatives' alone."""
    places = VirtualAnchors.of(some_state(), LAYOUT)
    image, anchor = places.point_m[0, 0], places.anchor_m[0, 0]
    for i in range(2):
        step = 1j * TINY * np.eye(2)[i]
        by_image = vrp_of_image(image + step, anchor).imag / TINY
        by_anchor = vrp_of_image(image, anchor + step).imag / TINY
        np.testing.assert_allclose(vrp_by_image(image, anchor)[:, i], by_image, rtol=1e-12)
        np.testing.assert_allclose(vrp_by_point(image, anchor)[:, i], by_anchor, rtol=1e-12)
        shifted = some_state().astype(complex)
        shifted[:, LAYOUT.walls.start + i] += 1j * TINY
        by_slot = sources(shifted)[:, 0, 1].imag / TINY
        np.testing.assert_allclose(places.by_slot[:, 0, :, i], by_slot, atol=1e-12)
