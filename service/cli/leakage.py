"""`hapslam reproduce leakage`: how near a wall may stand to a device that hears its own transmitter.

A concrete wall stands at a distance, in a direction that is drawn; the device sweeps its beams, its leakage
and noise are drawn, too. Counted are the walls found where it is, and those found elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.executors import Progress, Workers

if TYPE_CHECKING:
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["DISTANCES_M", "ISOLATIONS_DB", "Cell", "leakage_table", "leakage_text", "measured_cell"]

ISOLATIONS_DB: tuple[float | None, ...] = (None, 80.0, 60.0, 40.0)
DISTANCES_M = (0.25, 0.28, 0.3, 0.4, 0.6, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
# A wall is where it stands if it is found this near, metres: far below a cell of 0.38 m.
_THERE_M = 0.15
_LENGTH_M = 60.0  # of the wall


@dataclass(frozen=True)
class Cell:
    """A cell of the table: isolation (dB; None: nothing leaks), distance (metres), draws and seed."""

    isolation_db: float | None
    distance_m: float
    draws: int
    seed: int


def leakage_table(
    draws: int, seed: int, workers: Workers, progress: Progress | None = None
) -> dict[str, Any]:
    """Shares of walls found, and walls found where none is, over isolation and distance (JSON types)."""
    cells = [Cell(isolation, d, draws, seed) for isolation in ISOLATIONS_DB for d in DISTANCES_M]
    counts = workers.map(measured_cell, cells, progress)
    rows = []
    for isolation in ISOLATIONS_DB:
        mine = [n for cell, n in zip(cells, counts, strict=True) if cell.isolation_db == isolation]
        rows.append(
            {
                "isolation_db": isolation,
                "found": [found / draws for found, _ in mine],
                "false_per_100_sweeps": 100.0 * sum(false for _, false in mine) / (draws * len(mine)),
            }
        )
    return {"draws": draws, "seed": seed, "distances_m": list(DISTANCES_M), "rows": rows}


def measured_cell(cell: Cell) -> tuple[int, int]:
    """In how many draws of a cell the wall was found, and how many walls were found elsewhere."""
    from estimator.sensing.flash import find_flashes, flash_walls

    found = false = 0
    for plan, response, place in _sweeps(cell):
        echo = plan.echo
        flashes = find_flashes(response, echo.noise_variance(), echo.grid(), echo.beams.beam_set())
        near = [0.5 * float(np.linalg.norm(wall.mean_m - place)) <= _THERE_M for wall in flash_walls(flashes)]
        found += any(near)
        false += len(near) - sum(near)
    return found, false


def _sweeps(cell: Cell) -> Iterator[tuple[FloorPlan, Any, Any]]:
    """Draws of a cell: the plan, its noisy sweep, and the wall's virtual reference point."""
    from raytrace.radio.channel import add_noise
    from raytrace.radio.echo import sweep_echo
    from raytrace.radio.leakage import leakage_response

    isolation = 0 if cell.isolation_db is None else int(cell.isolation_db)
    key = (isolation, int(1e3 * cell.distance_m))
    for draw in range(cell.draws):
        rng = np.random.default_rng(np.random.SeedSequence(cell.seed, spawn_key=(*key, draw)))
        azimuth = float(rng.uniform(-np.pi, np.pi))
        plan = _plan(cell.distance_m, azimuth)
        response = sweep_echo(plan, epochs=(0,)).response
        if cell.isolation_db is not None:
            response = response + leakage_response(plan.echo, cell.isolation_db, 1, rng, rng)
        towards = np.array([np.cos(azimuth), np.sin(azimuth)])
        yield plan, add_noise(response, plan.echo.noise_variance(), rng)[0], 2.0 * cell.distance_m * towards


def _plan(distance_m: float, azimuth_rad: float) -> FloorPlan:
    """A wall before a device at (0, 0), for the engine of the image method."""
    from raytrace.plan.files import parse_floorplan

    towards = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    along = 0.5 * _LENGTH_M * np.array([-towards[1], towards[0]])
    foot = distance_m * towards
    return parse_floorplan(
        {
            "format": "hapslam-floorplan",
            "version": 1,
            "name": "wall",
            "walls": [
                {"name": "wall", "from_m": (foot - along).tolist(), "to_m": (foot + along).tolist()},
            ],
            "anchors": [{"name": "pa1", "position_m": [*(-5.0 * towards), 2.5]}],
            "agent": {
                "waypoints_m": [[0.0, 0.0], (-towards).tolist()],
                "epochs": 1,
                "smoothing_m": 0.0,
            },
            "tracing": {"engine": "images"},
            "echo": {"depth": 1},
        }
    )


def leakage_text(table: dict[str, Any]) -> str:
    """The table for people, as Markdown."""
    head = ["isolation", *(f"{distance:g} m" for distance in table["distances_m"]), "false in 100 sweeps"]
    lines = [head, ["---"] * len(head)]
    for row in table["rows"]:
        name = "none leaks" if row["isolation_db"] is None else f"{row['isolation_db']:g} dB"
        shares = [f"{share:.0%}" for share in row["found"]]
        lines.append([name, *shares, f"{row['false_per_100_sweeps']:.1f}"])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
