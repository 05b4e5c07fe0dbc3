"""Doubts that one cause joins: the paths of an epoch are weighed together, as enumeration does."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.layout import Layout
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from estimator.slam.gaussian.update import correct

CONFIG = GaussianConfig(range_std_m=0.1, region_m=3000.0, clutter_mean=3.0)
LAYOUT = Layout(3, 0, shared=False)
BEARING = np.radians([0.0, 120.0, 225.0])
DISTANCE = np.array([1000.0, 1400.0, 2000.0])
VISIBLE = 0.9


def heard(step: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Path lengths (3, 2): from anchors a kilometre or two away to the agent, and a false one of each."""
    towards = np.stack([np.cos(BEARING), np.sin(BEARING)], axis=1)
    true = np.linalg.norm(towards * DISTANCE[:, None] - step, axis=1) + 0.1 * rng.normal(size=3)
    return np.stack([true, DISTANCE + rng.normal(size=3)], axis=1)


def taken(lengths: np.ndarray):
    """The rows after an epoch with these lengths, of an agent that is known to a metre."""
    mean, covariance = np.zeros(LAYOUT.size), np.zeros((LAYOUT.size, LAYOUT.size))
    for k, distance in enumerate(DISTANCE.tolist()):
        mean[LAYOUT.anchor_xy(k)] = distance * np.cos(BEARING[k]), distance * np.sin(BEARING[k])
    covariance[:2, :2] = np.eye(2)
    everywhere = np.ones((1, 3, 1))
    table = PathTable(
        lengths, np.full((3, 2), 0.1), np.full((3, 2), np.nan), np.ones((3, 2), dtype=bool)
    )  # fmt: skip
    return correct(
        mean[None], covariance[None], VISIBLE * everywhere, everywhere > 0.0, table, LAYOUT, CONFIG
    )


def enumerated(lengths: np.ndarray) -> dict[tuple[int, ...], float]:
    """Log evidence of every labelling (each anchor's path, -1 for none), over "all is clutter"."""
    h = -np.stack([np.cos(BEARING), np.sin(BEARING)], axis=1)
    gap = lengths - DISTANCE[:, None]
    chance = VISIBLE * CONFIG.detection_probability
    result = {}
    for label in product((-1, 0, 1), repeat=3):
        used = [k for k in range(3) if label[k] >= 0]
        total = len(used) * np.log(chance / CONFIG.clutter_density) + (3 - len(used)) * np.log(1.0 - chance)
        if used:
            covariance = h[used] @ h[used].T + 0.01 * np.eye(len(used))
            innovation = [gap[k, label[k]] for k in used]
            total += multivariate_normal.logpdf(innovation, np.zeros(len(used)), covariance)
        result[label] = float(total)
    return result


@pytest.mark.parametrize("seed", range(12))
def test_rows_are_weighed_as_enumeration_says(seed: int):
    """The evidence of all rows is that of all labellings, and the likeliest rows' shares are theirs."""
    rng = np.random.default_rng(seed)
    lengths = heard(rng.normal(size=2), rng)
    done, exact = taken(lengths), enumerated(lengths)
    total = logsumexp(list(exact.values()))
    assert logsumexp(done.log_evidence) == pytest.approx(total, abs=0.03)
    for row in np.flatnonzero(done.log_evidence > done.log_evidence.max() - 3.0):
        share = done.explained[row]  # how surely each path was taken, (3, 2)
        if np.all((share < 0.01) | (share > 0.99)):
            label = tuple(int(np.argmax(each)) if each.max() > 0.5 else -1 for each in share)
            assert done.log_evidence[row] == pytest.approx(exact[label], abs=0.03)


def test_paths_that_agree_beat_those_that_fit_best_alone():
    """A false path nearer to what is expected than the true one, for two anchors of three: it moved."""
    lengths = np.array([[998.2, 1000.1], [1400.9, 1400.0], [2001.27, 2013.0]])
    done = taken(lengths)
    best = int(np.argmax(done.log_evidence))
    assert np.argmax(done.explained[best], axis=1).tolist() == [0, 0, 0]
    assert done.mean[best, :2] == pytest.approx([1.8, 0.0], abs=0.2)
