"""Least squares for the place of an anchor."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from estimator.slam.anchors.likelihood import Place, room_for
from estimator.slam.anchors.observations import gathered
from estimator.slam.anchors.refinement import refine
from tests.estimator.slam.anchors.scenes import ANCHOR, observed, path_lengths, scene


def refined(given, place):
    """The place (2,) and the information on it (2, 2)."""
    out = room_for(given.circles.x.shape[1], given.model.max_gated)
    x, y, xx, xy, yy = refine(place, given.circles, given.seen, given.vrp_m, given.model, out)
    return np.array([x, y]), np.array([[xx, xy], [xy, yy]])


def test_it_ends_at_the_place_that_gave_the_paths():
    """A sign or a factor wrong in the step would end elsewhere, or nowhere."""
    given = scene(observed([(0.0, 0.0), (2.0, 1.0)], bias=1.0, height2=9.0))
    place, _ = refined(given, Place(ANCHOR[0] + 0.2, ANCHOR[1] - 0.15, 1.0, 9.0, 0.0))
    np.testing.assert_allclose(place, ANCHOR, atol=1e-4)


def test_it_is_the_weighted_least_squares_solution_and_its_information():
    """The information is Laplace's approximation in the evidence: twice too much is 0.7 nats."""
    rng, agent = np.random.default_rng(2), np.array([1.0, 2.0])
    lengths = path_lengths(ANCHOR, agent) + 0.1 * rng.standard_normal(5)
    variance = np.array([0.01, 0.02, 0.04, 0.01, 0.03])
    seen = gathered(agent[None], 0.01 * np.eye(2)[None], [(lengths, variance, np.ones(5))])
    given = scene(seen)
    spread = np.array([0.01, 0.02, 0.03, 0.04, 0.05])  # of agent and walls, alike in all directions

    def residual(place):
        return (path_lengths(place, agent) - lengths) / np.sqrt(variance + spread)

    best = least_squares(residual, ANCHOR, xtol=1e-14, ftol=1e-14)
    place, information = refined(given, Place(*ANCHOR, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(place, best.x, atol=0.01)  # weights are those of associations, near one
    np.testing.assert_allclose(information, best.jac.T @ best.jac, rtol=0.06)


def test_without_paths_nothing_moves():
    """A place that nothing tells must stay, with next to no information."""
    place, information = refined(
        scene(observed([(0.0, 0.0)], anchor=np.array([400.0, 300.0]))), Place(1.0, 2.0, 0.0, 0.0, 0.0)
    )
    np.testing.assert_allclose(place, [1.0, 2.0])
    assert np.trace(information) < 1e-3
