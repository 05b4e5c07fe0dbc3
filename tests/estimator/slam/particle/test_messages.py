"""Messages of one anchor's paths against exact enumeration, and the features they start."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from estimator.geometry import mirror
from estimator.slam.particle.births import born_features, merged, new_odds, pruned, vrp_between
from estimator.slam.particle.cloud import gaussian_cloud
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.messages import Nodes, exchange
from estimator.slam.particle.state import Features

pytestmark = pytest.mark.interpreted

CONFIG = ParticleConfig.of(particles=8, range_std_m=0.1, pairings=1, new_mean=0.01)
AGENT, ANCHOR, WALL = np.array([5.0, 2.0]), np.array([20.0, -4.0]), np.array([0.0, 30.0])


def still(*points):
    """Clouds (n, 2, N) without spread."""
    return np.repeat(np.array(points, dtype=np.float32)[..., None], CONFIG.inference.particles, axis=-1)


def enumerate_posterior(existence, visibility, mean_m, length, std, odds, config):
    """Posterior existence, visibility and unexplained probability by summing over every case."""
    features, paths = len(existence), len(length)
    density = np.exp(-0.5 * ((length - mean_m[:, None]) / std) ** 2) / np.sqrt(2.0 * np.pi) / std
    total, exists = 0.0, np.zeros(features)
    visible, free = np.zeros(features), np.zeros(paths)
    for r in product((0, 1), repeat=features):
        for e in product((0, 1), repeat=features):
            for a in product(range(-1, paths), repeat=features):
                used = [j for j in a if j >= 0]
                if len(set(used)) < len(used):
                    continue
                weight = 1.0
                for f in range(features):
                    weight *= existence[f] if r[f] else 1.0 - existence[f]
                    weight *= visibility[f] if e[f] else 1.0 - visibility[f]
                    detect = config.noise.detection_probability if r[f] and e[f] else 0.0
                    weight *= (
                        1.0 - detect if a[f] < 0 else detect * density[f, a[f]] / config.noise.clutter_density
                    )
                for j in range(paths):
                    weight *= 1.0 if j in used else 1.0 + odds[j]
                total += weight
                exists += weight * np.array(r)
                visible += weight * np.array(e) * np.array(r)
                free += weight * np.array([j not in used for j in range(paths)])
    return exists / total, visible / exists, free / total, np.log(total)


@pytest.mark.parametrize("length", [(16.2,), (16.2, 50.3), (47.1,), (16.25, 42.6)])
def test_association_is_exact_where_the_graph_is_a_tree(length):
    """Existence, visibility, unexplained share and evidence equal the sum over all cases."""
    length = np.array(length)
    std = np.full(length.shape, 0.1)
    nodes = Nodes(
        agent=still(AGENT)[0],
        anchor=still(ANCHOR)[0],
        points=tuple(still(WALL)),
        shared=True,
        existence=np.array([1.0, 0.6]),
        visibility=np.array([0.9, 0.7]),
    )
    odds = new_odds(length, CONFIG)
    said = exchange(nodes, length, std, odds, CONFIG, np.random.default_rng(0))
    ranges = np.array([np.linalg.norm(ANCHOR - AGENT), np.linalg.norm(mirror(ANCHOR, WALL) - AGENT)])
    exists, visible, free, evidence = enumerate_posterior(
        nodes.existence, nodes.visibility, ranges, length, std, odds, CONFIG
    )
    assert said.existence == pytest.approx(exists, abs=1e-4)
    assert said.visibility == pytest.approx(visible, abs=1e-4)
    assert said.unexplained == pytest.approx(free, abs=1e-4)
    assert said.log_evidence == pytest.approx(evidence, abs=1e-3)


def test_weights_of_agent_and_wall_are_the_likelihood_of_their_place():
    """With all else known, particles weigh what the Gaussian of their own range weighs."""
    offsets = np.linspace(-0.2, 0.2, CONFIG.inference.particles, dtype=np.float32)
    wall = tuple(still(WALL))
    wall[0][1] += offsets
    length = np.array([np.linalg.norm(mirror(ANCHOR, WALL) - AGENT)])
    nodes = Nodes(still(AGENT)[0], still(ANCHOR)[0], wall, True, np.ones(2), np.array([0.0, 1.0]))
    said = exchange(nodes, length, np.array([0.1]), np.zeros(1), CONFIG, np.random.default_rng(0))
    ranges = np.linalg.norm(mirror(ANCHOR, wall[0].T.astype(float)) - AGENT, axis=1)
    ratio = (
        np.exp(-0.5 * ((length - ranges) / 0.1) ** 2)
        / np.sqrt(2.0 * np.pi)
        / 0.1
        / CONFIG.noise.clutter_density
    )
    assert said.points[0] == pytest.approx(np.log(0.05 + 0.95 * ratio), abs=1e-3)
    assert said.agent == pytest.approx(said.points[0], abs=1e-5)  # paired one to one
    assert said.anchor == pytest.approx(said.points[0], abs=1e-5)


def test_more_pairings_estimate_the_same_message_better():
    """The agent's message integrates over the wall: its error falls with the root of the pairings."""
    rng = np.random.default_rng(1)
    count = 2000
    agent, anchor = np.repeat(AGENT[:, None], count, 1), np.repeat(ANCHOR[:, None], count, 1)
    wall = (gaussian_cloud(WALL, 0.04 * np.eye(2), count, rng),)
    length = np.array([np.linalg.norm(mirror(ANCHOR, WALL) - AGENT)])
    nodes = Nodes(
        agent.astype(np.float32), anchor.astype(np.float32), wall, True, np.ones(2), np.array([0.0, 1.0])
    )
    ranges = np.linalg.norm(mirror(ANCHOR, wall[0].T.astype(float)) - AGENT, axis=1)
    density = np.exp(-0.5 * ((length - ranges) / 0.1) ** 2) / np.sqrt(2.0 * np.pi) / 0.1
    exact = 0.05 + 0.95 * density.mean() / CONFIG.noise.clutter_density
    spread = {}
    for pairings in (1, 16):
        config = ParticleConfig.of(particles=count, range_std_m=0.1, pairings=pairings)
        said = exchange(nodes, length, np.array([0.1]), np.zeros(1), config, rng)
        values = np.exp(said.agent.astype(float))
        assert values.mean() == pytest.approx(exact, rel=0.02)
        spread[pairings] = values.std()
    assert spread[16] == pytest.approx(spread[1] / 4.0, rel=0.2)


def test_images_and_walls_are_each_others_inverse():
    """(2) then (3) gives the wall back: the VRP of an anchor and its mirror image is the wall's."""
    rng = np.random.default_rng(2)
    wall, anchor = rng.normal(scale=30.0, size=(2, 2, 50))
    virtual = mirror(anchor.T, wall.T).T
    usable = np.linalg.norm(virtual - anchor, axis=0) > 1.0
    back = vrp_between(anchor.astype(np.float32), virtual.astype(np.float32))
    error = np.linalg.norm(back - wall, axis=0)
    assert np.all(error[usable] < 1e-2)


@pytest.mark.parametrize("owner", [-1, 0])
def test_new_features_explain_their_path_from_every_bearing(owner):
    """All particles lie where the path length says, spread evenly round the agent."""
    config = ParticleConfig.of(particles=4000, range_std_m=0.1)
    agent, anchor = (np.repeat(p[:, None], 4000, 1).astype(np.float32) for p in (AGENT, ANCHOR))
    length, std = np.array([40.0, 60.0]), np.array([0.1, 0.2])
    new = born_features(
        agent,
        anchor,
        owner,
        (length, std),
        np.array([0.2, 0.9]),
        np.array([1.0, 0.5]),
        (7, 3),
        config,
        np.random.default_rng(3),
    )
    assert len(new) == 1  # the explained path starts nothing
    assert (new.wall_id[0], new.born[0], new.owner[0]) == (7, 3, owner)
    odds = config.features.new_mean * 2.0 * 60.0 / 180.0**2 * 180.0
    assert new.existence[0] == pytest.approx(0.9 * odds / (1.0 + odds))
    virtual = new.points_m[0]
    if owner < 0:
        virtual = mirror(anchor.T, virtual.T).T
    offset = virtual - agent
    ranges = np.linalg.norm(offset, axis=0)
    assert ranges.mean() == pytest.approx(60.0, abs=5.0 * 0.2 / np.sqrt(4000))
    assert ranges.std() == pytest.approx(0.2, rel=0.1)
    resultant = np.abs(np.mean(np.exp(1j * np.arctan2(offset[1], offset[0]))))
    assert resultant < 5.0 / np.sqrt(4000)


def features_at(places, spreads, existence, born):
    """Walls with Gaussian clouds."""
    rng = np.random.default_rng(4)
    clouds = [gaussian_cloud(p, s**2 * np.eye(2), 500, rng) for p, s in zip(places, spreads, strict=True)]
    count = len(clouds)
    return Features(
        tuple(clouds),
        np.array(existence),
        np.full((count, 2), 0.5),
        np.full(count, -1),
        np.arange(count),
        np.array(born),
    )


def test_two_accounts_of_one_wall_become_one():
    """Of sharp neighbours the more accurate stays under the older name; wide ones are left alone."""
    features = features_at(
        [(10.0, 0.0), (10.3, 0.0), (0.0, 50.0), (0.2, 50.0)],
        [0.3, 0.1, 0.2, 9.0],
        [0.9, 0.5, 0.8, 0.1],
        [0] * 4,
    )
    one = merged(features, ParticleConfig.of(particles=500))
    assert one.wall_id.tolist() == [0, 2, 3]
    assert one.existence[0] == pytest.approx(0.95)
    assert np.array_equal(one.points_m[0], features.points_m[1])


def test_features_that_hardly_exist_go_after_a_second_look():
    """Below the threshold a feature is dropped, unless it was born in this epoch."""
    features = features_at([(10.0, 0.0), (0.0, 50.0), (30.0, 0.0)], [0.1] * 3, [5e-5, 5e-5, 0.2], [6, 5, 2])
    assert pruned(features, 6, ParticleConfig.of(particles=500)).wall_id.tolist() == [0, 2]
