"""Bounds against the Fisher information built without closed forms, and against the paper's."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.channel.bounds import delay_variance, joint_delay_variance, range_variance
from estimator.channel.model import delay_atoms
from estimator.errors import InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

GRID = OfdmGrid(28e9, 120e3, 200)


def brute_force(delay: np.ndarray, gain: np.ndarray, noise_variance: float) -> np.ndarray:
    """Inverse of the full Fisher information of delays, real and imaginary parts of the gains."""
    atoms = delay_atoms(GRID, delay).T  # (tones, K)
    slopes = -2j * np.pi * GRID.offsets_hz()[:, None] * atoms * gain
    scale = 1e-9  # nanoseconds, for conditioning
    jacobian = np.concatenate([slopes * scale, atoms, 1j * atoms], axis=1)
    information = 2.0 / noise_variance * np.real(jacobian.conj().T @ jacobian)
    return np.diag(np.linalg.inv(information))[: len(delay)] * scale**2


@pytest.mark.parametrize("cells", [0.3, 1.0, 2.7])
def test_joint_bound_equals_the_full_fisher_information(cells: float) -> None:
    """Eliminating the gains in closed form changes nothing, near or far apart."""
    rng = np.random.default_rng(3)
    delay = 3e-7 + np.array([0.0, cells, 5.3]) * GRID.resolution_s
    gain = rng.normal(size=3) + 1j * rng.normal(size=3)
    expected = brute_force(delay, gain, 0.02)
    np.testing.assert_allclose(joint_delay_variance(GRID, delay, gain, 0.02), expected, rtol=1e-6)


def test_joint_bound_of_one_path_is_the_single_bound() -> None:
    """With one path the joint bound is the textbook formula, for a batch of channels."""
    gain = np.array([[1.0 + 1.0j], [0.1j]])
    noise = np.array([0.5, 0.2])
    joint = joint_delay_variance(GRID, np.full((2, 1), 4e-7), gain, noise)
    np.testing.assert_allclose(joint, delay_variance(GRID, np.array([[4.0], [0.05]])), rtol=1e-9)


@pytest.mark.parametrize(("snr_db", "metres"), [(-8.0, 0.4325), (0.0, 0.1722), (10.0, 0.0544)])
def test_two_way_range_bound_is_equation_16(snr_db: float, metres: float) -> None:
    """Two ways it is (16) of the paper, worth these standard deviations; one way four times that."""
    snr = 10.0 ** (snr_db / 10.0)
    bound = range_variance(GRID, snr, two_way=True)
    paper = 3.0 * SPEED_OF_LIGHT_M_S**2 / (8.0 * np.pi**2 * GRID.bandwidth_hz**2 * GRID.tones * snr)
    np.testing.assert_allclose(bound, paper, rtol=1e-4)
    np.testing.assert_allclose(np.sqrt(bound), metres, atol=6e-5)
    np.testing.assert_allclose(range_variance(GRID, snr), 4.0 * bound)


def test_coinciding_delays_have_no_bound() -> None:
    """Two equal delays are refused with a message, not with an infinite variance."""
    with pytest.raises(InputError, match="expected delays that all differ"):
        joint_delay_variance(GRID, np.full(2, 1e-7), np.ones(2), 1.0)
