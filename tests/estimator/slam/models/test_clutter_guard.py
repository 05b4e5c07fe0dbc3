"""Ten thousand paths in one epoch: the anchor counts as unheard, at once, in either engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.measurements import AnchorPaths
from estimator.slam import Prior, epoch_rng
from estimator.slam.models.clutter_guard import MOST_PATHS
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.run import config_for, engine_for
from estimator.waveform import SPEED_OF_LIGHT_M_S


def flood(count: int) -> AnchorPaths:
    """Paths all over the region."""
    length = np.random.default_rng(count).uniform(1.0, 180.0, count)
    return AnchorPaths(length / SPEED_OF_LIGHT_M_S, np.full(count, 0.1 / SPEED_OF_LIGHT_M_S))


@pytest.mark.parametrize("engine", ["gaussian", "particle"])
@pytest.mark.parametrize("at", [0, 1, 6])
def test_a_flood_is_passed_over(room, engine, at):
    """The state after it is that after an epoch without the anchor, and the one before is untouched."""
    measured = room.measure(5, epochs=at + 1)
    base = ParticleConfig(particles=500) if engine == "particle" else None
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
