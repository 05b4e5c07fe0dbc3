"""The state vector's index arithmetic: every coordinate once."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.models.state_vector import (
    AGENT,
    ECHO_BIAS,
    FIRST_ANCHOR,
    HEADING,
    POSITION,
    THETA,
    Layout,
)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize(("anchors", "slots"), [(1, 0), (2, 3), (5, 1)])
def test_every_coordinate_stands_once(shared, anchors, slots):
    """Two parts at one index would overwrite each other."""
    layout = Layout(anchors, slots, shared)
    count = np.zeros(layout.size, dtype=int)
    count[AGENT] += 1
    for index in (THETA, ECHO_BIAS, HEADING):
        count[index] += 1
    for k in range(anchors):
        count[layout.anchor(k)] += 1
        assert layout.anchor_xy(k).start == layout.anchor(k).start
        assert layout.height2(k) == layout.anchor(k).start + 2
        assert layout.bias(k) == layout.anchor(k).stop - 1
        count[layout.scale(k)] += 1
    for slot in range(slots):
        count[layout.wall(slot)] += 1
    assert np.all(count == 1)
    assert layout.anchor(0).start == FIRST_ANCHOR
    assert layout.walls.stop - layout.walls.start == slots * layout.per_slot
    assert layout.features == 1 + slots + (slots**2 if shared else 0)
    assert POSITION.stop == 2
