"""Toeplitz covariances against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from estimator.channel.toeplitz import inverse_of, whiten

TURNS = (0.21, 0.04)  # onset and decay of an exponential tail


def column_of(tones: int) -> np.ndarray:
    """An exponential tail 20 dB above a noise floor."""
    lag = 2j * np.pi * np.arange(tones)
    column = 100.0 * np.exp(-lag * TURNS[0]) / (1.0 + lag * TURNS[1])
    column[0] += 1.0
    return column


def vectors_of(tones: int, count: int = 3) -> np.ndarray:
    rng = np.random.default_rng(tones)
    return rng.normal(size=(count, tones)) + 1j * rng.normal(size=(count, tones))


@pytest.mark.interpreted
@pytest.mark.parametrize("tones", [2, 7, 61])
def test_whitening_is_cholesky(tones: int) -> None:
    """The whitened vectors are those of the inverse of Cholesky's factor, and so is the determinant."""
    column, vectors = column_of(tones), vectors_of(tones)
    covariance = scipy.linalg.toeplitz(column)
    lower = np.linalg.cholesky(covariance)
    found = whiten(column, vectors)
    wanted = scipy.linalg.solve_triangular(lower, vectors.T, lower=True).T
    np.testing.assert_allclose(found.values, wanted, atol=1e-9)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("tones", [2, 7, 61])
def test_the_inverse_is_that_of_the_dense_matrix(tones: int) -> None:
    """Applied to vectors."""
    column, vectors = column_of(tones), vectors_of(tones)
    wanted = np.linalg.solve(scipy.linalg.toeplitz(column), vectors.T).T
    np.testing.assert_allclose(inverse_of(column).apply(vectors), wanted, atol=1e-9)


@pytest.mark.parametrize("tones", [7, 60, 61])
def test_the_energy_of_atoms_is_their_quadratic_form(tones: int) -> None:
    """On a grid of four delays a cell."""
    column, bins = column_of(tones), 4 * tones
    number = np.arange(tones) - 0.5 * (tones - 1)
    atoms = np.exp(-2j * np.pi * np.arange(bins)[:, None] / bins * number)
    dense = np.linalg.solve(scipy.linalg.toeplitz(column), atoms.T)
    wanted = np.einsum("bn,nb->b", np.conj(atoms), dense).real
    np.testing.assert_allclose(inverse_of(column).atom_energy(bins), wanted, rtol=1e-9)
