"""The shipped example: a walk through an L-shaped room, simulated, as requests to the service."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import MeasurementSet
from estimator.simulate import SimulationConfig, measure_scene
from service.messages.documents import dump
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from service.session.tasks import TaskContext

__all__ = ["ExampleTask", "example", "example_measurements"]

_WALLS = np.array(
    [
        [(0.0, 0.0), (0.0, 40.0)],
        [(0.0, 40.0), (50.0, 40.0)],
        [(80.0, 0.0), (80.0, 60.0)],
        [(0.0, 0.0), (80.0, 0.0)],
        [(50.0, 60.0), (80.0, 60.0)],
        [(50.0, 40.0), (50.0, 60.0)],
    ]
)
_NAMES = ("west", "north", "east", "south", "north of the annex", "edge")
_ANCHORS = np.array([(68.0, 6.0), (42.0, 36.0)])
_CORNERS = np.array([(10.0, 15.0), (70.0, 9.0), (73.5, 12.0), (70.0, 48.0), (66.0, 52.5), (54.0, 55.0)])
_SENSED_M2 = (0.08, 0.7, 4.0, 0.2)  # what active sensing knows of the first walls, per axis


def example(seed: int, step_m: float = 0.5) -> dict[str, Any]:
    """Requests in the order to send them: ``session``, ``sweep``, ``truth``, and all ``epochs``.

    Parameters
    ----------
    seed : int
        Seed of the simulated noise.
    step_m : float
        How far the agent goes from epoch to epoch, metres.
    """
    track, measurements = example_measurements(seed, step_m)
    start_frame = {"position_m": track[0].tolist(), "heading_rad": 0.0}
    return {
        "session": session_entry(measurements, name=f"example, seed {seed}", start_frame=start_frame),
        "sweep": sweep_entry(measurements),
        "truth": {
            "frame": "plan",
            "start_frame": start_frame,
            "walls": [
                {"name": name, "from_m": wall[0].tolist(), "to_m": wall[1].tolist()}
                for name, wall in zip(_NAMES, _WALLS, strict=True)
            ],
            "anchors_m": _ANCHORS.tolist(),
            "track_m": track.tolist(),
        },
        "epochs": [epoch_entry(measurements.anchors, epoch) for epoch in measurements.epochs],
    }


def example_measurements(seed: int, step_m: float = 0.5) -> tuple[NDArray[np.float64], MeasurementSet]:
    """The example's track (T, 2), metres, and what is measured along it; parameters as of :func:`example`."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(_CORNERS, axis=0), axis=1))])
    at = np.arange(0.0, length[-1], step_m)
    track = np.stack([np.interp(at, length, _CORNERS[:, axis]) for axis in range(2)], axis=1)
    return track, measure_scene(
        _WALLS[:, 0],
        _WALLS[:, 1],
        _ANCHORS,
        track,
        _SENSED_M2,
        28e9,
        SimulationConfig(),
        np.random.default_rng(seed),
    )


@dataclass(frozen=True)
class ExampleTask:
    """The example of a seed as JSON; see :func:`example`."""

    seed: int

    def run(self, context: TaskContext) -> str:
        """Make it."""
        del context
        return dump(example(self.seed))
