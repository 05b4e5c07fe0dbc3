"""A dataset from a floor plan: shard by shard, by one process or many, and on after a break.

Equal plans, seeds and settings give equal bytes, whoever makes the shards, in whatever
order, and however often it was broken off. What the estimator may read (channels,
beams) and the truth (plan, anchors, track) go to different files; see
:mod:`estimator.dataset` for the layout, :mod:`raytrace.dataset.shard_task` for what is random.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from estimator.dataset import Dataset, DatasetWriter, open_dataset
from estimator.errors import ConfigurationError, WorkerLostError
from estimator.executors import Workers
from raytrace.dataset.finish import finish
from raytrace.dataset.journal import journal, require_place
from raytrace.dataset.manifest import head
from raytrace.dataset.output import Output
from raytrace.dataset.shard_task import Progress, ShardTask, Stages, make_shard
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.passive import TraceReport

__all__ = ["Generated", "generate", "generate_part", "make_shards"]


@dataclass(frozen=True)
class Generated:
    """What :func:`generate` made.

    Parameters
    ----------
    dataset : Dataset
        The dataset, opened.
    seconds : mapping of str to float
        Wall-clock seconds of each stage, summed over the shards made now (never
        written to the dataset).
    report : TraceReport
        How the passive paths compare with the image method.
    """

    dataset: Dataset
    seconds: Mapping[str, float]
    report: TraceReport


def generate(
    plan: FloorPlan,
    out: Path,
    seed: int,
    progress: Progress | None = None,
    *,
    output: Output | None = None,
    resume: bool = False,
    crew: Workers | None = None,
) -> Generated:
    """Trace a plan and write the dataset.

    Parameters
    ----------
    plan : FloorPlan
        What to trace.
    out : Path
        Directory to create.
    seed : int
        Seed of the noise, not negative.
    progress : callable, optional
        Called with (done, in all, what comes next): stages where there is one shard,
        else epochs, with their rate and the time left.
    output : Output, optional
        Shards and contents.
    resume : bool
        Go on with ``out`` if it was begun with the same plan, seed and output, keeping
        the shards that it has; begin it if it is not there.
    crew : Workers, optional
        Who makes the shards; by default this process.

    Raises
    ------
    OutputExistsError
        If ``out`` exists and is not to be gone on with, or another process writes it;
        nothing is traced then.
    ConfigurationError
        If ``out`` was begun with something else, or the plan has several agents.
    BackendError
        If the ray tracer cannot run on this machine, or a worker died.
    """
    out = Path(out)
    settings, known = _prepared(plan, out, seed, output, resume)
    with journal(out, known, resume) as writer:
        seconds: dict[str, float] = {}
        if writer is not None:
            stages = Stages(progress)
            seconds = make_shards(writer, plan, seed, settings, crew, progress, stages)
            start = time.perf_counter()
            finish(writer, plan, known)
            seconds["write"] = seconds.get("write", 0.0) + time.perf_counter() - start
            if stages.seconds:
                stages.finished()
    dataset = open_dataset(out)
    passive = dataset.manifest["statistics"]["passive"]
    report = TraceReport(**{field.name: passive[field.name] for field in fields(TraceReport)})
    return Generated(dataset, seconds, report)


def generate_part(
    plan: FloorPlan,
    out: Path,
    seed: int,
    part: tuple[int, int],
    progress: Progress | None = None,
    *,
    output: Output | None = None,
    resume: bool = False,
    crew: Workers | None = None,
) -> None:
    """Make every ``n``-th shard of a dataset, for :func:`raytrace.dataset.merge.merge` to complete.

    Parameters
    ----------
    part : tuple of int
        Which part, ``(i, n)`` with ``1 <= i <= n``: shards ``i - 1``, ``i - 1 + n``, and so on.
    plan, out, seed, progress, output, resume, crew
        As for :func:`generate`, with its errors.

    Raises
    ------
    ConfigurationError
        If there is no such part.
    """
    number, parts = part
    if not 1 <= number <= parts:
        raise ConfigurationError(f"part: expected i/n with 1 <= i <= n, got {number}/{parts}")
    out = Path(out)
    settings, known = _prepared(plan, out, seed, output, resume)
    shards = len(settings.ranges(plan.agent.epochs))
    if parts > shards:
        raise ConfigurationError(
            f"part: expected at most {shards} parts of {shards} shards, got {parts}: "
            f"a part would be empty; smaller shards (shard_epochs) make more"
        )
    with journal(out, known, resume) as writer:
        if writer is not None:
            make_shards(writer, plan, seed, settings, crew, progress, part=part)


def _prepared(
    plan: FloorPlan, out: Path, seed: int, output: Output | None, resume: bool
) -> tuple[Output, dict[str, Any]]:
    """Settings with everything chosen, and the head of the manifest; nothing is written if that fails."""
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ConfigurationError(f"seed: expected an integer of at least 0, got {seed!r}")
    if plan.agents:
        raise ConfigurationError(f"{plan.name}: expected a plan of one agent, got {1 + len(plan.agents)}")
    if not resume:
        require_place(out)
    settings = (Output() if output is None else output).chosen(plan)
    return settings, head(plan, seed, settings)


def make_shards(
    writer: DatasetWriter,
    plan: FloorPlan,
    seed: int,
    output: Output,
    crew: Workers | None = None,
    progress: Progress | None = None,
    stages: Stages | None = None,
    part: tuple[int, int] = (1, 1),
) -> dict[str, float]:
    """Make the shards that a writer does not have yet.

    Parameters
    ----------
    writer : DatasetWriter
        Is told of every shard as it is finished.
    plan, seed, output, crew, progress
        As for :func:`generate`.
    stages : Stages, optional
        Told of the stages if one shard is all there is, and this process makes it.
    part : tuple of int
        As for :func:`generate_part`.

    Returns
    -------
    dict
        Seconds of each stage, over all shards.

    Raises
    ------
    WorkerLostError
        If a worker process was killed; the shards that are finished stay.
    """
    ranges = output.ranges(plan.agent.epochs)
    there = {tuple(entry["epochs"]) for entry in writer.shards}
    number, parts = part
    mine = [(index, span) for index, span in enumerate(ranges) if index % parts == number - 1]
    tasks = [ShardTask(plan, seed, output, index, *span) for index, span in mine if span not in there]
    total = sum(stop - first for _, (first, stop) in mine)
    crew = Workers() if crew is None else crew
    alone = len(ranges) == 1 and crew.executor is None and stages is not None
    pace = _Pace(None if alone else progress, total - sum(task.stop - task.first for task in tasks), total)
    work = partial(make_shard, folder=writer.path.resolve(), stages=stages if alone else None)
    seconds: dict[str, float] = {}
    try:
        for made in crew.unordered(work, tasks):
            writer.add(*made.entries)
            for stage, spent in made.seconds.items():
                seconds[stage] = seconds.get(stage, 0.0) + spent
            pace.advance(made.stop - made.first)
    except WorkerLostError as error:
        error.add_note("go on with --resume")
        raise
    return seconds


class _Pace:
    """Epochs done, with their rate and the time that the rest will take."""

    def __init__(self, progress: Progress | None, there: int, total: int) -> None:
        self._progress, self._there, self._total = progress, there, total
        self._made, self._begin = 0, time.perf_counter()
        self._tell("starting")

    def advance(self, epochs: int) -> None:
        """Count epochs that were made now."""
        self._made += epochs
        rate = self._made / max(time.perf_counter() - self._begin, 1e-9)
        left = round((self._total - self._there - self._made) / rate)
        self._tell(f"{rate:.0f} epochs/s, {left // 60}:{left % 60:02d} left")

    def _tell(self, text: str) -> None:
        if self._progress is not None:
            self._progress(self._there + self._made, self._total, text)
