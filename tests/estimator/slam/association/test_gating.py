"""Gating against dense formulas: every pair of a feature and a measurement, one by one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from estimator.slam.association.gating import GateModel, gate, path_variance, still_fitting
from estimator.slam.models.directions import predict_azimuths
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.features import sources
from estimator.slam.models.path_lengths import path_lengths, predict_paths
from tests.estimator.slam.models.test_path_lengths import state_of

MODEL = GateModel(gate_sigma=4.0, pair_gate_std_m=0.4, pair_margin=1.5, bent_share=0.5, range_std_m=0.1)
CLUTTER = np.array([0.02, 0.05])


def problem(room, rng, directions=False):
    """A Gaussian near the truth, and an epoch of paths: true ones, near misses and clutter."""
    mean, layout = state_of(room, room.track[40], 1.0)
    root = 0.02 * rng.normal(size=(layout.size, layout.size))
    covariance = root @ root.T
    prediction = predict_paths(mean[None], layout)
    length = np.ones((2, 9))
    for k in range(2):
        length[k, :6] = prediction.length_m[0, k, :6] + 0.2 * rng.normal(size=6)
        length[k, 6:] = rng.uniform(20.0, 150.0, 3)
    std = rng.uniform(0.05, 0.2, (2, 9))
    azimuth, spread = np.zeros((2, 9)), np.full((2, 9), np.inf)
    if directions:
        azimuth = predict_azimuths(mean[None], layout)[0][0][:, :9] + 0.01 * rng.normal(size=(2, 9))
        spread[:, ::2] = 0.02
    paths = EpochPaths(
        np.array([9, 7]),
        length,
        std,
        np.full((2, 9), np.nan),
        azimuth,
        spread,
        directions,
        np.ones(2, dtype=bool),
    )
    chance = rng.uniform(0.1, 0.9, (2, layout.features))
    return mean, covariance, layout, paths, chance


def gated(mean, covariance, layout, paths, chance, could, free):
    source = sources(
        layout, mean, np.ones_like(could)
    )  # an image of an image needs the first one, possible or not
    slanted = path_lengths(layout, mean, source)
    return gate(
        layout, MODEL, mean, covariance, source, slanted, chance, could, free, paths, CLUTTER
    )  # fmt: skip


@pytest.mark.parametrize("directions", [False, True])
def test_ratios_are_those_of_dense_formulas(room, directions):
    """Likelihood of each pair over "missed and clutter", zero outside the gate and for unknown pairs."""
    rng = np.random.default_rng(1)
    mean, covariance, layout, paths, chance = problem(room, rng, directions)
    could = predict_paths(mean[None], layout).possible[0]
    free = rng.random((2, 9)) < 0.8
    pairs = gated(mean, covariance, layout, paths, chance, could, free)
    prediction = predict_paths(mean[None], layout)
    azimuth, by_azimuth = predict_azimuths(mean[None], layout)
    listed = {(int(k), int(f)): c for c, (k, f) in enumerate(zip(pairs.anchor, pairs.feature, strict=True))}
    inside = 0
    for k in range(2):
        assert np.all(pairs.anchor[pairs.begin[k] : pairs.begin[k + 1]] == k)
        for f in range(layout.features):
            if not could[k, f]:
                assert (k, f) not in listed
                continue
            h = prediction.jacobian[0, k, f]
            spread = h @ covariance @ h
            for j in range(paths.number[k]):
                s = spread + max(paths.std_m[k, j], MODEL.range_std_m) ** 2
                gap = paths.length_m[k, j] - prediction.length_m[0, k, f]
                expected = 0.0
                known = f <= layout.slots or spread < MODEL.pair_gate_std_m**2
                if free[k, j] and known and abs(gap) < MODEL.gate_sigma * np.sqrt(s):
                    expected = (
                        norm.pdf(gap, scale=np.sqrt(s)) * chance[k, f] / (1.0 - chance[k, f]) / CLUTTER[k]
                    )
                    if np.isfinite(paths.azimuth_std_rad[k, j]):
                        g = by_azimuth[0, k, f]
                        wide = np.sqrt(g @ covariance @ g + paths.azimuth_std_rad[k, j] ** 2)
                        off = np.angle(np.exp(1j * (paths.azimuth_rad[k, j] - azimuth[0, k, f])))
                        expected *= 2.0 * np.pi * norm.pdf(off, scale=wide)
                    inside += 1
                if (k, f) in listed:
                    c = listed[k, f]
                    assert pairs.spread_m2[c] == pytest.approx(spread)
                    assert pairs.innovation_m[c, j] == pytest.approx(gap)
                    assert pairs.ratio[c, j] == pytest.approx(expected, rel=1e-9, abs=1e-300)
                else:
                    assert f > layout.slots
                    assert expected == 0.0
    assert inside > 6


def test_what_still_fits_after_a_correction(room):
    """A feature is looked at again if any free path is within its gate of the shifted prediction."""
    rng = np.random.default_rng(2)
    mean, covariance, layout, paths, chance = problem(room, rng)
    could = predict_paths(mean[None], layout).possible[0]
    could[:, 1 + layout.slots :] = False
    free = np.ones((2, 9), dtype=bool)
    pairs = gated(mean, covariance, layout, paths, chance, could, free)
    prediction = predict_paths(mean[None], layout)
    answers = set()
    for moved in (np.zeros(layout.size), 0.3 * rng.normal(size=layout.size)):
        for c, (k, f) in enumerate(zip(pairs.anchor, pairs.feature, strict=True)):
            shift = float(prediction.jacobian[0, k, f] @ moved)
            off = np.abs(pairs.innovation_m[c, : paths.number[k]] - shift)
            noise = [path_variance(paths, k, j, MODEL.range_std_m) for j in range(paths.number[k])]
            reach = MODEL.gate_sigma * np.sqrt(pairs.spread_m2[c] + np.array(noise))
            expected = bool(np.any(off < reach + MODEL.bent_share * abs(shift)))
            assert still_fitting(MODEL, pairs, c, moved, free, paths) == expected
            answers.add(expected)
            assert not still_fitting(MODEL, pairs, c, moved, ~free, paths)
    assert True in answers
