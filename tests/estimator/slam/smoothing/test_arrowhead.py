"""Elimination of chains with a border, against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.slam.smoothing.arrowhead import Arrowhead, eliminate


def random_arrowhead(epochs: int, size: int, still: int, rng: np.random.Generator) -> Arrowhead:
    """A positive definite matrix of the right shape: a product of factors that couple neighbours."""
    chain = np.zeros((epochs, size, size))
    link, border = np.zeros((epochs - 1, size, size)), np.zeros((epochs, size, still))
    corner = 0.1 * np.eye(still)
    for t in range(epochs):
        width = size + (size if t + 1 < epochs else 0) + still
        factor = rng.normal(size=(width + 2, width))
        block = factor.T @ factor
        chain[t] += block[:size, :size]
        border[t] += block[:size, width - still :]
        corner += block[width - still :, width - still :]
        if t + 1 < epochs:
            link[t] = block[:size, size : 2 * size]
            chain[t + 1] += block[size : 2 * size, size : 2 * size]
            border[t + 1] += block[size : 2 * size, width - still :]
    return Arrowhead(chain, link, border, corner)


def dense(matrix: Arrowhead) -> np.ndarray:
    epochs, size, still = matrix.border.shape
    full = np.zeros((epochs * size + still,) * 2)
    for t in range(epochs):
        here = slice(t * size, (t + 1) * size)
        full[here, here] = matrix.chain[t]
        full[here, epochs * size :] = matrix.border[t]
        full[epochs * size :, here] = matrix.border[t].T
        if t + 1 < epochs:
            after = slice((t + 1) * size, (t + 2) * size)
            full[here, after], full[after, here] = matrix.link[t], matrix.link[t].T
    full[epochs * size :, epochs * size :] = matrix.corner
    return full


@pytest.mark.parametrize(("epochs", "size", "still"), [(6, 4, 7), (1, 3, 2), (5, 2, 0)])
def test_solution_and_marginals_are_those_of_the_dense_matrix(epochs, size, still):
    """Solve and invert by elimination and by numpy."""
    rng = np.random.default_rng(epochs)
    matrix = random_arrowhead(epochs, size, still, rng)
    full = dense(matrix)
    right = rng.normal(size=len(full))
    factor = eliminate(matrix)
    moving, rest = factor.solve(right[: epochs * size].reshape(epochs, size), right[epochs * size :])
    np.testing.assert_allclose(np.append(moving, rest), np.linalg.solve(full, right), rtol=1e-8, atol=1e-10)

    inverse = np.linalg.inv(full)
    marginals = factor.marginals()
    np.testing.assert_allclose(
        marginals.border, inverse[epochs * size :, epochs * size :], rtol=1e-8, atol=1e-12
    )
    for t in range(epochs):
        here = slice(t * size, (t + 1) * size)
        np.testing.assert_allclose(marginals.chain[t], inverse[here, here], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(marginals.cross[t], inverse[here, epochs * size :], rtol=1e-8, atol=1e-12)


def test_damping_raises_the_diagonal_alone():
    """Levenberg-Marquardt's matrix: diagonal times (1 + damping), the rest as it was."""
    matrix = random_arrowhead(3, 2, 2, np.random.default_rng(1))
    full = dense(matrix)
    np.testing.assert_allclose(dense(matrix.damped(0.5)), full + 0.5 * np.diag(np.diag(full)))


def test_undetermined_states_are_refused():
    """A singular matrix says that something is not determined."""
    matrix = random_arrowhead(3, 2, 2, np.random.default_rng(2))
    singular = Arrowhead(matrix.chain, matrix.link, matrix.border * 0.0, matrix.corner * 0.0)
    with pytest.raises(InputError, match="positive definite"):
        eliminate(singular)
