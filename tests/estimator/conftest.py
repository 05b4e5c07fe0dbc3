"""A room, its truth, and results with known errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.channel.model import delay_atoms
from estimator.dataset import DatasetWriter, open_dataset
from estimator.geometry import rotate, vrp_of_line
from estimator.result import SlamResult
from estimator.specular import specular_paths
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import load_floorplan
from raytrace.propagation.images import image_paths
from raytrace.radio.channel import add_noise, channel_response
from raytrace.radio.impairments import jitter
from tests.channel_shards import JITTER_S, Room, beams_of, echo_shard, passive_shard, signal

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


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    """The room as a dataset without paths and truth: what the estimator is to work from."""
    rng = np.random.default_rng(31)
    plan = load_floorplan("l-room")
    track = plan.track()[::6]
    paths = image_paths(plan, track, depth=2)
    grid, noise = plan.radio.grid(), plan.radio.noise_variance()
    cfr = add_noise(jitter(channel_response(paths, grid), grid, JITTER_S, rng), noise, rng)

    beams, echo_grid, echo_noise = plan.echo.beams.beam_set(), plan.echo.grid(), plan.echo.noise_variance()
    start, end = plan.walls_m()
    offsets = vrp_of_line(start, end, track[0, :2]) - track[0, :2]
    foot = track[0, :2] + 0.5 * offsets
    along = np.sum((foot - start) * (end - start), axis=1) / np.sum((end - start) ** 2, axis=1)
    vrps = offsets[(along > 0.0) & (along < 1.0) & (np.abs(foot[:, 1]) <= 40.0)]
    lengths = np.linalg.norm(vrps, axis=1)
    gains = 0.4 * echo_grid.wavelength_m / (4.0 * np.pi * lengths) * np.exp(2j * np.pi * rng.uniform(size=4))
    patterns = beams.two_way(np.arctan2(vrps[:, 1], vrps[:, 0])).T * gains
    echo = add_noise(patterns @ delay_atoms(echo_grid, lengths / SPEED_OF_LIGHT_M_S), echo_noise, rng)

    anchors = [anchor.name for anchor in plan.anchors]
    manifest = {
        "name": "l-room",
        "seed": 31,
        "anchors": anchors,
        "epochs": len(track),
        "radio": signal(grid, noise),
        "echo": {**signal(echo_grid, echo_noise), "beams": beams_of(beams)},
    }
    folder = tmp_path_factory.mktemp("room") / "dataset"
    writer = DatasetWriter(folder, manifest)
    half = len(track) // 2
    writer.write("passive", "passive-00000.nc", passive_shard(cfr[:half], anchors))
    writer.write("passive", "passive-00001.nc", passive_shard(cfr[half:], anchors, half))
    writer.write("echo", "echo-00000.nc", echo_shard(echo[None]))
    writer.finish()
    return Room(open_dataset(folder), paths, vrps)
