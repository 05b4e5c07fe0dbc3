"""Observed extents against bounce points by the image method."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import mirror
from estimator.slam.models.extents import bounce_along_wall, widen_extents
from estimator.slam.models.state_vector import Layout

LAYOUT = Layout(1, 2)
VRPS = np.array([[10.0, 4.0], [-6.0, 14.0]])
ANCHOR = np.array([1.0, -3.0])


def bounce(agent, vrp):
    """Where the beam from the anchor meets the wall, metres along it from the foot of RP."""
    image = mirror(ANCHOR, vrp)
    normal = vrp / np.linalg.norm(vrp)
    fraction = (0.5 * np.linalg.norm(vrp) - agent @ normal) / ((image - agent) @ normal)
    point = agent + fraction * (image - agent)
    return (point - 0.5 * vrp) @ np.array([-normal[1], normal[0]])


def test_the_bounce_is_where_the_beam_meets_the_wall():
    """An extent measured elsewhere would hide what can be seen."""
    rng = np.random.default_rng(1)
    for agent in rng.normal(size=(50, 2)):
        for vrp in VRPS:
            assert bounce_along_wall(*agent, *ANCHOR, *vrp) == pytest.approx(bounce(agent, vrp), abs=1e-9)


def test_detections_widen_and_nothing_narrows():
    """From where a wall was first and last detected, and along which stretch; a chance of a half is none."""
    mean = np.zeros(LAYOUT.size)
    mean[LAYOUT.anchor_xy(0)], mean[LAYOUT.walls] = ANCHOR, VRPS.ravel()
    extent = np.array([[np.inf, -np.inf], [np.inf, -np.inf]])
    places = np.full((2, 1, 2, 2), np.nan)
    track = np.array([[0.0, 0.0], [2.0, 1.0], [1.0, -1.0]])
    along = []
    for agent in track:
        mean[:2] = agent
        detected = np.zeros((1, LAYOUT.features))
        detected[0, 1:3] = 0.9, 0.5
        before = extent.copy()
        extent, places = widen_extents(LAYOUT, mean, detected, extent, places)
        along.append(bounce(agent, VRPS[0]))
        assert not np.array_equal(before, extent) or len(along) > 2
    assert extent[0] == pytest.approx([min(along), max(along)])
    assert extent[1].tolist() == [np.inf, -np.inf]
    assert places[0, 0].tolist() == [track[0].tolist(), track[-1].tolist()]
    assert np.isnan(places[1]).all()
