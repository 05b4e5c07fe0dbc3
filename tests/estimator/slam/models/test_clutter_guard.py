"""Ten thousand paths in one epoch: the anchor counts as unheard, at once, in either engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch
from estimator.slam import Prior, epoch_rng
from estimator.slam.models.clutter_guard import guard_clutter
from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.run import config_for, engine_for
from estimator.waveform import SPEED_OF_LIGHT_M_S

MOST_PATHS = MeasurementNoise().most_paths


def flood(count: int) -> AnchorPaths:
    """Paths all over the region."""
    length = np.random.default_rng(count).uniform(1.0, 180.0, count)
    return AnchorPaths(length / SPEED_OF_LIGHT_M_S, np.full(count, 0.1 / SPEED_OF_LIGHT_M_S))


def test_an_anchor_with_too_many_paths_is_alone_in_that():
    """As many as are allowed stay; one more, and that anchor has none while the other keeps its own."""
    epoch = Epoch(0, 0.0, (flood(31), flood(30)))
    assert [len(paths) for paths in guard_clutter(epoch, 31).paths] == [31, 30]
    assert [len(paths) for paths in guard_clutter(epoch, 30).paths] == [0, 30]


@pytest.mark.parametrize("engine", ["gaussian", "particle"])
@pytest.mark.parametrize("at", [0, 1, 6])
def test_a_flood_is_passed_over(room, engine, at):
    """The state after it is that after an epoch without the anchor, and the one before is untouched."""
    measured = room.measure(5, epochs=at + 1)
    base = ParticleConfig.of(particles=500) if engine == "particle" else None
    chosen = engine_for("hybrid", engine, config_for(measured, base, engine))
    state = chosen.start(Prior.of(measured), epoch_rng(1, -1))
    for epoch in measured.epochs[:at]:
        state = chosen.step(state, epoch, epoch_rng(1, epoch.index))
    before, last = chosen.save(state), measured.epochs[at]
    after = {
        count: chosen.save(
            chosen.step(state, replace(last, paths=(flood(count), last.paths[1])), epoch_rng(1, at))
        )
        for count in (0, 30, MOST_PATHS + 1, 10_000)
    }
    assert chosen.save(state) == before
    assert after[MOST_PATHS + 1] == after[0]
    assert after[10_000] == after[0]
    assert after[30] != after[0]
