"""`hapslam reproduce buildings`: random plans traced, mapped and scored, in as many processes as wanted.

A building follows from seed, kind and number alone, and so do its noise and its figures, whatever the
number of processes; only the seconds differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from estimator.errors import ConfigurationError
from estimator.executors import Progress, Workers

if TYPE_CHECKING:
    from estimator.experiments.building_runs import BuildingRun
    from estimator.experiments.report import Report
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["DEFAULT_KINDS", "Building", "building_plan", "map_buildings", "trace_and_map", "wanted_kinds"]

DEFAULT_KINDS = ("suite", "ring", "bent", "aisles", "shops")


@dataclass(frozen=True)
class Building:
    """One random building and how it is sensed.

    Parameters
    ----------
    kind : str
        Kind of the plan.
    number : int
        Number within its kind, from 0.
    seed : int
        Seed of the whole experiment.
    sweep_every : int
        Epochs between sweeps; 0 for one at the start alone.
    odometry, aoa : bool
        Whether the agent measures how it moves, and has a lying array of 4 by 4 antennas.
    """

    kind: str
    number: int
    seed: int
    sweep_every: int = 1
    odometry: bool = False
    aoa: bool = False

    def stream(self, purpose: int) -> np.random.SeedSequence:
        """Seeds of the plan (0) and of the noise (1), the same however it is sensed."""
        from raytrace.plan.random_plans import KINDS

        return np.random.SeedSequence(
            self.seed,
            spawn_key=(list(KINDS).index(self.kind), self.number, purpose),  # type: ignore[arg-type]
        )


def wanted_kinds(names: str) -> tuple[str, ...]:
    """Kinds of a list with commas; the default ones of an empty one.

    Raises
    ------
    ConfigurationError
        If there is no such kind; says which there are.
    """
    from raytrace.plan.random_plans import Kind

    kinds = tuple(dict.fromkeys(name.strip() for name in names.split(",") if name.strip()))
    for kind in kinds:
        if kind not in get_args(Kind):
            raise ConfigurationError(f"kinds: expected some of {', '.join(get_args(Kind))}, got {kind!r}")
    return kinds or DEFAULT_KINDS


def building_plan(building: Building) -> FloorPlan:
    """The plan of a building, sensed as it says, for the engine of the image method."""
    from raytrace.plan.files import updated
    from raytrace.plan.random_plans import random_plan

    plan = random_plan(building.kind, np.random.default_rng(building.stream(0)))  # type: ignore[arg-type]
    changes: dict[str, Any] = {"tracing.engine": "images", "echo.sweep_every": building.sweep_every or None}
    if building.odometry:
        changes["agent.odometry"] = {}
    if building.aoa:
        changes |= {
            "radio.agent_array.elements": 4,
            "radio.agent_array.rows": 4,
            "radio.agent_array.lying": True,
        }
    return updated(plan, changes)


def trace_and_map(building: Building) -> BuildingRun:
    """Trace, extract, map and score a building; what is written on the way is removed."""
    from estimator.experiments.building_runs import map_building
    from estimator.extract import extract
    from raytrace.dataset.generate import generate

    noise = int(building.stream(1).generate_state(1)[0])
    with TemporaryDirectory(prefix="hapslam-building-") as folder:
        dataset = generate(building_plan(building), Path(folder) / "dataset", noise).dataset
        measured = extract(dataset)
        return map_building(building.kind, building.number, measured, dataset.truth(), building.seed)


def map_buildings(
    buildings: Sequence[Building], workers: Workers, progress: Progress | None = None
) -> Report:
    """Report on buildings, mapped where ``workers`` say."""
    from estimator.experiments.buildings import report_of

    runs = workers.map(trace_and_map, buildings, progress)
    first = buildings[0]
    return report_of(
        runs,
        {
            "kinds": list(dict.fromkeys(one.kind for one in buildings)),
            "runs": 1 + max(one.number for one in buildings),
            "seed": first.seed,
            "sweep_every": first.sweep_every,
            "odometry": first.odometry,
            "aoa": first.aoa,
        },
    )
