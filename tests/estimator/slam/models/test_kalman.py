"""Sparse Kalman updates against the information form and SciPy's densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from estimator.slam.models.kalman import joint_update, projected, scalar_update

SIZE, ENTRIES = 7, 3


def problem(seed, count=4):
    """A Gaussian and measurements with three derivatives each, dense and sparse."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(SIZE, SIZE))
    index = np.array([rng.choice(SIZE, ENTRIES, replace=False) for _ in range(count)])
    value = rng.normal(size=(count, ENTRIES))
    jacobian = np.zeros((count, SIZE))
    np.put_along_axis(jacobian, index, value, axis=1)
    covariance = root @ root.T
    covariance = 0.5 * (covariance + covariance.T)
    return (
        rng.normal(size=SIZE),
        covariance,
        index,
        value,
        jacobian,
        rng.normal(size=count),
        rng.uniform(0.5, 2.0, size=count),
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_joint_update_is_the_textbooks(seed):
    """Means, covariances and evidence of several measurements at once, linearised at one state."""
    mean, covariance, index, value, jacobian, innovation, variance = problem(seed)
    found, spread = mean.copy(), covariance.copy()
    entries = np.full(len(index), ENTRIES)
    log_density = joint_update(found, spread, index, value, entries, innovation, variance)
    noise = np.diag(variance)
    posterior = np.linalg.inv(np.linalg.inv(covariance) + jacobian.T @ np.linalg.inv(noise) @ jacobian)
    shift = posterior @ jacobian.T @ np.linalg.inv(noise) @ innovation
    np.testing.assert_allclose(spread, posterior, atol=1e-8)
    np.testing.assert_allclose(found, mean + shift, atol=1e-8)
    s = jacobian @ covariance @ jacobian.T + noise
    assert log_density == pytest.approx(multivariate_normal(cov=s).logpdf(innovation))
    assert np.array_equal(spread, spread.T)


def test_the_order_of_measurements_does_not_matter():
    """One after the other is the joint update, in any order."""
    mean, covariance, index, value, _, innovation, variance = problem(9)
    results = []
    for order in (np.arange(4), np.array([2, 0, 3, 1])):
        found, spread = mean.copy(), covariance.copy()
        entries = np.full(4, ENTRIES)
        given = index[order], value[order], entries, innovation[order], variance[order]
        results.append((joint_update(found, spread, *given), found, spread))
    assert results[0][0] == pytest.approx(results[1][0])
    np.testing.assert_allclose(results[0][1], results[1][1], atol=1e-10)
    np.testing.assert_allclose(results[0][2], results[1][2], atol=1e-10)


def test_scalar_update_and_projection():
    """Variance along sparse derivatives; what is not correlated with a measurement stays to the bit."""
    mean, covariance, index, value, jacobian, innovation, variance = problem(4)
    covariance[0, :] = covariance[:, 0] = 0.0
    index[0] = [1, 2, 3]
    jacobian[0] = 0.0
    jacobian[0, 1:4] = value[0]
    cross, before = np.empty(SIZE), mean[0]
    found = projected(covariance, index[0], value[0], ENTRIES, cross)
    assert found == pytest.approx(jacobian[0] @ covariance @ jacobian[0])
    np.testing.assert_allclose(cross, jacobian[0] @ covariance, atol=1e-12)
    expected = multivariate_normal(cov=found + variance[0]).logpdf(innovation[0])
    given = index[0], value[0], ENTRIES, float(innovation[0]), float(variance[0]), cross
    assert scalar_update(mean, covariance, *given) == pytest.approx(expected)
    assert mean[0] == before
    assert not covariance[0].any()
