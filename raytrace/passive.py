"""Specular paths from every anchor to the agent along its whole track.

The track is the receive array of one solver call, in batches of a fixed width, so
that neither a position nor a track's length compiles a kernel. In a large batch the
solver drops a few paths of two and more bounces: it recognises known candidates by a
hash, and hashes collide. The image method says what there should be; positions that
miss something are traced again, repeated until they fill a batch, which gives every
path several other hashes, then with more rays. Paths that bounce within a millimetre
of a corner are not expected: there the tracer's single precision decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raytrace.floorplan import FloorPlan
from raytrace.images import image_paths
from raytrace.paths import PathList, PathSet
from raytrace.scene import RadioScene, build_scene
from raytrace.solver import solve

__all__ = ["TraceReport", "trace_passive"]

BATCH = 256
_RIM_M = 1e-3
# Rays of the repeated attempts, as multiples of the plan's.
_RETRIES = (1, 1, 4, 16)


@dataclass(frozen=True)
class TraceReport:
    """How the traced paths compare with those of the image method.

    Parameters
    ----------
    expected : int
        Paths that the image method gives and that do not bounce within a millimetre
        of a corner, plus those of the latter that were traced.
    found : int
        Traced paths among them.
    missing, extra : int
        Expected paths that were not traced, and traced ones that no image explains.
    retraced : int
        Positions that were traced again.
    """

    expected: int
    found: int
    missing: int
    extra: int
    retraced: int


def trace_passive(
    plan: FloorPlan, radio: RadioScene | None = None, positions_m: NDArray[np.float64] | None = None
) -> tuple[PathSet, TraceReport]:
    """Trace the specular paths of a plan.

    Parameters
    ----------
    plan : FloorPlan
        The plan; ``plan.tracing`` says how deep and with how many rays.
    radio : RadioScene, optional
        Its scene at the carrier of ``plan.radio``; by default it is built.
    positions_m : ndarray, shape (n, 3), optional
        Positions of the agent, metres; by default the plan's track.

    Returns
    -------
    paths : PathSet
        Axes (n, anchors, path): absolute delays, plan frame.
    report : TraceReport
        What was lost, if anything.

    Raises
    ------
    BackendError
        If the ray tracer cannot run on this machine.
    """
    radio = build_scene(plan, plan.radio.carrier_hz) if radio is None else radio
    positions = plan.track() if positions_m is None else positions_m
    wanted = set(image_paths(plan, positions, rim_m=_RIM_M).flat().keys())

    paths = _trace(plan, radio, positions, np.arange(len(positions)), plan.tracing.samples)
    retraced = 0
    for attempt, more in enumerate(_RETRIES):
        missing = sorted({key[0] for key in wanted.difference(paths.keys())})
        if not missing:
            break
        retraced += len(missing)
        epochs = np.roll(missing, attempt)
        again = _trace(plan, radio, positions, epochs, more * plan.tracing.samples)
        paths = _distinct(PathList.concatenate([paths, again]))

    traced = set(paths.keys())
    if traced - wanted:
        wanted |= traced & set(image_paths(plan, positions).flat().keys())
    report = TraceReport(
        expected=len(wanted),
        found=len(wanted & traced),
        missing=len(wanted - traced),
        extra=len(traced - wanted),
        retraced=retraced,
    )
    return PathSet.build(paths, len(positions), len(plan.anchors)), report


def _trace(
    plan: FloorPlan,
    radio: RadioScene,
    positions: NDArray[np.float64],
    epochs: NDArray[np.int64],
    samples: int,
) -> PathList:
    """Paths to the given epochs, in full batches: the last is filled by repeating epochs."""
    filled = np.resize(epochs, -(-len(epochs) // BATCH) * BATCH)
    parts = []
    for batch in filled.reshape(-1, BATCH):
        traced = solve(radio, plan.anchors_m(), positions[batch], depth=plan.tracing.depth, samples=samples)
        parts.append(traced.with_epochs(batch[traced.epoch]))
    return _distinct(PathList.concatenate(parts))


def _distinct(paths: PathList) -> PathList:
    """One of each path, the first in canonical order."""
    paths = paths.canonical()
    rows = np.column_stack([paths.epoch, paths.anchor, paths.walls])
    _, first = np.unique(rows, axis=0, return_index=True)
    return paths.select(np.sort(first))
