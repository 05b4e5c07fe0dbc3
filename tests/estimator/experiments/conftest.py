"""The paper's room, its walls in an arbitrary order, and shorter walks through it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from estimator.experiments.room import Room, make_room

WALLS = np.array(
    [
        [[0.0, 40.0], [0.0, 0.0]],
        [[0.0, 0.0], [80.0, 0.0]],
        [[80.0, 0.0], [80.0, 60.0]],
        [[80.0, 60.0], [50.0, 60.0]],
        [[50.0, 60.0], [50.0, 40.0]],
        [[50.0, 40.0], [0.0, 40.0]],
    ]
)
CORNERS = np.array([(10, 15), (70, 9), (73.5, 12), (70, 48), (66, 52.5), (54, 55)], dtype=float)


@pytest.fixture(scope="session")
def walk() -> Callable[..., Room]:
    """Makes the room with the anchors called P0 and a walk of so many steps of half a metre."""

    def make(steps: int = 236) -> Room:
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(CORNERS, axis=0), axis=1))])
        at = np.arange(steps) * 0.5
        track = np.stack([np.interp(at, length, CORNERS[:, i]) for i in range(2)], axis=1)
        return make_room("room", WALLS[:, 0], WALLS[:, 1], [[68.0, 6.0], [42.0, 36.0]], track)

    return make
