"""How strong paths are: the gain of anchors and what a bounce costs, from the paths of known places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimator.slam.features import reflect
from estimator.slam.gaussian.levels import known_gains, learn_levels, loss_limits, normal_loss_db

from estimator.measurements import GaussianVrp
from estimator.slam import GaussianConfig
from estimator.slam.gaussian.start import start

WALLS = np.array([[40.0, 0.0], [-24.0, 0.0], [0.0, 30.0]])  # the first defines the gauge frame
ANCHOR = np.array([6.0, 9.0])


def fresnel_db(epsilon, cosine):
    """Loss of a half-space, field along the surface."""
    s = np.sqrt(epsilon - 1.0 + cosine**2)
    return -20.0 * np.log10((s - cosine) / (s + cosine))


@pytest.mark.parametrize("epsilon", [2.7, 5.24, 6.3])
def test_the_loss_at_normal_incidence_follows_from_any_other(epsilon):
    """Fresnel's formula is solved for the permittivity: plasterboard, concrete, glass."""
    cosine = np.linspace(0.2, 1.0, 9)
    normal = normal_loss_db(fresnel_db(epsilon, cosine), cosine)
    assert normal == pytest.approx(np.full(9, fresnel_db(epsilon, 1.0)), abs=1e-9)
    assert np.all(np.diff(fresnel_db(epsilon, cosine)) > 0.0)  # a slant never costs more


def heard(config, epsilon=2.7, gain_db=0.0, direct=True, epochs=4):
    """A state that has heard an anchor, ``gain_db`` stronger than it should be, directly and over walls."""
    walls = tuple(GaussianVrp(vrp, 1e-4 * np.eye(2)) for vrp in WALLS)
    state = start(walls, ("a",), 28e9, config)
    slots = state.rows.mean[0, state.layout.walls].reshape(-1, 2)
    state.rows.mean[0, state.layout.anchor(0)] = *ANCHOR, 0.0, 0.0
    state.rows.located[:] = True
    trail, paths = [], []
    for t in range(epochs):
        agent = np.array([0.5 * t, 0.2 * t])
        trail.append([t + 1, *agent, 0.01])
        for wall in (None, *slots):
            if wall is None and not direct:
                continue
            source = ANCHOR if wall is None else reflect(ANCHOR, wall)
            length, loss = np.linalg.norm(agent - source), -gain_db
            if wall is not None:
                cosine = abs((agent - source) @ wall) / length / np.linalg.norm(wall)
                loss += fresnel_db(epsilon, cosine)
            paths.append([t + 1, 0, length, 0.02, loss, 0.0])
    return replace(state, epoch=epochs, trail=np.array(trail), heard=np.array(paths))


def test_the_first_bounces_tell_the_material():
    """The limit for new walls follows the building: plasterboard reflects less than concrete or glass."""
    config = GaussianConfig()
    for epsilon in (2.7, 5.24, 6.3):
        limit = loss_limits(learn_levels(heard(config, epsilon), config), config)
        assert limit[0] - config.birth_margin_db == pytest.approx(fresnel_db(epsilon, 1.0), abs=0.4)


def test_the_line_of_sight_tells_an_unknown_gain():
    """Without knowing the EIRP the limit is the same once the anchor was heard directly, and none before."""
    config = replace(GaussianConfig(), gain_offset_std_db=30.0)
    for gain_db in (-9.0, 17.0):
        state = learn_levels(heard(config, gain_db=gain_db), config)
        assert known_gains(state)[0] == pytest.approx(-gain_db, abs=0.1)
        assert loss_limits(state, config)[0] + gain_db - config.birth_margin_db == pytest.approx(
            fresnel_db(2.7, 1.0), abs=0.4
        )
        blind = learn_levels(heard(config, gain_db=gain_db, direct=False), config)
        assert np.isnan(known_gains(blind)[0])
        assert loss_limits(blind, config)[0] == np.inf


def test_calibrated_gains_are_believed():
    """A known EIRP stays as it is; without powers nothing is learnt."""
    config = GaussianConfig()
    state = learn_levels(heard(config, gain_db=2.0), config)
    assert known_gains(state)[0] == 0.0
    silent = heard(config)
    silent.heard[:, 4] = np.nan
    assert learn_levels(silent, config) is silent
