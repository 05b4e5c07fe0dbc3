"""One known anchor, ranges and directions among clutter, with gaps: beside a PDAF, the plain method for it.

Y. Bar-Shalom, F. Daum, J. Huang, "The probabilistic data association filter", IEEE Control Syst. 29(6), 2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch, MeasurementSet
from estimator.slam import run_slam
from estimator.slam.models.motion import Motion
from estimator.waveform import SPEED_OF_LIGHT_M_S

ANCHOR = np.array([6.0, 8.0])
RANGE_STD, AZIMUTH_STD = 0.3, np.deg2rad(3.0)
REGION_M, DETECTED, VELOCITY_STD = 40.0, 0.95, 1.0
EPOCHS, EVERY = 120, 15  # of a walk, and between gaps
LOST_M = 3.0
GATE = 16.0  # squared Mahalanobis distance


class Walk(NamedTuple):
    """A true track (T, 2), and each epoch's ranges and azimuths (n, 2)."""

    track: np.ndarray
    heard: list[np.ndarray]


def walk(seed: int, clutter: float, gap: int) -> Walk:
    """A walk of the model's motion; the line of sight is gone for ``gap`` epochs, every ``EVERY``."""
    rng = np.random.default_rng(seed)
    place, speed, track, heard = np.zeros(2), rng.normal(scale=0.7, size=2), [], []
    for t in range(EPOCHS):
        if t:
            push = rng.normal(scale=np.sqrt(Motion().acceleration_variance), size=2) - 0.01 * place
            place, speed = place + speed + 0.5 * push, 0.98 * speed + push
        track.append(place)
        way = ANCHOR - place
        seen = np.array([np.linalg.norm(way), np.arctan2(way[1], way[0])])
        seen = seen + rng.normal(size=2) * [RANGE_STD, AZIMUTH_STD]
        gone = t > 5 and t % EVERY < gap
        true = seen[None] if rng.random() < DETECTED and not gone else np.empty((0, 2))
        false = rng.uniform([0.1, -np.pi], [REGION_M, np.pi], (rng.poisson(clutter), 2))
        heard.append(np.concatenate([true, false]))
    return Walk(np.array(track), heard)


def engine_track(given: Walk, clutter: float) -> np.ndarray:
    """The track (T, 2) of the Gaussian engine, ``va``."""
    epochs = []
    for t, seen in enumerate(given.heard):
        order = np.argsort(seen[:, 0])
        count, light = len(order), SPEED_OF_LIGHT_M_S
        paths = AnchorPaths(
            np.maximum(seen[order, 0], 1e-3) / light,
            np.full(count, RANGE_STD / light),
            azimuth_rad=seen[order, 1],
            azimuth_std_rad=np.full(count, AZIMUTH_STD),
        )
        epochs.append(Epoch(t, float(t), (paths,)))
    model = {
        "range_std_m": RANGE_STD,
        "detection_probability": DETECTED,
        "clutter_mean": clutter,
        "region_m": REGION_M,
        "height2_mean_m2": 0.0,
        "height2_std_m2": 0.0,
        "velocity_std_m_s": VELOCITY_STD,
    }
    settings = {"measurement_model": model}
    measured = MeasurementSet(("a",), (), tuple(epochs), 6e9, settings, known_anchors_m=ANCHOR[None])
    return run_slam(measured, "va").agent_mean[:, :2]


def pdaf_track(given: Walk, clutter: float) -> np.ndarray:
    """The track (T, 2) of a probabilistic data association filter with the same models."""
    driving = Motion().driving(1.0)
    noise = np.diag([RANGE_STD**2, AZIMUTH_STD**2])
    density = clutter / (REGION_M * 2.0 * np.pi)
    mean, covariance = np.zeros(4), np.diag([1e-6, 1e-6, VELOCITY_STD**2, VELOCITY_STD**2])
    track = []
    for t, seen in enumerate(given.heard):
        if t:
            mean = driving.transition @ mean
            covariance = driving.transition @ covariance @ driving.transition.T + driving.covariance
        way = ANCHOR - mean[:2]
        reach = np.linalg.norm(way)
        slope = np.zeros((2, 4))
        slope[0, :2], slope[1, :2] = -way / reach, np.array([way[1], -way[0]]) / reach**2
        gap = seen - [reach, np.arctan2(way[1], way[0])]
        gap[:, 1] = np.angle(np.exp(1j * gap[:, 1]))
        spread = slope @ covariance @ slope.T + noise
        inverse = np.linalg.inv(spread)
        square = np.einsum("ni,ij,nj->n", gap, inverse, gap)
        gap, square = gap[square < GATE], square[square < GATE]
        ratio = DETECTED * np.exp(-0.5 * square) / (2.0 * np.pi * np.sqrt(np.linalg.det(spread))) / density
        share = ratio / (1.0 - DETECTED + ratio.sum())
        gain = covariance @ slope.T @ inverse
        together = share @ gap
        scatter = np.einsum("n,ni,nj->ij", share, gap, gap) - np.outer(together, together)
        mean = mean + gain @ together
        covariance = covariance - share.sum() * gain @ spread @ gain.T + gain @ scatter @ gain.T
        track.append(mean[:2])
    return np.array(track)


def lost(seeds: range, clutter: float, gap: int) -> tuple[int, int]:
    """Walks that the engine and the PDAF are off by ``LOST_M`` at the end of."""
    ends = []
    for seed in seeds:
        given = walk(seed, clutter, gap)
        ends.append(
            [np.linalg.norm(f(given, clutter)[-1] - given.track[-1]) for f in (engine_track, pdaf_track)]
        )
    engine, plain = np.sum(np.array(ends) > LOST_M, axis=0)
    return int(engine), int(plain)


@pytest.mark.parametrize(("clutter", "gap"), [(3.0, 0), (7.0, 4)])
def test_no_more_is_lost_than_by_a_pdaf(clutter, gap):
    """A few walks with little and with much in the way."""
    engine, plain = lost(range(3), clutter, gap)
    assert engine <= plain


@pytest.mark.soak
@pytest.mark.parametrize("clutter", [3.0, 7.0])
@pytest.mark.parametrize("gap", range(5))
def test_of_a_hundred_walks_no_more_is_lost_than_by_a_pdaf(clutter, gap, record_property):
    """The same at every length of gap."""
    engine, plain = lost(range(100), clutter, gap)
    record_property("lost of 100: engine, PDAF", f"{engine}, {plain}")
    assert engine <= plain
