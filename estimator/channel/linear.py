"""Symmetric positive definite systems: plain loops, whose bits depend on no library."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["factorise", "invert", "solve", "solve_forward"]

_LEAST_PIVOT = 1e-14  # of the largest diagonal element: what rounding leaves of a singular matrix


@compiled
def factorise(matrix: NDArray[np.float64]) -> bool:
    """Cholesky's factor ``U``, ``matrix = U^T U``, in the upper triangle of ``matrix`` (n, n).

    Returns
    -------
    bool
        Whether the matrix is positive definite; if not, pivots were raised to what rounding leaves, and their
        rows cut off, so that the inverse stays finite and positive.
    """
    size, largest, definite = matrix.shape[0], 0.0, True
    for i in range(size):
        largest = max(largest, matrix[i, i])
    for k in range(size):
        if not matrix[k, k] > _LEAST_PIVOT * largest:
            matrix[k, k], definite = max(_LEAST_PIVOT * largest, 1e-300), False
            for j in range(k + 1, size):
                matrix[k, j] = 0.0
        root = np.sqrt(matrix[k, k])
        matrix[k, k] = root
        for j in range(k + 1, size):
            matrix[k, j] /= root
        for i in range(k + 1, size):
            factor = matrix[k, i]
            for j in range(i, size):
                matrix[i, j] -= factor * matrix[k, j]
    return definite


@compiled
def solve_forward(upper: NDArray[np.float64], right: NDArray[np.inexact]) -> None:
    """Solve ``U^T X = right`` (n, m) in place."""
    size = upper.shape[0]
    for i in range(size):
        over = 1.0 / upper[i, i]
        for c in range(right.shape[1]):
            right[i, c] *= over
        for j in range(i + 1, size):
            factor = upper[i, j]
            for c in range(right.shape[1]):
                right[j, c] -= factor * right[i, c]


@compiled
def solve(upper: NDArray[np.float64], right: NDArray[np.inexact]) -> None:
    """Solve ``U^T U X = right`` (n, m) in place."""
    solve_forward(upper, right)
    for i in range(upper.shape[0] - 1, -1, -1):
        for j in range(i + 1, upper.shape[0]):
            factor = upper[i, j]
            for c in range(right.shape[1]):
                right[i, c] -= factor * right[j, c]
        over = 1.0 / upper[i, i]
        for c in range(right.shape[1]):
            right[i, c] *= over


@compiled
def invert(matrix: NDArray[np.float64]) -> bool:
    """Put the inverse of ``matrix`` (n, n) in its place; whether it is positive definite.

    The diagonal is scaled to 1 before, so that rounding is judged element by element.
    """
    size = matrix.shape[0]
    scale, inverse = np.empty(size), np.eye(size)
    for i in range(size):
        scale[i] = 1.0 / np.sqrt(max(matrix[i, i], 1e-300))
    for i in range(size):
        for j in range(size):
            matrix[i, j] *= scale[i] * scale[j]
    definite = factorise(matrix)
    solve(matrix, inverse)
    for i in range(size):
        for j in range(size):
            matrix[i, j] = scale[i] * scale[j] * inverse[i, j]
    return definite
