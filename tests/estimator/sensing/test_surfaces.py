"""Walls from pairs of points: (19), (20) and the constants of Appendix B."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.geometry import vrp_of_line
from estimator.sensing.surfaces import pair_solution, reflection_points


def quotient(z: np.ndarray, rp: np.ndarray) -> np.ndarray:
    """(19) and (20) as printed, for complex arguments ``x1, x2, y1, y2``."""
    x1, x2, y1, y2 = z
    dx, dy = x2 - x1, y2 - y1
    x = rp[0] * dx**2 - (rp[0] - 2 * x1) * dy**2 + 2 * (rp[1] - y1) * dx * dy
    y = rp[1] * dy**2 - (rp[1] - 2 * y1) * dx**2 + 2 * (rp[0] - x1) * dx * dy
    return np.array([x, y]) / (dx**2 + dy**2)


def test_constants_are_the_derivatives_of_the_quotients():
    """(64)-(78) against complex-step derivatives of (19), (20), at random pairs and reference points."""
    rng = np.random.default_rng(3)
    for first, second, rp in rng.normal(scale=10.0, size=(20, 3, 2)):
        z = np.array([first[0], second[0], first[1], second[1]])
        solution = pair_solution(first, second, rp)
        np.testing.assert_allclose(solution.mean_m, quotient(z, rp), rtol=1e-10)
        steps = z + 1e-30j * np.eye(4)
        expected = np.array([quotient(step, rp).imag / 1e-30 for step in steps])
        np.testing.assert_allclose(solution.gradient, expected, rtol=1e-9, atol=1e-10)


def test_pair_gives_the_mirror_image_of_the_reference():
    """(9), (10) and the mirror image (3) are one geometry; arrays broadcast."""
    rng = np.random.default_rng(4)
    first, second = rng.normal(scale=10.0, size=(2, 5, 3, 2))
    rp = np.array([1.0, -2.0])
    vrp = pair_solution(first, second, rp).mean_m
    np.testing.assert_array_equal(vrp, vrp_of_line(first, second, rp))
    np.testing.assert_allclose(np.sum((vrp - rp) * (second - first), axis=-1), 0.0, atol=1e-9)  # (9)


def test_reflection_points_are_polar_coordinates():
    """(8), about the agent's position."""
    np.testing.assert_allclose(
        reflection_points([2.0, 3.0], [0.0, 0.5 * np.pi], (1.0, 1.0)), [[3.0, 1.0], [1.0, 4.0]], atol=1e-12
    )


def test_coinciding_points_are_refused():
    """One point does not make a wall."""
    with pytest.raises(InputError, match="expected distinct points"):
        pair_solution([1.0, 2.0], [1.0, 2.0])
    with pytest.raises(InputError, match="expected shape"):
        pair_solution([1.0, 2.0, 3.0], [1.0, 2.0, 4.0])
