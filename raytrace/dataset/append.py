"""A longer walk: more epochs for a dataset that is complete, as further shards.

What is there stays as it is, byte for byte, except for the truth, the data card and
the manifest, which tell of the whole track. Broken off, appending goes on when it is
asked for again.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from estimator.dataset import (
    FORMAT,
    VERSION,
    Dataset,
    DatasetWriter,
    open_dataset,
    read_manifest,
    read_netcdf,
    remove_temporaries,
)
from estimator.errors import ConfigurationError
from estimator.executors import Workers
from raytrace.dataset.finish import finish
from raytrace.dataset.generate import make_shards
from raytrace.dataset.journal import claimed, require_same, whole_shards
from raytrace.dataset.manifest import head
from raytrace.dataset.output import Output
from raytrace.dataset.shard_task import Progress
from raytrace.dataset.shards import stored_plan
from raytrace.plan.files import updated

__all__ = ["append"]


def append(path: Path, epochs: int, progress: Progress | None = None, crew: Workers | None = None) -> Dataset:
    """Walk on to a number of epochs along the way-points of the dataset's plan.

    Parameters
    ----------
    path : Path
        A complete dataset with its truth, or one whose appending was broken off.
    epochs : int
        Epochs that the dataset has afterwards; its way-points have to reach that far.
    progress, crew
        As for :func:`raytrace.dataset.generate.generate`.

    Raises
    ------
    ConfigurationError
        If the dataset has as many epochs already, its generation was broken off, or it was made
        with other versions of the ray tracer.
    FloorPlanError
        If the way-points end before.
    FileFormatError, OutputExistsError, BackendError
        If the dataset cannot be read, another process writes it, or nothing can be traced here.
    """
    path = Path(path)
    with claimed(path):
        manifest = read_manifest(path)
        known, joints = int(manifest["epochs"]), tuple(manifest["output"]["joints"])
        complete = manifest.get("complete") is True
        if complete and epochs == known and joints:
            return open_dataset(path)
        if not complete and (not joints or epochs != known):
            raise ConfigurationError(
                f"{path}: expected a complete dataset, it was broken off on the way to {known} epochs"
            )
        if complete and epochs <= known:
            raise ConfigurationError(f"epochs: expected more than the {known} that {path} has, got {epochs}")
        begun = stored_plan(read_netcdf(path / "truth.nc", f"{FORMAT}/truth", VERSION))
        plan = updated(begun, {"agent.epochs": epochs})
        stored = Output(**{**manifest["output"], "joints": joints})
        output = replace(stored, joints=(*joints, known)) if complete else stored
        goal = head(plan, int(manifest["seed"]), output)
        require_same(path, manifest, {"versions": goal["versions"]})
        remove_temporaries(path)
        writer = DatasetWriter(path, goal, whole_shards(path, manifest))
        make_shards(writer, plan, int(manifest["seed"]), output, crew, progress)
        return finish(writer, plan, goal)
