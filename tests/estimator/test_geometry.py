"""Mirror images, walls and rotations, by their defining properties."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.compiled import compiled
from estimator.geometry import (
    mirror,
    mirror_in_wall,
    mirror_xy,
    rotate,
    rotate_by_angle_of,
    rotation_matrix,
    segments_cross,
    vrp_by_image,
    vrp_by_point,
    vrp_of_image,
    vrp_of_line,
    wall_normal,
)

RNG = np.random.default_rng(2)
REFERENCE = np.array([3.0, -2.0])


def test_mirror_keeps_distances_to_the_wall_and_along_it() -> None:
    """The mirror image is as far from every point of the wall as the point itself."""
    vrp = RNG.uniform(-20.0, 20.0, (50, 2))
    points = RNG.uniform(-20.0, 20.0, (50, 2))
    images = mirror(points, vrp, REFERENCE)
    normal = wall_normal(vrp, REFERENCE)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    for along in (-7.0, 0.0, 11.0):
        on_wall = 0.5 * (vrp + REFERENCE) + along * tangent
        np.testing.assert_allclose(
            np.linalg.norm(images - on_wall, axis=1), np.linalg.norm(points - on_wall, axis=1), rtol=1e-12
        )


def test_mirror_is_its_own_inverse_and_swaps_reference_and_vrp() -> None:
    """Equations (2) and (4): mirroring twice does nothing; RP and VRP are images of each other."""
    vrp = RNG.uniform(-20.0, 20.0, (50, 2))
    points = RNG.uniform(-20.0, 20.0, (50, 2))
    np.testing.assert_allclose(mirror(mirror(points, vrp, REFERENCE), vrp, REFERENCE), points, atol=1e-12)
    np.testing.assert_allclose(mirror(REFERENCE, vrp, REFERENCE), vrp, atol=1e-12)
    np.testing.assert_allclose(mirror(vrp, vrp, REFERENCE), np.tile(REFERENCE, (50, 1)), atol=1e-12)


def test_vrp_and_wall_say_the_same() -> None:
    """Mirroring in two points of a wall equals mirroring in its VRP (equation (3))."""
    start, end = RNG.uniform(-20.0, 20.0, (2, 50, 2))
    points = RNG.uniform(-20.0, 20.0, (50, 2))
    vrp = vrp_of_line(start, end, REFERENCE)
    np.testing.assert_allclose(mirror(points, vrp, REFERENCE), mirror_in_wall(points, start, end), atol=1e-9)
    np.testing.assert_allclose(mirror_in_wall(start, start, end), start, atol=1e-12)


def test_the_compiled_mirror_is_the_same_bits() -> None:
    """What runs in compiled functions and what arrays get are one definition."""
    one = compiled(mirror_xy)
    points, vrps = RNG.uniform(-20.0, 20.0, (2, 50, 2))
    images = np.array([one(*point, *vrp) for point, vrp in zip(points, vrps, strict=True)])
    np.testing.assert_array_equal(images, mirror(points, vrps))


def test_a_wall_is_known_by_the_agents_image() -> None:
    """The VRP that an image implies is that of the wall; its derivatives are those of small changes."""
    vrp, position = np.array([14.0, -3.0]), np.array([2.0, 5.0])
    image = mirror(position, vrp)
    np.testing.assert_allclose(vrp_of_image(image, position), vrp, atol=1e-12)
    for derivative, moved in (
        (vrp_by_image(image, position), lambda step: vrp_of_image(image + step, position)),
        (vrp_by_point(image, position), lambda step: vrp_of_image(image, position + step)),
    ):
        for axis, step in enumerate(1e-5 * np.eye(2)):
            slope = (moved(step) - moved(-step)) / 2e-5
            np.testing.assert_allclose(derivative[:, axis], slope, atol=1e-7)


def test_a_state_is_rotated_with_the_derivatives_by_its_angle() -> None:
    """Points as `rotate` gives them, and derivatives as those of small changes."""
    state = RNG.normal(size=7)
    columns, offset = (slice(0, 2), slice(5, 7)), 0.4
    points, jacobian = rotate_by_angle_of(state, 4, columns, offset)
    expected = rotate(np.stack([state[place] for place in columns]), offset + state[4])
    np.testing.assert_allclose(points.reshape(2, 2), expected, atol=1e-15)
    for i, step in enumerate(1e-6 * np.eye(7)):
        ahead, behind = (rotate_by_angle_of(state + s, 4, columns, offset)[0] for s in (step, -step))
        np.testing.assert_allclose(jacobian[:, i], (ahead - behind) / 2e-6, atol=1e-8)


def test_broadcasting() -> None:
    """Anchors against walls in one call."""
    points, vrp = RNG.uniform(-5.0, 5.0, (4, 1, 2)), RNG.uniform(6.0, 9.0, (3, 2))
    images = mirror(points, vrp)
    assert images.shape == (4, 3, 2)
    np.testing.assert_allclose(images[2, 1], mirror(points[2, 0], vrp[1]))


def test_rotations_are_counter_clockwise() -> None:
    """A quarter turn takes x to y, about any reference; the matrix is orthogonal."""
    np.testing.assert_allclose(rotation_matrix(np.pi / 2) @ [1.0, 0.0], [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(rotate(REFERENCE + [1.0, 0.0], np.pi / 2, REFERENCE), REFERENCE + [0.0, 1.0])
    matrix = rotation_matrix(0.77)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(2), atol=1e-15)
    points = RNG.normal(size=(6, 2))
    np.testing.assert_allclose(rotate(points, 0.77), (matrix @ points.T).T)


def test_rotating_a_map_about_rp_keeps_its_path_lengths() -> None:
    """Passive delays do not see a rotation of agent, anchor and wall about RP."""
    agent, anchor, vrp = RNG.uniform(-20.0, 20.0, (3, 2))
    before = np.linalg.norm(agent - mirror(anchor, vrp))
    agent, anchor, vrp = (rotate(point, 0.4) for point in (agent, anchor, vrp))
    assert np.linalg.norm(agent - mirror(anchor, vrp)) == pytest.approx(before, rel=1e-12)


@pytest.mark.parametrize(
    ("a", "b", "crosses"),
    [
        (((0, 0), (2, 2)), ((0, 2), (2, 0)), True),
        (((0, 0), (0.9, 0.9)), ((0, 2), (2, 0)), False),
        (((0, 0), (1, 1)), ((0, 2), (2, 0)), False),  # a ends on b
        (((0, 0), (2, 0)), ((1, 0), (1, 5)), True),  # b begins on a
        (((0, 0), (2, 0)), ((0, 1), (2, 1)), False),  # parallel
        (((0, 0), (2, 0)), ((1, 0), (3, 0)), False),  # in one line
        (((0, 0), (2, 0)), ((3, -1), (3, 1)), False),
    ],
)
def test_crossings(
    a: tuple[tuple[float, float], ...], b: tuple[tuple[float, float], ...], crosses: bool
) -> None:
    """Open segments a against closed segments b, ends and parallels included."""
    assert bool(segments_cross(*a, *b)) is crosses


def test_crossings_against_orientation_tests() -> None:
    """Random segments cross exactly if the ends of each lie on both sides of the other."""
    a0, a1, b0, b1 = RNG.uniform(-1.0, 1.0, (4, 2000, 2))

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        u, v = q - p, r - p
        return np.sign(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])

    expected = (side(a0, a1, b0) != side(a0, a1, b1)) & (side(b0, b1, a0) != side(b0, b1, a1))
    np.testing.assert_array_equal(segments_cross(a0, a1, b0, b1), expected)
    assert 0 < expected.sum() < len(expected)
