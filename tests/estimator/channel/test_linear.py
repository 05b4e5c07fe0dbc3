"""Symmetric systems in plain loops against LAPACK's."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.channel.atoms import information, inner_products
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


def test_variances_stay_positive_where_paths_can_not_be_told_apart() -> None:
    """Three strong paths within a fifth of a cell: no information is left, and no negative variance."""
    sizes, middle = np.array([61]), 0.2
    for gap in (0.1, 0.03, 0.003):
        points = (middle + np.array([-gap, 0.0, gap]) / 61.0)[:, None]
        kernels = inner_products(sizes, points)
        upper = kernels.kernel.copy()
        factorise(upper)
        variance = information(kernels, upper, np.array([[1e6, -2e6, 1e6]], dtype=complex))
        invert(variance)
        assert np.all(np.isfinite(variance))
        assert np.all(np.diagonal(variance) > 0.0)
