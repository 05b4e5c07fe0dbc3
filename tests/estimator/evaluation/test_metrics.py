"""Figures of merit against brute force, SciPy and Monte Carlo."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import chi2, kstest

from estimator.errors import InputError
from estimator.evaluation.metrics import (
    best_rotation,
    derotated,
    distances,
    match,
    mean_absolute_error,
    mospa,
    nees,
    nees_band,
    ospa,
    root_mean_square_error,
)
from estimator.geometry import rotate


def brute_force_ospa(x: np.ndarray, y: np.ndarray, c: float, p: float) -> float:
    """OSPA by its definition: the best of all injections of the smaller set into the larger."""
    small, large = sorted((x, y), key=len)
    m, n = len(small), len(large)
    costs = [
        sum(min(c, float(np.hypot(*(small[i] - large[j])))) ** p for i, j in enumerate(chosen))
        for chosen in permutations(range(n), m)
    ]
    return ((min(costs) + c**p * (n - m)) / n) ** (1.0 / p)


@pytest.mark.parametrize("order", [1.0, 2.0])
@pytest.mark.parametrize(("m", "n"), [(1, 1), (3, 3), (2, 4), (5, 3), (0, 2)])
def test_ospa_is_the_best_of_all_assignments(m: int, n: int, order: float) -> None:
    """OSPA equals the minimum over all injections, for sets of equal and different sizes."""
    rng = np.random.default_rng(10 * m + n)
    for _ in range(20):
        x, y = rng.uniform(0.0, 12.0, (m, 2)), rng.uniform(0.0, 12.0, (n, 2))
        assert ospa(x, y, 5.0, order) == pytest.approx(brute_force_ospa(x, y, 5.0, order), rel=1e-12)


def test_ospa_of_special_sets() -> None:
    """Two empty sets agree, an empty one is the cut-off away, and nothing is farther."""
    assert ospa([], []) == 0.0
    assert ospa([], [[1.0, 2.0]], 7.0) == 7.0
    assert ospa([[0.0, 0.0]], [[100.0, 0.0]], 7.0) == 7.0
    assert ospa([[0.0, 0.0], [3.0, 4.0]], [[3.0, 4.0]], 10.0) == 5.0


def test_ospa_is_a_metric() -> None:
    """OSPA is symmetric and keeps the triangle inequality."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        x, y, z = (rng.uniform(0.0, 10.0, (rng.integers(0, 4), 2)) for _ in range(3))
        assert ospa(x, y, 3.0, 2.0) == pytest.approx(ospa(y, x, 3.0, 2.0))
        assert ospa(x, z, 3.0, 2.0) <= ospa(x, y, 3.0, 2.0) + ospa(y, z, 3.0, 2.0) + 1e-12


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0.0, 0.0]], [[0.0, 0.0]], 0.0), "cutoff_m: expected a positive number, got 0"),
        (([[0.0, 0.0]], [[0.0, 0.0]], float("nan")), "cutoff_m: expected a positive number, got nan"),
        (([[0.0, 0.0]], [[0.0, 0.0]], 1.0, 0.5), "order: expected at least 1, got 0.5"),
        (([[0.0, np.nan]], [[0.0, 0.0]]), "estimate: expected finite numbers, got nan"),
        (([[0.0, 0.0, 0.0]], [[0.0, 0.0]]), r"estimate: expected shape \(\.\.\., 2\), got \(1, 3\)"),
        (([[0.0, 0.0]], [0.0, 0.0]), r"truth: expected shape \(n, 2\), got \(2,\)"),
    ],
)
def test_ospa_refuses_bad_input(arguments: tuple[object, ...], message: str) -> None:
    """Bad cut-offs, orders and points are named."""
    with pytest.raises(InputError, match=message):
        ospa(*arguments)


def test_mospa_is_the_mean_over_sets() -> None:
    """The mean of the OSPA distances of each pair; sets must come in pairs."""
    one, two = np.array([[0.0, 0.0]]), np.array([[3.0, 4.0]])
    assert mospa([one, one], [one, two]) == pytest.approx(2.5)
    assert mospa([one, np.zeros((0, 2))], [two, two], cutoff_m=4.0) == pytest.approx(4.0)
    for estimates, truths in (([], []), ([one], [one, two])):
        with pytest.raises(InputError, match="as many sets as truths"):
            mospa(estimates, truths)


def test_mean_errors_by_hand() -> None:
    """MAE and RMSE of errors 3, 4 and 5 m."""
    truth = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    estimate = truth + np.array([[3.0, 0.0], [0.0, -4.0], [3.0, 4.0]])
    np.testing.assert_allclose(distances(estimate, truth), [3.0, 4.0, 5.0])
    assert mean_absolute_error(estimate, truth) == pytest.approx(4.0)
    assert root_mean_square_error(estimate, truth) == pytest.approx(np.sqrt(50.0 / 3.0))


def test_errors_need_equal_shapes() -> None:
    """Broadcasting one point against many would hide a mistake."""
    with pytest.raises(InputError, match=r"expected the truth's shape \(3, 2\), got \(1, 2\)"):
        distances([[0.0, 0.0]], np.zeros((3, 2)))


def test_best_rotation_is_the_minimum() -> None:
    """The closed form equals a numerical minimisation of the squared error."""
    rng = np.random.default_rng(3)
    truth = rng.uniform(-30.0, 30.0, (50, 2))
    estimate = rotate(truth, 0.21) + rng.normal(scale=2.0, size=truth.shape)

    def cost(angle: float) -> float:
        return float(np.sum((estimate - rotate(truth, angle)) ** 2))

    found = minimize_scalar(cost, bounds=(-1.0, 1.0), method="bounded", options={"xatol": 1e-10})
    angle = float(best_rotation(estimate, truth))
    assert angle == pytest.approx(found.x, abs=1e-7)
    assert root_mean_square_error(derotated(estimate, angle), truth) == pytest.approx(
        np.sqrt(cost(angle) / len(truth)), rel=1e-12
    )


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.5, 3.0, -3.0])
def test_rotations_are_undone(angle: float) -> None:
    """A track that is only turned about RP has no error left, whatever the angle."""
    truth = np.random.default_rng(4).uniform(-30.0, 30.0, (10, 2))
    estimate = rotate(truth, angle)
    assert float(best_rotation(estimate, truth)) == pytest.approx(angle, abs=1e-12)
    np.testing.assert_allclose(derotated(estimate, best_rotation(estimate, truth)), truth, atol=1e-12)


def test_rotation_per_epoch() -> None:
    """Leading axes give one angle each, as one call per epoch does."""
    rng = np.random.default_rng(6)
    truth = rng.uniform(-30.0, 30.0, (7, 5, 2))
    angles = rng.uniform(-1.0, 1.0, 7)
    estimate = np.stack([rotate(points, angle) for points, angle in zip(truth, angles, strict=True)])
    np.testing.assert_allclose(best_rotation(estimate, truth), angles, atol=1e-12)
    np.testing.assert_allclose(derotated(estimate, angles), truth, atol=1e-12)


def test_rotation_of_nothing() -> None:
    """Points that all lie at RP say nothing about the rotation."""
    assert float(best_rotation(np.zeros((3, 2)), np.zeros((3, 2)))) == 0.0


def test_nees_of_a_consistent_estimator_is_chi_square() -> None:
    """Errors drawn from the claimed covariances give chi-square; its quantiles give the band."""
    rng = np.random.default_rng(7)
    factors = rng.normal(size=(20_000, 2, 2)) + 2.0 * np.eye(2)
    covariance = factors @ factors.transpose(0, 2, 1)
    error = np.einsum("nij,nj->ni", factors, rng.normal(size=(20_000, 2)))
    values = nees(error, covariance)
    assert kstest(2.0 * values, chi2(2).cdf).pvalue > 1e-3
    low, high = nees_band(2)
    inside = np.mean((values > low) & (values < high))
    assert inside == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / len(values)))
    groups = values.reshape(-1, 50).mean(axis=1)
    low, high = nees_band(2, samples=50, probability=0.9)
    inside = np.mean((groups > low) & (groups < high))
    assert inside == pytest.approx(0.9, abs=4.0 * np.sqrt(0.9 * 0.1 / len(groups)))


def test_nees_by_hand() -> None:
    """A two-sigma error along one axis and none along the other gives 2 per dimension."""
    assert float(nees([2.0, 0.0], np.diag([1.0, 9.0]))) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.zeros((2, 2)), "expected positive definite"),
        (np.diag([1.0, -1.0]), "expected positive definite"),
        (np.eye(3), r"expected shape \(\.\.\., n, n\) for errors \(2,\), got \(3, 3\)"),
    ],
)
def test_nees_refuses_bad_covariances(covariance: np.ndarray, message: str) -> None:
    """A covariance that is singular, indefinite or of another size is named."""
    with pytest.raises(InputError, match=message):
        nees([1.0, 1.0], covariance)


def test_match_prefers_the_least_sum_within_the_gate() -> None:
    """Pairs beyond the gate are not made, and a greedy choice is not taken where it costs more."""
    truth = np.array([[0.0, 0.0], [1.5, 0.0], [50.0, 0.0]])
    estimate = np.array([[1.0, 0.0], [2.4, 0.0], [90.0, 0.0]])
    assert match(estimate, truth, 2.0) == [(0, 0), (1, 1)]
    assert match(estimate, truth, 0.6) == [(0, 1)]
    assert match([], truth, 2.0) == []
