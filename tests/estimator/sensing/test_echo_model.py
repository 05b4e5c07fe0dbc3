"""Least squares of returns against explicit matrices of atoms and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.arrays import BeamSet
from estimator.channel.model import delay_atoms
from estimator.sensing.echo_model import EchoFit, EchoModel
from estimator.waveform import OfdmGrid

GRID = OfdmGrid(28e9, 480e3, 48)
BEAMS = BeamSet(panels=4, elements=4, beams=16)


def columns(model: EchoModel, turns: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Blanked atoms as columns, (beams * tones, K)."""
    tones = delay_atoms(GRID, turns / GRID.tone_spacing_hz)
    atoms = BEAMS.two_way(azimuth)[:, :, None] * tones[:, None, :]
    return np.stack([model.blank(atom).ravel() for atom in atoms], axis=1)


@pytest.mark.parametrize("blind_range_m", [0.0, 4.0])
def test_projection_equals_explicit_least_squares(blind_range_m: float) -> None:
    """Gains, energy, gradient and information equal those of the full matrices."""
    rng = np.random.default_rng(41)
    model = EchoModel(GRID, BEAMS, blind_range_m)
    turns = np.array([12.0, 40.0, 41.0]) * model.turns_per_m
    azimuth = np.array([0.3, -2.0, 1.2])
    shape = (BEAMS.beams, GRID.tones)
    data = model.blank(rng.normal(size=shape) + 1j * rng.normal(size=shape))
    fit = model.project(data, turns, azimuth)

    atoms = columns(model, turns, azimuth)
    gain, *_ = np.linalg.lstsq(atoms, data.ravel(), rcond=None)
    np.testing.assert_allclose(fit.gain, gain, rtol=1e-8)
    explained = atoms @ gain
    assert fit.energy == pytest.approx(np.linalg.norm(explained) ** 2, rel=1e-8)
    np.testing.assert_allclose(model.synthesise(fit).ravel(), explained, atol=1e-8)

    step_turns, step_azimuth = 1e-6, 1e-5
    slopes = np.concatenate(
        [
            (columns(model, turns + step_turns, azimuth) - columns(model, turns - step_turns, azimuth))
            / (2.0 * step_turns),
            (columns(model, turns, azimuth + step_azimuth) - columns(model, turns, azimuth - step_azimuth))
            / (2.0 * step_azimuth),
        ],
        axis=1,
    ) * np.concatenate([gain, gain])
    gradient = np.real(slopes.conj().T @ (data.ravel() - explained))
    np.testing.assert_allclose(fit.gradient, gradient, rtol=1e-4, atol=1e-5 * np.abs(gradient).max())
    coefficients = np.linalg.lstsq(atoms, slopes, rcond=None)[0]
    information = np.real(slopes.conj().T @ (slopes - atoms @ coefficients))
    scale = np.sqrt(np.outer(np.diag(information), np.diag(information)))
    np.testing.assert_allclose(fit.information / scale, information / scale, atol=1e-4)


def test_blanking_removes_near_delays_and_is_a_projection() -> None:
    """Delays within the blind range vanish in any pattern over the beams; blanking twice is blanking once."""
    rng = np.random.default_rng(42)
    model = EchoModel(GRID, BEAMS, 4.0)
    delays = rng.uniform(0.0, 4.0, 5) * model.turns_per_m / GRID.tone_spacing_hz
    near = rng.normal(size=(BEAMS.beams, 5)) @ delay_atoms(GRID, delays)
    assert np.linalg.norm(model.blank(near)) < 1e-2 * np.linalg.norm(near)
    data = rng.normal(size=(BEAMS.beams, GRID.tones)) + 0j
    once = model.blank(data)
    np.testing.assert_allclose(model.blank(once), once, atol=1e-12)


def test_no_returns_explain_nothing() -> None:
    """The empty fit has no paths and no energy."""
    fit = EchoFit.empty()
    assert (len(fit.turns), len(fit.gain), fit.energy) == (0, 0, 0.0)
