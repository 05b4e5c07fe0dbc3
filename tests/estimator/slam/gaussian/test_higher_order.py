"""Paths over several walls against the shortest way, and walls that they were taken for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from estimator.geometry import mirror
from estimator.slam.gaussian.higher_order import explained_by_others, path_over

ROOM = np.array([[-20.0, 0.0], [60.0, 0.0], [0.0, -30.0], [0.0, 50.0]])  # VRPs: 40 m by 40 m round RP
DEVICE = np.array([22.0, 11.0, 1.0, 0.3])  # place, squared height difference, clock bias
AGENT = np.array([[5.0, -4.0], [9.0, 3.0]])


def shortest(agent, walls):
    """Length of the shortest way from the agent over all lines (from the anchor) to the anchor, by search."""
    normal = walls / np.linalg.norm(walls, axis=1, keepdims=True)
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)

    def length(at):
        corners = np.concatenate([DEVICE[None, :2], 0.5 * walls + at[:, None] * along, agent[None]])
        return np.sum(np.linalg.norm(np.diff(corners, axis=0), axis=1))

    flat = minimize(length, np.zeros(len(walls)), method="BFGS").fun
    return np.sqrt(flat**2 + DEVICE[2]) + DEVICE[3]


def image_of(*order):
    """The VRP of the wall that a path over walls of the room would be taken for."""
    image = DEVICE[:2]
    for wall in order:
        image = mirror(image, ROOM[wall])
    chord = image - DEVICE[:2]
    return (image @ image - DEVICE[:2] @ DEVICE[:2]) / (chord @ chord) * chord


def test_lengths_of_double_and_triple_bounces_are_shortest_ways():
    """The image of an image of an image is as far as light goes; a wrong order of mirrors is metres off."""
    for one, other in ((0, 2), (1, 3)):
        for agent in AGENT:
            found = [path_over(agent, DEVICE, ROOM, np.array(o)) for o in ((one, other), (other, one))]
            ways = min(shortest(agent, ROOM[[one, other]]), shortest(agent, ROOM[[other, one]]))
            assert np.isfinite(found).sum() == 1  # the other order leads to the corner
            assert min(found) == pytest.approx(ways, abs=1e-4)
            assert np.isinf(path_over(agent, DEVICE, ROOM, np.array([one, other, one])))
    there_and_back = path_over(AGENT[0], DEVICE, ROOM, np.array([0, 1, 0]))
    assert there_and_back == pytest.approx(shortest(AGENT[0], ROOM[[0, 1, 0]]), abs=1e-4)
    three = path_over(AGENT[0], DEVICE, ROOM, np.array([0, 1, 2]))
    if np.isfinite(three):
        assert three == pytest.approx(shortest(AGENT[0], ROOM[[0, 1, 2]]), abs=1e-4)


def test_a_wall_that_double_bounces_explain_is_seen_through():
    """The two walls have to be among the others, and the anchor's height and clock count on both sides."""
    wall = image_of(0, 2)
    assert explained_by_others(AGENT, DEVICE, wall, ROOM, 0.6, False)
    assert not explained_by_others(AGENT, DEVICE, wall, ROOM[[0, 1, 3]], 0.6, False)
    assert not explained_by_others(AGENT, DEVICE, np.array([33.0, 41.0]), ROOM, 0.6, True)


def test_triple_bounces_are_looked_at_where_asked():
    """There and back between two walls is as long as a bounce off one far away."""
    wall = image_of(0, 1, 0)
    assert explained_by_others(AGENT, DEVICE, wall, ROOM[[1, 0, 2]], 0.6, True)
    assert not explained_by_others(AGENT, DEVICE, wall, ROOM[[1, 0, 2]], 0.6, False)
