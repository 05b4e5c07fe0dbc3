"""A room, its truth, and results with known errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.geometry import rotate, vrp_of_line
from estimator.result import SlamResult
from estimator.specular import specular_paths

START, HEADING = np.array([4.0, 5.0]), 0.3
WALLS = {
    "west": ((0.0, 0.0), (0.0, 12.0)),
    "south-left": ((0.0, 0.0), (9.0, 0.0)),
    "south-right": ((11.0, 0.0), (20.0, 0.0)),
    "east": ((20.0, 0.0), (20.0, 12.0)),
    "north": ((20.0, 12.0), (0.0, 12.0)),
}
ANCHORS = np.array([[17.0, 3.0], [15.0, 10.0]])
EPOCHS = 40


@pytest.fixture(scope="session")
def truth() -> xr.Dataset:
    """The truth of a room of 20 m x 12 m with a door in its south wall, as a dataset holds it."""
    start, end = (np.array([wall[i] for wall in WALLS.values()]) for i in (0, 1))
    track = START + np.linspace(0.0, 1.0, EPOCHS)[:, None] * np.array([9.0, 3.0])
    paths = specular_paths(start, end, ANCHORS, track)
    reflects = np.zeros((EPOCHS, len(ANCHORS), len(WALLS)), dtype=np.int8)
    for candidate, walls in enumerate(paths.walls):
        if len(walls) == 1:
            reflects[:, :, walls[0]] = paths.visible[:, :, candidate]
    heights = np.full((EPOCHS, 1), 1.5)
    return xr.Dataset(
        {
            "anchor_position_m": (("anchor", "xyz"), np.hstack([ANCHORS, np.full((2, 1), 2.5)])),
            "track_m": (("epoch", "xyz"), np.hstack([track, heights])),
            "time_s": ("epoch", np.arange(EPOCHS) * 1.0),
            "wall_start_m": (("wall", "xy"), start),
            "wall_end_m": (("wall", "xy"), end),
            "vrp_m": (("wall", "xy"), vrp_of_line(start, end, START)),
            "reflects": (("epoch", "anchor", "wall"), reflects),
        },
        coords={"epoch": np.arange(EPOCHS), "anchor": ["pa1", "pa2"], "wall": list(WALLS)},
        attrs={"start_m": np.append(START, 1.5), "heading_rad": HEADING},
    )


@pytest.fixture(scope="session")
def make_result(truth: xr.Dataset) -> Callable[..., SlamResult]:
    """Makes a result that equals the truth, turned by ``turn`` rad and moved by ``shift``, with changes."""

    def local(points: np.ndarray) -> np.ndarray:
        return rotate(np.asarray(points)[..., :2] - START, -HEADING)

    def make(turn: float = 0.0, shift: tuple[float, float] = (0.0, 0.0), **changes: Any) -> SlamResult:
        def place(points: np.ndarray) -> np.ndarray:
            return rotate(local(points), turn) + np.asarray(shift)

        vrps = place(truth["vrp_m"].values)[[0, 1, 3, 4]]  # both south walls are one line
        agent = np.zeros((EPOCHS, 4))
        agent[:, :2] = place(truth["track_m"].values)
        covariance = np.tile(np.diag([0.04, 0.04, 0.01, 0.01]), (EPOCHS, 1, 1))
        covariance[0] = 0.0
        fields: dict[str, Any] = {
            "method": "hybrid",
            "engine": "gaussian",
            "seed": 1,
            "anchors": ("pa1", "pa2"),
            "epoch": np.arange(EPOCHS),
            "time_s": np.arange(EPOCHS) * 1.0,
            "agent_mean": agent,
            "agent_covariance": covariance,
            "rotation_std_rad": np.full(EPOCHS, 0.01),
            "anchor_valid": np.ones((EPOCHS, 2), dtype=bool),
            "anchor_mean_m": np.tile(place(ANCHORS), (EPOCHS, 1, 1)),
            "anchor_covariance_m2": np.tile(0.01 * np.eye(2), (EPOCHS, 2, 1, 1)),
            "wall_id": np.arange(len(vrps)),
            "wall_valid": np.ones((EPOCHS, len(vrps)), dtype=bool),
            "wall_mean_m": np.tile(vrps, (EPOCHS, 1, 1)),
            "wall_covariance_m2": np.tile(0.01 * np.eye(2), (EPOCHS, len(vrps), 1, 1)),
            "hypotheses": np.ones(EPOCHS, dtype=np.int64),
            "log_evidence": -np.arange(EPOCHS) * 1.0,
            "anchor_existence": np.ones((EPOCHS, 2)),
            "wall_existence": np.ones((EPOCHS, len(vrps))),
            "candidate_weight": np.ones((EPOCHS, 1)),
            "candidate_agent_m": agent[:, None, :2],
            "candidate_wall_id": np.arange(len(vrps)),
            "candidate_wall_mean_m": np.tile(vrps, (EPOCHS, 1, 1, 1)),
            "settings": {"slam": {"detection_probability": 0.95}},
            "dataset": "room",
        }
        return SlamResult(**{**fields, **changes})

    return make
