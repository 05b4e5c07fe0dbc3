"""Symmetric systems in plain loops against LAPACK's."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.channel.linear import factorise, invert, solve, solve_forward

pytestmark = pytest.mark.interpreted


def positive(size: int) -> np.ndarray:
    """A positive definite matrix."""
    root = np.random.default_rng(size).normal(size=(size, size + 3))
    return root @ root.T


def test_factor_solutions_and_inverse_are_right() -> None:
    """Of sizes 1 to 12: factor, half and whole solutions with complex right sides, inverse."""
    for size in (1, 2, 5, 12):
        matrix = positive(size)
        right = np.random.default_rng(0).normal(size=(size, 2)) * (1.0 + 0.5j)
        upper = matrix.copy()
        assert factorise(upper)
        np.testing.assert_allclose(np.triu(upper).T @ np.triu(upper), matrix, rtol=1e-12)
        half, whole, inverse = right.copy(), right.copy(), matrix.copy()
        solve_forward(upper, half)
        np.testing.assert_allclose(np.triu(upper).T @ half, right, atol=1e-10)
        solve(upper, whole)
        np.testing.assert_allclose(matrix @ whole, right, atol=1e-10)
        assert invert(inverse)
        np.testing.assert_allclose(inverse @ matrix, np.eye(size), atol=1e-9)


def test_a_singular_matrix_is_told() -> None:
    """Coinciding atoms make a singular matrix: that is said, and nothing becomes infinite."""
    matrix = np.ones((3, 3)) + np.diag([0.0, 1.0, 0.0])
    assert not factorise(matrix)
    assert np.all(np.isfinite(matrix))
