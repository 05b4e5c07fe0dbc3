"""Delays and directions together: bounds, honest claims, snapshots, ambiguities, false alarms."""

from __future__ import annotations

import os

import numpy as np
import pytest

from estimator.arrays import AntennaArray, UniformLinearArray, UniformPlanarArray
from estimator.channel.atoms import atoms_of, correlate, inner_products
from estimator.channel.bounds import delay_direction_covariance, joint_delay_variance
from estimator.channel.detection import delay_length, detection_threshold, false_alarm_probability
from estimator.channel.directions import directions
from estimator.channel.interpolation import SpectrumPlan
from estimator.channel.model import delay_atoms
from estimator.channel.nomp import NompConfig, NompPlan, estimate_paths
from estimator.errors import ConfigurationError, InputError
from estimator.waveform import OfdmGrid

GRID = OfdmGrid(28e9, 480e3, 128)
ARRAYS: dict[str, AntennaArray] = {
    "ula": UniformLinearArray(8, boresight_rad=0.4),
    "lying": UniformPlanarArray(4, 4, boresight_rad=-0.7, lying=True),
    "upright": UniformPlanarArray(4, 6, row_spacing_wavelengths=0.4),
}
BARE = NompConfig(floor_m=0.0, floor_rad=0.0)
SEED = int(os.environ.get("HAPSLAM_TEST_SEED", "7"))


def noisy(rng, array, delay, azimuth, elevation, gain, noise):
    """Channels (C, S, antennas, tones) of paths (C, K) with gains (C, S, K) in noise."""
    steering = array.steering(azimuth, elevation)
    data = np.einsum("csk,ckm,ckn->csmn", gain, steering, delay_atoms(GRID, delay))
    return data + np.sqrt(0.5 * noise) * (rng.normal(size=data.shape) + 1j * rng.normal(size=data.shape))


def phases(rng, *shape):
    return np.exp(2j * np.pi * rng.uniform(size=shape))


def assert_one(values, slack):
    """The mean is 1 within four Monte-Carlo errors and a slack."""
    assert abs(np.mean(values) - 1.0) < 4.0 * np.std(values) / np.sqrt(values.size) + slack, np.mean(values)


@pytest.mark.parametrize("name", ARRAYS)
def test_joint_bound_equals_the_full_fisher_information(name: str) -> None:
    """The closed forms give the inverse Fisher information of all parameters, gains included."""
    rng = np.random.default_rng([SEED, 1])
    array, noise, snapshots, paths = ARRAYS[name], 0.1, 2, 2
    axes = 1 + len(array.shape)
    sizes = np.array([GRID.tones, *array.shape])
    points = rng.uniform(-0.2, 0.2, (1, 1, axes)) + np.arange(paths)[:, None] * 0.7 / sizes
    gain = phases(rng, snapshots, paths) * np.array([1.0, 0.6])
    places = np.indices(tuple(sizes)).reshape(axes, -1) - 0.5 * (sizes[:, None] - 1.0)

    def atom(x):
        return np.exp(-2j * np.pi * (x @ places))

    rows = []
    for k in range(paths):
        for d in range(axes):
            slope = -2j * np.pi * places[d] * atom(points[0, k])
            rows.append(np.concatenate([gain[s, k] * slope for s in range(snapshots)]))
    for k in range(paths):
        for s in range(snapshots):
            for unit in (1.0, 1j):
                row = np.zeros((snapshots, places.shape[1]), dtype=complex)
                row[s] = unit * atom(points[0, k])
                rows.append(row.ravel())
    jacobian = np.array(rows)
    full = np.linalg.inv(2.0 / noise * np.real(jacobian.conj() @ jacobian.T))
    scale = np.array([GRID.tone_spacing_hz] + [-spacing for spacing in array.spacings])
    found = delay_direction_covariance(
        GRID, array, points[0, :, 0] / scale[0], points[0, :, 1:] / scale[1:], gain, noise
    )
    for k in range(paths):
        own = slice(k * axes, (k + 1) * axes)
        np.testing.assert_allclose(found[k] * np.outer(scale, scale), full[own, own], rtol=1e-6, atol=1e-18)


@pytest.mark.parametrize("name", ARRAYS)
def test_derivatives_of_correlations_agree_with_differences(name: str) -> None:
    """Correlations are the inner products with atoms; slopes and curvatures are their differences."""
    rng = np.random.default_rng([SEED, 2])
    array = ARRAYS[name]
    atoms = atoms_of(GRID.tones, array.shape)
    axes, antennas = len(atoms.sizes), len(atoms.places)
    data = rng.normal(size=(2, antennas, GRID.tones)) + 1j * rng.normal(size=(2, antennas, GRID.tones))
    spectra, work = SpectrumPlan(GRID.tones).of(data), np.empty((2, antennas, 3), dtype=complex)
    numbers = np.arange(GRID.tones) - 0.5 * (GRID.tones - 1.0)

    def found(point):
        out = np.empty((2, 1 + 2 * axes), dtype=complex)
        correlate(atoms, spectra, point, work, out)
        return out[:, 0], out[:, 1 : 1 + axes], out[:, 1 + axes :]

    for point in rng.uniform(-0.4, 0.4, (3, axes)):
        z, slope, curvature = found(point)
        atom = np.exp(2j * np.pi * (atoms.places @ point[1:])[:, None] + 2j * np.pi * numbers * point[0])
        np.testing.assert_allclose(z, np.sum(atom * data, axis=(1, 2)), rtol=1e-10)
        for d in range(axes):
            h = 1e-5 / atoms.sizes[d] * np.eye(axes)[d]
            ahead, behind, step = found(point + h), found(point - h), 2.0 * h[d]
            np.testing.assert_allclose((ahead[0] - behind[0]) / step, slope[:, d], rtol=1e-5)
            np.testing.assert_allclose((ahead[1][:, d] - behind[1][:, d]) / step, curvature[:, d], rtol=1e-5)


@pytest.mark.parametrize("name", ARRAYS)
def test_derivatives_of_kernels_agree_with_complex_steps(name: str) -> None:
    """The Gram matrix is the sum of cosines over all samples; its derivatives are complex steps of that."""
    rng = np.random.default_rng([SEED, 8])
    array = ARRAYS[name]
    sizes = atoms_of(16, array.shape).sizes
    axes = len(sizes)
    places = np.indices(tuple(sizes)).reshape(axes, -1) - 0.5 * (sizes[:, None] - 1.0)
    points = rng.uniform(-0.15, 0.15, (4, axes))
    difference = points[:, None] - points
    found = inner_products(sizes, points)

    def gram(x):
        return np.sum(np.cos(2.0 * np.pi * (x @ places)), axis=-1)

    def slope(x, d):
        return np.sum(-2.0 * np.pi * places[d] * np.sin(2.0 * np.pi * (x @ places)), axis=-1)

    np.testing.assert_allclose(found.kernel, gram(difference), atol=1e-9)
    for d in range(axes):
        stepped = difference + 1e-20j * np.eye(axes)[d]
        np.testing.assert_allclose(found.slope[d], gram(stepped).imag / 1e-20, atol=1e-7)
        for e in range(axes):
            np.testing.assert_allclose(found.curvature[d, e], slope(stepped, e).imag / 1e-20, atol=1e-5)


@pytest.mark.parametrize("runs", [80, pytest.param(400, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", ARRAYS)
def test_errors_meet_the_bound_and_the_claims(name: str, runs: int) -> None:
    """Two paths in one delay cell, told apart by direction: both found, errors at the joint bound."""
    rng = np.random.default_rng([SEED, 3])
    array, noise = ARRAYS[name], 0.02
    offset = rng.uniform(-0.5, 0.5, (runs, 1)) + np.array([-0.4, 0.4])
    azimuth = array.boresight_rad + offset
    elevation = np.full((runs, 2), 0.25 if name != "ula" else 0.0)
    delay = rng.uniform(2e-7, 1e-6, (runs, 1)) + np.array([0.0, 0.3]) * GRID.resolution_s
    gain = phases(rng, runs, 1, 2) * np.array([1.0, 0.7])
    cfr = noisy(rng, array, delay, azimuth, elevation, gain, noise)
    found = estimate_paths(cfr[:, 0], noise, GRID, array, BARE)
    both = np.array([len(e) == 2 for e in found])
    assert np.mean(both) > 0.97
    projection = array.projection(azimuth, elevation)
    bound = delay_direction_covariance(GRID, array, delay, projection, gain, np.full(runs, noise))
    rows = np.flatnonzero(both)
    order = np.argsort([np.abs(found[i].gain) for i in rows], axis=1)[:, ::-1]  # the stronger is first
    got = np.take_along_axis(np.array([found[i].delay_s for i in rows]), order, axis=1)
    assert_one((got - delay[both]) ** 2 / bound[both][..., 0, 0], 0.06)
    angles = [found[i].directions for i in rows]
    assert all(a is not None for a in angles)
    az, std = (
        np.take_along_axis(np.array([getattr(a, field) for a in angles]), order, axis=1)
        for field in ("azimuth_rad", "azimuth_std_rad")
    )
    assert_one(np.angle(np.exp(1j * (az - azimuth[both]))) ** 2 / std**2, 0.2)
    if name == "upright":  # an upright array sees the elevation's sign as well
        el = np.take_along_axis(np.array([a.elevation_rad for a in angles]), order, axis=1)
        el_std = np.take_along_axis(np.array([a.elevation_std_rad for a in angles]), order, axis=1)
        assert_one((el - elevation[both]) ** 2 / el_std**2, 0.2)
    if name == "ula":
        assert all(np.all(np.isnan(a.elevation_rad)) for a in angles)


def test_a_lying_array_tells_all_azimuths() -> None:
    """Azimuths all around are found as they are, from a planar array in the horizontal plane."""
    rng = np.random.default_rng([SEED, 4])
    array = ARRAYS["lying"]
    azimuth = np.linspace(-3.1, 3.1, 40)[:, None]
    delay = np.full((40, 1), 4e-7)
    cfr = noisy(rng, array, delay, azimuth, np.full((40, 1), 0.1), phases(rng, 40, 1, 1), 1e-3)
    found = NompPlan(GRID, None, array).estimate(cfr[:, 0], 1e-3)
    got = np.array([e.directions.azimuth_rad[0] for e in found if e.directions is not None])
    assert len(got) == 40
    assert np.max(np.abs(np.angle(np.exp(1j * (got - azimuth[:, 0]))))) < 0.01
    assert array.tells_azimuth
    assert not ARRAYS["ula"].tells_azimuth
    assert not ARRAYS["upright"].tells_azimuth


def test_snapshots_add_up() -> None:
    """Eight snapshots with gains of their own: found where one is not, with the error of the joint bound."""
    rng = np.random.default_rng([SEED, 5])
    runs, snapshots, noise = 200, 8, 24.0
    delay = rng.uniform(2e-7, 1e-6, (runs, 1))
    gain = phases(rng, runs, snapshots, 1)
    cfr = np.einsum("csk,ckn->csn", gain, delay_atoms(GRID, delay))
    cfr = cfr + np.sqrt(0.5 * noise) * (rng.normal(size=cfr.shape) + 1j * rng.normal(size=cfr.shape))
    plan = NompPlan(GRID, BARE)
    alone, together = plan.estimate(cfr[:, 0], noise), plan.estimate(cfr, noise)
    assert np.mean([len(e) for e in alone]) < 0.4
    assert np.mean([len(e) > 0 for e in together]) > 0.99
    assert together[0].gain.shape == (snapshots, len(together[0]))
    error = np.array([e.delay_s[0] for e in together if len(e)]) - delay[[len(e) > 0 for e in together], 0]
    close = np.abs(error) < GRID.resolution_s
    assert np.mean(close) > 0.95
    bound = joint_delay_variance(GRID, [4e-7], [1.0], noise)[0] / snapshots
    assert_one(error[close] ** 2 / bound, 0.35)  # near the threshold, second-order terms


@pytest.mark.parametrize("runs", [120, pytest.param(600, marks=pytest.mark.soak)])
@pytest.mark.parametrize("snapshots", [1, 4])
@pytest.mark.parametrize("name", ["ula", "lying"])
def test_noise_alone_gives_paths_at_the_stated_rate(name: str, snapshots: int, runs: int) -> None:
    """Over delays and directions, one or several snapshots: at most the stated rate, and not far below.

    The box of an array's two axes holds more than the directions there are (a disc in it), and the
    search's grid misses some peaks.
    """
    rng = np.random.default_rng([SEED, 6, snapshots])
    array, rate = ARRAYS[name], 0.2
    shape = (runs, snapshots, array.elements, 64)
    data = np.sqrt(0.5) * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    grid = OfdmGrid(28e9, 480e3, 64)
    found = NompPlan(grid, NompConfig(false_alarm=rate, max_paths=1), array).estimate(data, 1.0)
    share = np.mean([len(e) > 0 for e in found])
    deviation = np.sqrt(rate * (1.0 - rate) / runs)
    assert 0.4 * rate < share < rate + 4.0 * deviation


def test_threshold_for_snapshots_inverts_the_probability() -> None:
    """One to three axes, one to fifty snapshots: the threshold of a probability has that probability."""
    lengths = delay_length(200), delay_length(8), delay_length(4)
    for snapshots in (1, 2, 50):
        for axes in (1, 2, 3):
            level = detection_threshold(0.01, *lengths[:axes], snapshots=snapshots)
            again = false_alarm_probability(level, *lengths[:axes], snapshots=snapshots)
            assert again == pytest.approx(0.01, rel=1e-6)
    with pytest.raises(InputError, match="snapshots: expected at least 1, got 0"):
        detection_threshold(0.01, 10.0, snapshots=0)
    with pytest.raises(InputError, match="lengths: expected one to three, got 0"):
        detection_threshold(0.01)


@pytest.mark.parametrize("name", ARRAYS)
def test_angles_follow_their_components(name: str) -> None:
    """Angles of the components of a direction are that direction; deviations follow by differences."""
    array = ARRAYS[name]
    azimuth, elevation = array.boresight_rad + 0.6, 0.0 if name == "ula" else 0.5
    projection = array.projection([azimuth], [elevation])
    covariance = 1e-6 * (np.eye(len(array.shape)) + 0.3 * np.ones((len(array.shape),) * 2))[None]
    found = directions(array, projection, covariance)
    assert found.azimuth_rad[0] == pytest.approx(azimuth)
    names = ["azimuth_rad"]
    if name != "ula":
        assert found.elevation_rad[0] == pytest.approx(elevation)
        names.append("elevation_rad")
    for field in names:
        row = np.array(
            [
                (getattr(directions(array, projection + h, covariance), field)[0] - getattr(found, field)[0])
                / 1e-7
                for h in 1e-7 * np.eye(len(array.shape))
            ]
        )
        std = getattr(found, field.replace("_rad", "_std_rad"))[0]
        assert std == pytest.approx(np.sqrt(row @ covariance[0] @ row), rel=1e-4)


def test_an_elevation_near_the_horizon_is_not_claimed() -> None:
    """In a lying array's plane the elevation is flat in what is measured: NaN, not a guess."""
    array = ARRAYS["lying"]
    found = directions(array, array.projection([0.3], [0.0]), 1e-4 * np.eye(2)[None])
    assert np.isnan(found.elevation_rad[0])
    assert np.isnan(found.elevation_std_rad[0])


def test_arrays_and_channels_that_do_not_fit_are_refused() -> None:
    """An axis of one element, another number of antennas, and what is not finite."""
    with pytest.raises(ConfigurationError, match="at least 2 elements on each axis"):
        NompPlan(GRID, None, UniformLinearArray(1))
    with pytest.raises(ConfigurationError, match="at least 2 elements on each axis"):
        NompPlan(GRID, None, UniformPlanarArray(1, 4))
    plan = NompPlan(GRID, None, UniformLinearArray(4))
    with pytest.raises(InputError, match=r"expected shape \(n, 4, 128\), got \(2, 3, 128\)"):
        plan.estimate(np.zeros((2, 3, 128)), 1.0)
    bad = np.zeros((1, 4, 128), dtype=complex)
    bad[0, 2, 9] = np.inf
    with pytest.raises(InputError, match="in row 0, tone 9"):
        plan.estimate(bad, 1.0)
    assert len(plan.estimate(np.zeros((1, 4, 128)), 1.0)[0]) == 0
