"""When anchors are searched."""

from __future__ import annotations

import pytest

from estimator.slam.anchors.schedule import is_doubtful, is_due, is_early
from tests.estimator.slam.anchors.scenes import SEARCH


@pytest.mark.parametrize(
    ("epoch", "before", "located", "due"),
    [
        (0, 0, False, True),
        (3, 3, True, True),
        (5, 5, False, False),
        (12, 12, False, True),
        (12, 12, True, False),
        (16, 16, True, True),
    ],
)
def test_early_then_every_fourth_then_every_eighth(epoch, before, located, due):
    """Searches too seldom start anchors late; searches of every epoch cost what they do not bring."""
    assert is_due(epoch, before, located, SEARCH) == due
    assert is_early(before, SEARCH) == (before < 4)


@pytest.mark.parametrize(
    ("unassociated", "visible", "doubtful"), [(40, 2, False), (41, 2, True), (41, 3, False), (400, 2, True)]
)
def test_an_anchor_is_doubted_for_more_than_clutter(unassociated, visible, doubtful):
    """16 epochs of one path of clutter: 16 + 4 x 4 + 0.5 x 16 = 40 unassociated paths are nothing special."""
    assert is_doubtful(unassociated, 16, 1.0, visible, SEARCH) == doubtful
