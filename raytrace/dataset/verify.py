"""Whether the paths of a dataset are those of its floor plan: the check of the files themselves.

The image method constructs the paths anew from the plan in the truth file, and every
path in the files is looked for among them, and the other way round. Hashes of all
shards are checked on the way. As in generation, paths that are decided at a corner (to a
millimetre, or by two bounces within a centimetre) may or may not have been traced. Of paths
through walls and around corners those that bend once are looked for, too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from estimator.dataset import Dataset
from estimator.errors import FileFormatError
from raytrace.dataset.shards import stored_paths, stored_plan
from raytrace.propagation.comparison import Comparison, compare, compare_bent

__all__ = ["verify"]

Progress = Callable[[int, int, str], None]


def verify(dataset: Dataset, progress: Progress | None = None) -> Comparison:
    """Compare the paths of a dataset with the image method, shard by shard.

    Parameters
    ----------
    dataset : Dataset
        A complete dataset with its truth.
    progress : callable, optional
        Called with (epochs done, epochs in all, what is done).

    Raises
    ------
    FileFormatError
        If a shard is missing or changed, epochs are missing or twice there, or the plan
        is not the one that the manifest names.
    """
    plan = stored_plan(dataset.truth())
    if plan.sha256() != dataset.manifest["scene"]["sha256"]:
        raise FileFormatError(f"{dataset.path}: expected the manifest's plan in truth.nc, found another")
    for kind in ("passive", "echo"):
        for _ in dataset.shards(kind):
            pass
    track, times, done, result = plan.track(), plan.times_s(), 0, Comparison()
    for shard in dataset.shards("paths"):
        epochs = shard["epoch"].values
        if not np.array_equal(epochs, np.arange(done, done + len(epochs))):
            raise FileFormatError(f"{dataset.path}: expected paths from epoch {done} on, got {epochs[:1]}")
        paths = stored_paths(shard, plan.heading_rad).flat()
        if plan.tracing.bends:
            result = result + compare_bent(plan, track[epochs], paths, done)
        result = result + compare(plan, track[epochs], paths.select(paths.is_specular), done, times[epochs])
        done += len(epochs)
        if progress is not None:
            progress(done, len(track), "comparing paths")
    if done != len(track):
        raise FileFormatError(f"{dataset.path}: expected paths of {len(track)} epochs, got {done}")
    return result
