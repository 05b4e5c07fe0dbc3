"""Several agents in one plan: a dataset for each, in a folder of them all.

    OUT/agent/      the plan's ``agent``
    OUT/NAME/       each of its ``agents``

Every one is a dataset like any other, with an estimator's frame of its own; the plan frame of
the truth is common to them. Agents neither hide nor hear one another. The first has the seed,
each of the others one drawn from it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from estimator.executors import Workers
from raytrace.dataset.generate import generate
from raytrace.dataset.journal import require_place
from raytrace.dataset.output import Output
from raytrace.dataset.shard_task import Progress
from raytrace.plan.floorplan import FloorPlan

__all__ = ["generate_agents", "seed_of"]


def generate_agents(
    plan: FloorPlan,
    out: Path,
    seed: int,
    progress: Progress | None = None,
    *,
    output: Output | None = None,
    resume: bool = False,
    crew: Workers | None = None,
) -> tuple[Path, ...]:
    """Trace a plan and write a dataset; if it has several agents, one for each within ``out``.

    Parameters and errors are those of :func:`raytrace.dataset.generate.generate`; ``resume`` leaves
    the agents alone that are finished.

    Returns
    -------
    tuple of Path
        The datasets.
    """
    if not plan.agents:
        generate(plan, out, seed, progress, output=output, resume=resume, crew=crew)
        return (out,)
    if not (resume and out.is_dir()):
        require_place(out)
        out.mkdir()
    for number, (name, alone) in enumerate(plan.by_agent().items()):
        generate(alone, out / name, seed_of(seed, number), progress, output=output, resume=resume, crew=crew)
    return tuple(out / name for name in plan.by_agent())


def seed_of(seed: int, number: int) -> int:
    """Seed of an agent, counted from 0, which has the seed itself."""
    if number == 0:
        return seed
    return int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
