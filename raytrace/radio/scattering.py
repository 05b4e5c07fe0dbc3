"""What rough surfaces add to the passive channels: single diffuse reflections.

Rays are shot evenly from every anchor; where one meets a surface that scatters, a
share of its power goes to every position of the agent that sees the place. The
places are the same for the whole track, as those of a real wall are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.paths import PathList, PathSet
from raytrace.propagation.scene import RadioScene
from raytrace.propagation.solver import solve
from raytrace.radio.reception import receive

__all__ = ["diffuse_response"]

# Positions traced and summed at a time: bounds the memory of the sum over paths and tones.
_BATCH = 32


def diffuse_response(
    plan: FloorPlan, radio: RadioScene, epochs: NDArray[np.int64]
) -> tuple[NDArray[np.complex128], int]:
    """Noiseless diffuse part of every passive link.

    Parameters
    ----------
    plan : FloorPlan
        The plan; ``tracing.diffuse_samples`` rays leave each anchor.
    radio : RadioScene
        Its scene at the carrier of ``plan.radio``.
    epochs : ndarray of int64, shape (epochs,)
        Epochs of the plan's track.

    Returns
    -------
    response : ndarray of complex128, shape (epochs, anchors, snapshots, antennas, tones)
        Channel gains (dimensionless).
    paths : int
        Number of diffuse paths in it.
    """
    positions, anchors = plan.track()[epochs], plan.anchors_m()
    rays = plan.tracing.diffuse_samples
    parts, total = [], 0
    for start in range(0, len(positions), _BATCH):
        # The last batch is filled up to the width that the kernels are compiled for.
        batch = np.minimum(np.arange(start, start + _BATCH), len(positions) - 1)
        traced = [
            solve(
                radio,
                anchor,
                positions[batch],
                depth=1,
                samples=rays,
                los=False,
                diffuse=True,
                polarised=plan.polarised,
                most_paths=_BATCH * rays,
            )
            for anchor in anchors
        ]
        paths = PathList.concatenate(
            [replace(part, anchor=np.full(len(part), index)) for index, part in enumerate(traced)]
        )
        here = epochs[start : start + _BATCH]
        kept = paths.select(paths.epoch < len(here))
        parts.append(receive(plan, PathSet.build(kept, len(here), len(anchors)), here))
        total += len(kept)
    return np.concatenate(parts), total
