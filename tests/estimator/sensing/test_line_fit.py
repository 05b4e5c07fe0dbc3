"""Published and maximum-likelihood walls: claimed and actual errors, and wide beams."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.arrays import BeamSet
from estimator.errors import ConfigurationError, InputError
from estimator.geometry import mirror_in_wall
from estimator.sensing.linefit import BeamFan, fit_lines, fit_wall
from estimator.sensing.ranges import EchoLaw, variance_published
from estimator.sensing.uncertainty import average_pairs, paired_vrp
from estimator.waveform import OfdmGrid

NORMAL, DISTANCE = np.deg2rad(30.0), 10.0
VRP = 2.0 * DISTANCE * np.array([np.cos(NORMAL), np.sin(NORMAL)])
RUNS = 4000


def sweep(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ranges, standard deviations and directions of beams within 50 degrees of a wall's normal."""
    slant = np.deg2rad(np.linspace(-50.0, 50.0, count))
    distance = DISTANCE / np.cos(slant)
    variance = variance_published(OfdmGrid(28e9, 120e3, 200), EchoLaw().at(distance, slant))
    return distance, np.sqrt(variance), slant + NORMAL


def nees(error: np.ndarray, covariance: np.ndarray) -> float:
    """Mean normalised squared error per dimension."""
    return float(
        np.mean(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])) / 2
    )


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))


@pytest.mark.parametrize(
    ("count", "claimed", "actual", "likeliest", "published_nees"),
    [
        (2, 0.58, 0.54, 0.54, 1.07),
        (4, 0.45, 0.52, 0.387, 1.3),
        (8, 0.45, 0.63, 0.290, 2.6),
        (16, 0.47, 0.77, 0.209, 6.5),
    ],
)
def test_published_covariance_is_wrong_and_maximum_likelihood_is_honest(
    count, claimed, actual, likeliest, published_nees
):
    """Corollary 1 claims one error and makes another; the line fit meets its bound with NEES 1."""
    distance, std, azimuth = sweep(count)
    measured = distance + std * np.random.default_rng(count).normal(size=(RUNS, count))
    mc = 4.0 / np.sqrt(2.0 * RUNS)  # four standard errors of a RMSE, relative

    _, claim = average_pairs(distance, std, azimuth)
    assert np.sqrt(np.trace(claim)) == pytest.approx(claimed, abs=0.006)
    error = average_pairs(measured, std, azimuth)[0] - VRP
    assert rms(error) == pytest.approx(actual, rel=mc + 0.01)
    assert nees(error, np.broadcast_to(claim, (RUNS, 2, 2))) == pytest.approx(
        published_nees, rel=2 * mc + 0.04
    )
    _, full = average_pairs(distance, std, azimuth, "full")
    assert rms(error) == pytest.approx(np.sqrt(np.trace(full)), rel=mc + 0.04)

    fit = fit_lines(measured, std, azimuth)
    bound = fit_lines(distance, std, azimuth).covariance_m2
    assert np.sqrt(np.trace(bound)) == pytest.approx(likeliest, abs=0.002)
    assert rms(fit.mean_m - VRP) == pytest.approx(np.sqrt(np.trace(bound)), rel=mc)
    assert nees(fit.mean_m - VRP, fit.covariance_m2) == pytest.approx(1.0, abs=4.0 / np.sqrt(RUNS))
    assert np.mean(fit.cost) == pytest.approx(
        count - 2, abs=4.0 * np.sqrt(2.0 * max(count - 2, 0) / RUNS) + 1e-9
    )


def test_diagonal_covariance_depends_on_the_axes():
    """The published cov{w} changes with the orientation of the room; the full one turns with it."""
    distance, std, azimuth = sweep(2)
    traces = {model: [] for model in ("published", "full")}
    for turn in (0.0, np.deg2rad(15.0)):
        for model, found in traces.items():
            found.append(float(np.trace(average_pairs(distance, std, azimuth + turn, model)[1])))
    assert traces["full"][0] == pytest.approx(traces["full"][1], rel=1e-12)
    assert abs(traces["published"][0] / traces["published"][1] - 1.0) > 0.02
    assert paired_vrp(distance, std, azimuth).mean_m == pytest.approx(VRP)


@pytest.mark.parametrize("slant_deg", [15.0, 50.0, 65.0])
def test_mean_secant_is_the_centroid_of_a_beam_and_its_slope_a_complex_step(slant_deg):
    """The secant of a wide beam against direct summation of the power that a wall returns."""
    fan = BeamFan.of(BeamSet(panels=4, elements=16, beams=64))
    azimuth = BeamSet(panels=4, elements=16, beams=64).azimuths()
    beam = 5
    normal = azimuth[beam] + np.deg2rad(slant_deg)
    secant, slope = fan.secant(np.array(normal))
    cosine = np.cos(fan.azimuth_rad[beam] - normal)
    lit = cosine > 1e-3
    power = fan.power[beam, lit] * cosine[lit] ** 0.4 * cosine[lit] ** 4  # cross section, d^-4
    assert secant[beam] == pytest.approx(np.sum(power / cosine[lit]) / np.sum(power), rel=1e-9)
    assert secant[beam] < 1.0 / np.cos(np.deg2rad(slant_deg)) + 0.01  # pulled towards the normal
    stepped = np.cos(fan.azimuth_rad[beam, lit] - (normal + 1e-20j))
    complex_step = np.sum(fan.power[beam, lit] * stepped**3.4) / np.sum(fan.power[beam, lit] * stepped**4.4)
    assert slope[beam] == pytest.approx(complex_step.imag / 1e-20, rel=1e-9)


def test_slant_correction_removes_the_bias_of_wide_beams():
    """Centroids of wide beams up to 70 degrees off: biased by decimetres as pencils, not as what they are."""
    beams = BeamSet(panels=4, elements=8, beams=32)
    seen = np.flatnonzero(np.abs(beams.azimuths() - NORMAL) < np.deg2rad(70.0))
    fan = BeamFan.of(beams, 240).take(seen)
    distance = DISTANCE * fan.secant(np.array(NORMAL))[0]
    std = 0.02 * distance / DISTANCE
    azimuth = beams.azimuths()[seen]
    rng = np.random.default_rng(8)
    measured = distance + std * rng.normal(size=(100, len(seen)))
    corrected = fit_lines(measured, std, azimuth, fan=fan)
    assert nees(corrected.mean_m - VRP, corrected.covariance_m2) == pytest.approx(1.0, abs=4.0 / np.sqrt(100))
    plain = fit_lines(measured, std, azimuth)
    assert nees(plain.mean_m - VRP, plain.covariance_m2) > 10.0


def test_wall_seen_from_elsewhere_is_told_from_the_reference_point():
    """A sweep from a known position gives the mirror image of RP, with the covariance carried over."""
    position = np.array([3.0, -4.0])
    start, end = np.array([5.0, 20.0]), np.array([25.0, 5.0])
    wall = end - start
    normal = np.array([-wall[1], wall[0]]) / np.linalg.norm(wall)
    azimuth = (
        np.arctan2(*normal[::-1]) + np.pi * (normal @ (start - position) < 0) + np.array([-0.5, 0.1, 0.6])
    )
    towards = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    distance = (normal @ (start - position)) / (towards @ normal)
    std = 0.01 * np.ones(3)
    fit = fit_wall(distance, std, azimuth, position)
    np.testing.assert_allclose(fit.mean_m, mirror_in_wall([0.0, 0.0], start, end), atol=1e-8)
    linear = np.array(
        [
            (fit_wall(distance + h * e, std, azimuth, position).mean_m - fit.mean_m) / h
            for h, e in zip([1e-6] * 3, np.eye(3), strict=True)
        ]
    ).T
    np.testing.assert_allclose(fit.covariance_m2, 1e-4 * linear @ linear.T, rtol=1e-3)


def test_unusable_ranges_are_refused():
    """Too few, negative, not finite, all in one direction; beams that do not fit."""
    with pytest.raises(InputError, match="at least 2 ranges"):
        fit_wall([1.0], [0.1], [0.0])
    with pytest.raises(InputError, match="range_std_m: expected positive finite numbers, got -0.1"):
        fit_wall([1.0, 1.0], [0.1, -0.1], [0.0, 0.1])
    with pytest.raises(InputError, match="azimuth_rad: expected finite"):
        fit_wall([1.0, 1.0], [0.1, 0.1], [0.0, np.nan])
    with pytest.raises(InputError, match="two directions"):
        fit_wall([1.0, 1.1], [0.1, 0.1], [0.3, 0.3])
    with pytest.raises(ConfigurationError, match="'published' or 'full', got 'none'"):
        paired_vrp([1.0, 1.0], [0.1, 0.1], [0.0, 0.1], "none")
    fan = BeamFan.of(BeamSet(panels=1, elements=2, beams=3))
    with pytest.raises(InputError, match="fan: expected 2 beams, got 3"):
        fit_lines([1.0, 1.0], [0.1, 0.1], [0.0, 0.1], fan=fan)
    with pytest.raises(ConfigurationError, match="one shape"):
        BeamFan(np.zeros((2, 3)), np.ones((2, 2)))
    with pytest.raises(ConfigurationError, match="power"):
        BeamFan(np.zeros((2, 3)), np.zeros((2, 3)))


@pytest.mark.soak
@pytest.mark.parametrize("count", range(2, 17))
def test_the_line_fit_is_efficient_and_honest_in_ten_thousand_runs(count):
    """From 2 to 16 beams: RMSE at most 1.03 of the bound, NEES per dimension within 5 % of 1."""
    distance, std, azimuth = sweep(count)
    measured = distance + std * np.random.default_rng([3, count]).normal(size=(10_000, count))
    fit = fit_lines(measured, std, azimuth)
    bound = fit_lines(distance, std, azimuth).covariance_m2
    assert rms(fit.mean_m - VRP) <= 1.03 * np.sqrt(np.trace(bound))
    assert 0.95 <= nees(fit.mean_m - VRP, fit.covariance_m2) <= 1.05
