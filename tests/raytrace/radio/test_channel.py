"""Channel sums against direct sums and the ray tracer's own, and the noise."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.waveform import OfdmGrid
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.passive import TraceReport
from raytrace.propagation.paths import PathSet
from raytrace.propagation.scene import RadioScene
from raytrace.propagation.solver import _path_list, _sionna_paths
from raytrace.radio.channel import add_noise, channel_response, superpose

Traced = tuple[FloorPlan, RadioScene, PathSet, TraceReport]

GRID = OfdmGrid(28e9, 120e3, 3276, 4, 12)


@pytest.mark.parametrize("tones", [2, 3, 50, 819])
def test_factored_sum_is_the_direct_sum(tones: int) -> None:
    """The two-factor sum over tones equals ``sum a exp(-j 2 pi f tau)`` for any number of tones."""
    rng = np.random.default_rng(tones)
    grid = OfdmGrid(28e9, 480e3, tones)
    delay = rng.uniform(1e-8, 1e-6, (5, 7))
    weights = rng.standard_normal((5, 3, 7)) + 1j * rng.standard_normal((5, 3, 7))
    direct = np.einsum("bsp,bpt->bst", weights, np.exp(-2j * np.pi * delay[..., None] * grid.offsets_hz()))
    np.testing.assert_allclose(superpose(weights, delay, grid), direct, atol=1e-11)


def test_empty_slots_add_nothing(l_room: Traced) -> None:
    """Padding a channel to a larger rank leaves its response as it was."""
    _, _, paths, _ = l_room
    flat = paths.flat()
    lonely = flat.select((flat.epoch == 0) & (flat.anchor == 0))
    padded = channel_response(paths, GRID)[0, 0]
    alone = channel_response(PathSet.build(lonely, 1, 1), GRID)[0, 0]
    np.testing.assert_allclose(padded, alone, rtol=1e-12)


def test_cfr_is_that_of_the_ray_tracer(l_room: Traced) -> None:
    """Our sum equals Sionna's ``cfr(normalize_delays=False)``, in its single precision."""
    plan, radio, _, _ = l_room
    targets = plan.track()[::40]
    for source in plan.anchors_m():
        sionna = _sionna_paths(radio, source, targets, 2, 6000, True, False, 200_000)
        ours = channel_response(PathSet.build(_path_list(radio, sionna, 2), len(targets), 1), GRID)[:, 0, 0]
        theirs = sionna.cfr(
            frequencies=GRID.offsets_hz().astype(np.float32), normalize_delays=False, out_type="numpy"
        )[0, :, 0, 0, 0]
        scale = np.abs(theirs).max(axis=1, keepdims=True)
        assert np.abs(ours - theirs).max() < 0.03 * scale.min()

        normalised = sionna.cfr(
            frequencies=GRID.offsets_hz().astype(np.float32), normalize_delays=True, out_type="numpy"
        )[0, :, 0, 0, 0]
        assert np.abs(ours - normalised).max() > scale.min()  # the default loses the absolute delay


def test_delay_is_absolute(l_room: Traced) -> None:
    """The strongest tap of a noiseless CFR lies at the distance to the anchor over c."""
    plan, _, paths, _ = l_room
    response = channel_response(paths, GRID)[0, :, 0]
    taps = np.abs(np.fft.ifft(response, n=16 * GRID.tones, axis=-1))
    delay = np.argmax(taps, axis=-1) / (16 * GRID.tones * GRID.tone_spacing_hz)
    distance = np.linalg.norm(plan.anchors_m() - plan.track()[0], axis=1)
    np.testing.assert_allclose(delay * 299_792_458.0, distance, atol=0.1)


def test_noise_has_the_variance_it_should() -> None:
    """Circular, of the stated variance: means within five Monte-Carlo standard errors."""
    count, variance = 200_000, 4.1e-13
    noise = add_noise(np.zeros(count), variance, np.random.default_rng(7))
    error = variance / np.sqrt(count)  # of the mean of |n|^2, exponential with mean `variance`
    assert abs(np.mean(np.abs(noise) ** 2) - variance) < 5 * error
    assert abs(np.mean(noise**2)) < 5 * np.sqrt(2) * error
    assert abs(np.mean(noise)) < 5 * np.sqrt(variance / count)


def test_noise_repeats_with_the_seed() -> None:
    """Equal generators give equal noise, bit for bit; others do not."""
    one, same, other = (add_noise(np.ones(10), 1.0, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.any(one == other)
