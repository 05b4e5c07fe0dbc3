"""How strong paths are: the gain of anchors and what a bounce costs, from the paths of known places."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import mirror
from estimator.measurements import GaussianVrp
from estimator.slam import GaussianConfig, start
from estimator.slam.models.path_buffer import PathBuffer, Track
from estimator.slam.models.path_loss import (
    PathLoss,
    first_losses,
    known_gain_offsets,
    learn_losses,
    loss_limits,
    normal_loss_db,
)

WALLS = np.array([[40.0, 0.0], [-24.0, 0.0], [0.0, 30.0]])  # the first defines the gauge frame
ANCHOR = np.array([6.0, 9.0])
MODEL = PathLoss()


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


def learnt(offset_std_db=0.0, epsilon=2.7, gain_db=0.0, direct=True, powers=True):
    """Losses after four epochs of an anchor ``gain_db`` stronger than it should be, and those before."""
    config = GaussianConfig.of(gain_offset_std_db=offset_std_db)
    walls = tuple(GaussianVrp(vrp, 1e-4 * np.eye(2)) for vrp in WALLS)
    state = start(walls, ("a",), 28e9, config)
    slots = state.hypotheses.mean[0, state.layout.walls].reshape(-1, 2)
    state.hypotheses.mean[0, state.layout.anchor(0)] = *ANCHOR, 0.0, 0.0
    state.hypotheses.located[:] = True
    place = np.array([[0.5 * t, 0.2 * t] for t in range(4)])
    epochs, lengths, losses = [], [], []
    for t, agent in enumerate(place):
        for wall in (None, *slots):
            if wall is None and not direct:
                continue
            source = ANCHOR if wall is None else mirror(ANCHOR, wall)
            length, loss = np.linalg.norm(agent - source), -gain_db
            if wall is not None:
                loss += fresnel_db(epsilon, abs((agent - source) @ wall) / length / np.linalg.norm(wall))
            epochs.append(t + 1)
            lengths.append(length)
            losses.append(loss if powers else np.nan)
    count = len(epochs)
    buffer = PathBuffer(
        Track(np.arange(1, 5), place, np.full(4, 0.01)),
        np.array(epochs),
        np.zeros(count, dtype=np.int64),
        np.array(lengths),
        np.full(count, 0.02),
        np.array(losses),
        np.zeros(count, dtype=bool),
    )
    before = first_losses(1, offset_std_db, MODEL)
    return learn_losses(before, state.hypotheses, state.layout, np.arange(3), buffer, 0.02, MODEL), before


@pytest.mark.parametrize("epsilon", [2.7, 5.24, 6.3])
def test_the_first_bounces_tell_the_material(epsilon):
    """The limit for new walls follows the building: plasterboard reflects less than concrete or glass."""
    limit = loss_limits(learnt(epsilon=epsilon)[0], MODEL)
    assert limit[0] - MODEL.birth_margin_db == pytest.approx(fresnel_db(epsilon, 1.0), abs=0.4)


@pytest.mark.parametrize("gain_db", [-9.0, 17.0])
def test_the_line_of_sight_tells_an_unknown_gain(gain_db):
    """Without knowing the EIRP the limit is the same once the anchor was heard directly, and none before."""
    losses, _ = learnt(30.0, gain_db=gain_db)
    assert known_gain_offsets(losses, MODEL)[0] == pytest.approx(-gain_db, abs=0.1)
    expected = fresnel_db(2.7, 1.0)
    assert loss_limits(losses, MODEL)[0] + gain_db - MODEL.birth_margin_db == pytest.approx(expected, abs=0.4)
    blind, _ = learnt(30.0, gain_db=gain_db, direct=False)
    assert np.isnan(known_gain_offsets(blind, MODEL)[0])
    assert loss_limits(blind, MODEL)[0] == np.inf


def test_calibrated_gains_are_believed():
    """A known EIRP stays as it is; without powers nothing is learnt."""
    assert known_gain_offsets(learnt(gain_db=2.0)[0], MODEL)[0] == 0.0
    silent, before = learnt(powers=False)
    assert np.array_equal(silent, before)
