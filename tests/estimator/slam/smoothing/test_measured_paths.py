"""What paths add to the information of a run, and the variances of lengths, against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.models.directions import predict_azimuths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import Layout
from estimator.slam.smoothing.factors import PathFactors, column_of
from estimator.slam.smoothing.measured_paths import add_paths, length_variances

LAYOUT = Layout(2, 3)
EPOCHS = 4


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def trajectory(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    agent, still = rng.normal(scale=3.0, size=(EPOCHS, 4)), rng.normal(scale=20.0, size=LAYOUT.size)
    still[[LAYOUT.height2(k) for k in range(2)]] = 1.0
    return agent, still


def border_basis() -> np.ndarray:
    """Everything that stands still but a known coordinate; the biases of both anchors are one."""
    columns = [c for c in range(4, LAYOUT.size) if c not in (LAYOUT.wall(0).start + 1, LAYOUT.bias(1))]
    basis = np.zeros((LAYOUT.size, len(columns)))
    basis[columns, np.arange(len(columns))] = 1.0
    basis[LAYOUT.bias(1), columns.index(LAYOUT.bias(0))] = 1.0
    return basis


def states_of(agent: np.ndarray, still: np.ndarray) -> np.ndarray:
    states = np.tile(still, (len(agent), 1))
    states[:, :4] = agent
    return states


def test_paths_add_what_their_dense_derivatives_do(rng: np.random.Generator) -> None:
    """Lengths and directions over none, one and two walls: matrix, right-hand side and cost."""
    agent, still = trajectory(rng)
    basis, states = border_basis(), states_of(agent, still)
    epoch, anchor, feature = (
        np.array([0, 0, 1, 2, 2, 3]),
        np.array([0, 1, 1, 0, 0, 1]),
        np.array([0, 2, 5, 1, 9, 3]),
    )
    pick = (epoch, anchor, feature)
    lengths = predict_paths(states, LAYOUT)
    azimuth, turned = predict_azimuths(states, LAYOUT)
    std, azimuth_std = rng.uniform(0.1, 0.3, 6), np.array([0.02, np.inf, 0.03, np.inf, 0.02, 0.05])
    offsets = 0.01 * rng.normal(size=6)
    factors = PathFactors(
        *pick, lengths.length_m[pick] + std * rng.normal(size=6), std, azimuth[pick] + offsets, azimuth_std
    )
    size = basis.shape[1]
    chain, border, corner = np.zeros((EPOCHS, 4, 4)), np.zeros((EPOCHS, 4, size)), np.zeros((size, size))
    right, below = np.zeros((EPOCHS, 4)), np.zeros(size)
    arrays = (factors.length_m, factors.std_m, factors.azimuth_rad, factors.azimuth_std_rad)
    cost = add_paths(
        LAYOUT, agent, still, column_of(basis), *pick, *arrays, chain, border, corner, right, below
    )

    rows = np.concatenate([lengths.jacobian[pick] / std[:, None], turned[pick] / azimuth_std[:, None]])
    residual = np.concatenate([(factors.length_m - lengths.length_m[pick]) / std, offsets / azimuth_std])
    moving, standing, at = rows[:, :4], rows @ basis, np.tile(epoch, 2)
    assert cost == pytest.approx(residual @ residual)
    np.testing.assert_allclose(corner, standing.T @ standing, atol=1e-9)
    np.testing.assert_allclose(below, standing.T @ residual, atol=1e-9)
    for t in range(EPOCHS):
        here = at == t
        np.testing.assert_allclose(chain[t], moving[here].T @ moving[here], atol=1e-9)
        np.testing.assert_allclose(border[t], moving[here].T @ standing[here], atol=1e-9)
        np.testing.assert_allclose(right[t], moving[here].T @ residual[here], atol=1e-9)


def test_variances_of_lengths_are_projected_covariances(rng: np.random.Generator) -> None:
    """Of every feature, with the covariances of agent and border and between them."""
    agent, still = trajectory(rng)
    basis = border_basis()
    size = 4 + basis.shape[1]
    root = rng.normal(size=(EPOCHS, size, size + 2))
    root[:, 4:] = root[0, 4:]  # the border is one for all epochs
    joint = root @ root.transpose(0, 2, 1)
    found = length_variances(
        LAYOUT,
        agent,
        still,
        column_of(basis),
        np.ascontiguousarray(joint[:, :4, :4]),
        np.ascontiguousarray(joint[:, :4, 4:]),
        np.ascontiguousarray(joint[0, 4:, 4:]),
    )
    jacobian = predict_paths(states_of(agent, still), LAYOUT).jacobian
    both = np.concatenate([jacobian[..., :4], jacobian @ basis], axis=-1)
    np.testing.assert_allclose(found, np.einsum("tkfi,tij,tkfj->tkf", both, joint, both), rtol=1e-9)
