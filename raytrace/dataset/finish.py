"""The end of a generation: what is told of all shards together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from estimator.dataset import (
    Dataset,
    DatasetWriter,
    open_dataset,
    remove_temporaries,
    write_shard,
    write_text,
)
from raytrace.dataset.card import CARD, data_card
from raytrace.dataset.croissant import CROISSANT, croissant
from raytrace.dataset.manifest import statistics
from raytrace.dataset.shards import truth_shard
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.engine import judge
from raytrace.propagation.paths import SPECULAR

__all__ = ["finish"]


def finish(writer: DatasetWriter, plan: FloorPlan, head: Mapping[str, Any]) -> Dataset:
    """Write truth, statistics and data card of a dataset whose shards are all there; mark it complete.

    The paths are read back shard by shard, whether they were written just now or before
    an interruption.

    Parameters
    ----------
    writer : DatasetWriter
        Its shards are listed, the truth is not.
    plan : FloorPlan
        The plan.
    head : mapping
        What the manifest says already.
    """
    reflects = np.zeros((plan.agent.epochs, len(plan.anchors), len(plan.walls)), dtype=np.bool_)
    delays = [np.empty(0)]
    for entry in writer.shards:
        if entry["kind"] != "paths":
            continue
        with xr.open_dataset(writer.path / entry["file"], engine="h5netcdf") as paths:
            valid = paths["path_valid"].values.astype(bool)
            order, first_wall = paths["order"].values, paths["walls"].values[..., 0]
            delays.append(paths["delay_s"].values[valid & (order == 0)])
            kinds = paths["interactions"].values[..., 0] if "interactions" in paths else SPECULAR
        epoch, anchor, _ = at = np.nonzero(valid & (order == 1) & (kinds == SPECULAR))
        inside = first_wall[at] < len(plan.walls)
        reflects[entry["epochs"][0] + epoch[inside], anchor[inside], first_wall[at][inside]] = True
    truth = write_shard(writer.path, "truth", "truth.nc", truth_shard(plan, reflects), replace=True)
    counts = statistics(plan, writer.shards, np.concatenate(delays))
    if plan.tracing.engine == "images":
        verdict = judge(plan)
        counts["judged_by_ray_tracer"] = None if verdict is None else verdict.as_dict()
    writer.add(truth)
    write_text(data_card({**head, "statistics": counts}, writer.shards), writer.path / CARD)
    write_text(croissant(head, writer.shards), writer.path / CROISSANT)
    remove_temporaries(writer.path)
    writer.finish(statistics=counts)
    return open_dataset(writer.path)
