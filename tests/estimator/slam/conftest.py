"""The paper's L-shaped room, as geometry alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.geometry import vrp_of_line
from estimator.measurements import MeasurementSet
from estimator.simulate import SimulationConfig, measure_scene

WALLS = np.array(
    [
        [[0.0, 0.0], [0.0, 40.0]],
        [[0.0, 40.0], [50.0, 40.0]],
        [[80.0, 0.0], [80.0, 60.0]],
        [[0.0, 0.0], [80.0, 0.0]],
        [[50.0, 60.0], [80.0, 60.0]],
        [[50.0, 40.0], [50.0, 60.0]],
    ]
)


@dataclass(frozen=True)
class Room:
    """Walls (6, 2, 2), anchors (2, 2) and track (T, 2) in the plan's frame."""

    walls: NDArray[np.float64]
    anchors: NDArray[np.float64]
    track: NDArray[np.float64]

    @property
    def vrps(self) -> NDArray[np.float64]:
        """True VRPs relative to the start."""
        return vrp_of_line(self.walls[:, 0], self.walls[:, 1], self.track[0]) - self.track[0]

    def measure(
        self, seed: int, epochs: int | None = None, know_anchors: bool = False, **model: float
    ) -> MeasurementSet:
        """A simulated run with the paper's active-sensing variances."""
        return measure_scene(
            self.walls[:, 0],
            self.walls[:, 1],
            self.anchors,
            self.track[:epochs],
            (0.08, 0.7, 4.0, 0.2),
            28e9,
            SimulationConfig(**model),
            np.random.default_rng(seed),
            know_anchors=know_anchors,
        )


@pytest.fixture(scope="session")
def room() -> Room:
    """The room with the anchors called P0 and 236 positions half a metre apart."""
    corners = np.array([(10, 15), (70, 9), (73.5, 12), (70, 48), (66, 52.5), (54, 55)], dtype=float)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.arange(236) * 0.5
    track = np.stack([np.interp(at, length, corners[:, i]) for i in range(2)], axis=1)
    return Room(WALLS, np.array([[68.0, 6.0], [42.0, 36.0]]), track)
