"""Parts of a dataset that were made apart, on machines that share nothing, put together.

Parts are of one plan, seed and settings. Whether a shard was made here or there does
not show: the merged dataset has the bytes of one that was made at once.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from estimator.dataset import Dataset, publish, read_manifest, temporary_name
from estimator.errors import ConfigurationError, FileFormatError
from raytrace.dataset.finish import finish
from raytrace.dataset.journal import journal, require_place, require_same, whole_shards
from raytrace.dataset.output import Output
from raytrace.plan.floorplan import FloorPlan

__all__ = ["merge"]

_NOT_OF_THE_HEAD = ("format", "version", "complete", "shards", "statistics")


def merge(plan: FloorPlan, parts: Sequence[Path], out: Path) -> Dataset:
    """Copy the shards of all parts into a new dataset and finish it.

    Parameters
    ----------
    plan : FloorPlan
        The plan of all parts (which do not hold it before they are complete).
    parts : sequence of Path
        Datasets, complete or not; shards that several hold have to be equal.
    out : Path
        Directory to create.

    Raises
    ------
    OutputExistsError
        If ``out`` exists.
    ConfigurationError
        If the parts do not belong together, or not to the plan.
    FileFormatError
        If shards are missing in all parts, or damaged.
    """
    if not parts:
        raise ConfigurationError("parts: expected at least one dataset, got none")
    require_place(out)
    manifests = [read_manifest(part) for part in parts]
    known = {key: value for key, value in manifests[0].items() if key not in _NOT_OF_THE_HEAD}
    for part, manifest in zip(parts, manifests, strict=True):
        require_same(part, manifest, {**known, "scene": {"name": plan.name, "sha256": plan.sha256()}})
    found: dict[str, tuple[Path, dict[str, Any]]] = {}
    for part, manifest in zip(parts, manifests, strict=True):
        for entry in whole_shards(part, manifest):
            _, other = found.setdefault(entry["file"], (part, entry))
            if entry != other:
                raise ConfigurationError(f"{part}: expected {entry['file']} to be equal in all parts")
    output = Output(**{**known["output"], "joints": tuple(known["output"]["joints"])})
    there = {tuple(entry["epochs"]) for _, entry in found.values()}
    absent = [span for span in output.ranges(plan.agent.epochs) if span not in there]
    if absent:
        first, stop = absent[0]
        raise FileFormatError(
            f"parts: expected all {len(absent) + len(there)} shards, {len(absent)} are in none of them, "
            f"such as that of epochs {first} to {stop - 1}"
        )
    with journal(out, known) as writer:
        assert writer is not None  # out is new
        for span in output.ranges(plan.agent.epochs):
            shard = [held for held in found.values() if tuple(held[1]["epochs"]) == span]
            for part, entry in shard:
                target = out / entry["file"]
                temporary = temporary_name(target)
                shutil.copyfile(part / entry["file"], temporary)
                publish(temporary, target)
            writer.add(*(entry for _, entry in shard))
        return finish(writer, plan, known)
