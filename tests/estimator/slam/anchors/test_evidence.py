"""The log evidence of a place: associations, silence over epochs, walls, the integral over places."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from estimator.slam.anchors.likelihood import Place, gate_epoch, room_for
from estimator.slam.anchors.search import evidence_at
from estimator.slam.association.belief_propagation import associate_pairs
from tests.estimator.slam.anchors.scenes import ANCHOR, NOISE, SPREAD, WALLS, observed, scene

FAR = np.array([400.0, 300.0])  # an anchor whose paths no place near RP explains


def enumerated(odds: np.ndarray) -> tuple[float, np.ndarray]:
    """Sum over all one-to-one associations of the product of their odds (F, M), and marginals (F, M)."""
    features, paths = odds.shape
    total, marginal = 0.0, np.zeros(odds.shape)
    for chosen in product(range(-1, paths), repeat=features):
        used = [j for j in chosen if j >= 0]
        if len(set(used)) < len(used):
            continue
        weight = np.prod([odds[f, j] for f, j in enumerate(chosen) if j >= 0])
        total += weight
        for f, j in enumerate(chosen):
            if j >= 0:
                marginal[f, j] += weight
    return total, marginal / total


def associated(odds: np.ndarray) -> tuple[float, np.ndarray]:
    """Log evidence and marginals of :func:`associate_pairs`."""
    feature, path = np.nonzero(odds)
    forth, back = np.empty(feature.size), np.empty(feature.size)
    own, by_path = np.empty(len(odds)), np.empty(odds.shape[1])
    associate_pairs(odds[feature, path], feature, path, forth, back, own, by_path)
    weighted = np.zeros(odds.shape)
    weighted[feature, path] = odds[feature, path] * back
    evidence = np.log1p(own).sum() + np.log1p(by_path).sum() - np.log1p(forth * back).sum()
    return float(evidence), weighted / (1.0 + own)[:, None]


@pytest.mark.parametrize(
    "odds",
    [
        [[5.0, 0.0], [0.0, 0.3]],
        [[5.0, 2.0], [0.0, 7.0]],
        [[3.0], [8.0], [0.5]],
        [[3.0, 4.0, 0.1]],
        [[3.0, 0.0, 0.0], [2.0, 9.0, 0.0], [0.0, 1.0, 6.0]],
    ],
)
def test_on_trees_associations_are_exact(odds):
    """Two features that claim one path may not both have it; a path that two may give is not lost."""
    exact, marginal = enumerated(np.array(odds))
    found, probability = associated(np.array(odds))
    assert found == pytest.approx(np.log(exact), abs=2e-3)
    np.testing.assert_allclose(probability, marginal, atol=2e-3)


@pytest.mark.parametrize("seed", range(5))
def test_with_loops_associations_are_nearly_exact(seed):
    """Bethe's approximation errs by tenths of nats where everything claims everything."""
    odds = np.exp(np.random.default_rng(seed).normal(0.0, 2.0, (3, 3)))
    exact, _ = enumerated(odds)
    assert associated(odds)[0] == pytest.approx(np.log(exact), abs=0.35)


@pytest.mark.parametrize("epochs", [1, 2, 6])
def test_what_is_hidden_is_hidden_all_along(epochs):
    """Evidence of silence: a feature that is not heard was hidden, once, not anew in every epoch."""
    agents = [(0.5 * t, 0.0) for t in range(epochs)]
    one, many = (
        evidence_at(scene(observed(of, anchor=FAR)), np.array([[10.0, 12.0]]), 0.0)
        for of in ([agents[0]], agents)
    )
    visible = np.repeat([0.9, 0.6, 0.2], [1, 4, 12])

    def silence(count):
        return np.sum(np.log(1.0 - visible + visible * (1.0 - NOISE.detection_probability) ** count))

    assert many - one == pytest.approx(silence(epochs) - silence(1), abs=1e-6)


def test_an_anchor_is_rather_in_this_room_than_behind_its_walls():
    """Standing behind a wall costs 2.5 nats, and the bounce on that wall is not missed."""
    given = scene(observed([(0.0, 0.0)], anchor=FAR))
    inside, behind = (evidence_at(given, np.array([place]), 0.0)[0] for place in ((12.0, 9.0), (28.0, 9.0)))
    not_missed = -np.log(1.0 - 0.6 * NOISE.detection_probability)
    assert behind - inside == pytest.approx(not_missed - 2.5, abs=1e-6)


def test_the_evidence_is_the_likelihood_integrated_over_places():
    """Evidence weighs places against waiting: an error of its scale starts anchors from clutter."""
    given = scene(observed([(0.0, 0.0)]), spread=SPREAD)
    circles, model = given.circles, given.model
    out = room_for(circles.x.shape[1], model.max_gated)
    side, likelihood = np.linspace(-1.2, 1.2, 121), 0.0
    for dx, dy in product(side, side):
        place = Place(ANCHOR[0] + dx, ANCHOR[1] + dy, 0.0, 0.0, 0.0)
        gate_epoch(place, circles, given.seen, 0, 0, circles.x.shape[1], WALLS, model, out)
        odds = np.zeros((circles.x.shape[1], 5))
        for q in range(len(odds)):
            for i in range(out.begin[q], out.begin[q + 1]):
                odds[q, out.path[i]] = out.relative[i]
        chance = model.visibility * model.detection_probability
        nothing = np.log1p(-chance).sum()
        likelihood += np.exp(nothing + associated(odds * (chance / (1.0 - chance))[:, None])[0])
    integral = likelihood * (side[1] - side[0]) ** 2 / (np.pi * NOISE.region_m**2)
    assert evidence_at(given, ANCHOR[None], 0.0)[0] == pytest.approx(np.log(integral), abs=0.15)


def test_epochs_agree_on_what_is_visible():
    """A feature that is heard in every epoch counts once as visible, not anew in each."""
    agents = [(0.5 * t, 0.2 * t) for t in range(3)]
    one, three = (evidence_at(scene(observed(of)), ANCHOR[None], 0.0)[0] for of in (agents[:1], agents))
    chance = NOISE.detection_probability
    per_epoch = []
    for agent in agents[1:]:
        given = scene(observed([agent]))
        circles, out = given.circles, room_for(17, given.model.max_gated)
        gate_epoch(Place(*ANCHOR, 0.0, 0.0, 0.0), circles, given.seen, 0, 0, 5, WALLS, given.model, out)
        heard = [out.relative[out.begin[q] : out.begin[q + 1]].sum() for q in range(5)]
        per_epoch.append(np.sum(np.log(1.0 - chance + chance * np.array(heard))))
    # two further epochs of five features known to be visible, of a place known better, and of silent pairs
    assert three - one == pytest.approx(np.sum(per_epoch) - np.log(3.0), abs=1.5)
