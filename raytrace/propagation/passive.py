"""Specular paths, complete: the solver's, checked against the image method.

The agent's track is the receive array of one solver call for each anchor, in batches
of a fixed width, so that neither a position, nor a track's length, nor another anchor
compiles a kernel. They are traced in a stretched scene, in which a sixth of the plan's rays finds
more paths than all of them in the true one (:mod:`raytrace.propagation.scene`). In a large batch the solver
drops a few paths of two and more bounces: it recognises candidates that it has seen by a hash,
and hashes collide. The image method says what there should be; positions that miss something are traced
again in small batches with more rays, repeated until they fill them, which gives every
path several other hashes, too. Paths that bounce within a millimetre of a corner, or pass one so
closely, are not expected, for there the tracer's single precision decides, and not extra
if they are found; nor are those with a leg of about a centimetre or less (two bounces at
one corner), which the tracer leaves out. Delays, directions and gains are computed in double
precision from the surfaces that a path met, in the true scene, and paths that name the surface
beside the one they meet are dropped (:mod:`raytrace.propagation.bounces`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.bounces import sharpened
from raytrace.propagation.images import image_paths
from raytrace.propagation.paths import DIFFRACTION, NO_SURFACE, PathList, PathSet
from raytrace.propagation.scene import RadioScene, build_scene
from raytrace.propagation.solver import Bends, solve

__all__ = [
    "LEG_M",
    "RIM_M",
    "TraceReport",
    "distinct_paths",
    "trace_batches",
    "trace_passive",
    "trace_specular",
]

_BATCH = 256
RIM_M = 1e-3
# The tracer's own limit is 10 mm; its single precision misjudges by up to a millimetre.
LEG_M = 12e-3
# What the tracer's single precision makes of one length, metres, is within this.
_SAME_LENGTH_M = 1e-3
# Directions in which paths around corners arrive are told apart in steps of this, radians.
_SAME_BEARING_RAD = 0.01
# Rays of the attempts, as shares of the plan's, and positions in a batch. A call costs the more positions
# and rays the more, but mostly the same: the first takes many positions at once, and what few positions
# miss then, a surface so small that no ray met it or a hash that collided, is soon shot with many rays.
_ATTEMPTS = ((1 / 6, 2 * _BATCH), (1, 128), (8, 32), (32, 16), (256, 4))

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TraceReport:
    """How the traced paths compare with those of the image method.

    Parameters
    ----------
    expected : int
        Paths that the image method gives and that are not decided at a corner (to a
        millimetre, or by two bounces within a centimetre), plus those of the latter that
        were traced.
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

    def as_dict(self) -> dict[str, int]:
        """The counts by name."""
        return asdict(self)


def trace_passive(plan: FloorPlan, radio: RadioScene | None = None) -> tuple[PathSet, TraceReport]:
    """Trace the specular paths from every anchor along the agent's track.

    Parameters
    ----------
    plan : FloorPlan
        The plan; ``plan.tracing`` says how deep and with how many rays.
    radio : RadioScene, optional
        Its scene at the carrier of ``plan.radio``; by default it is built.

    Returns
    -------
    paths : PathSet
        Axes (epochs, anchors, path): absolute delays, plan frame.
    report : TraceReport
        What was lost, if anything.

    Raises
    ------
    BackendError
        If the ray tracer cannot run on this machine.
    """
    radio = build_scene(plan, plan.radio.carrier_hz) if radio is None else radio
    return trace_specular(
        plan, radio, plan.anchors_m(), plan.track(), plan.tracing.depth, polarised=plan.polarised
    )


def trace_specular(
    plan: FloorPlan,
    radio: RadioScene,
    sources_m: Array,
    positions_m: Array,
    depth: int,
    *,
    polarised: bool = False,
) -> tuple[PathSet, TraceReport]:
    """Trace the specular paths from sources (k, 3) to positions (n, 3), metres; as :func:`trace_passive`.

    ``radio`` is the true scene; paths are looked for in its stretched one.
    """
    exact = image_paths(plan, positions_m, depth, sources_m, rim_m=RIM_M, leg_m=LEG_M).flat()

    def keys(paths: PathList) -> NDArray[np.int64]:
        return paths.keys(len(sources_m), len(plan.surface_names))

    parts, retraced = [], 0
    for index, source in enumerate(sources_m):
        trace = partial(trace_batches, radio.tall, source, index, positions_m, depth=depth, polarised=False)
        mine = exact.select(exact.anchor == index)
        part, again = _complete(trace, len(positions_m), plan.tracing.samples, mine.epoch, keys(mine), keys)
        parts.append(part)
        retraced += again

    paths = sharpened(
        plan, PathList.concatenate(parts), positions_m, sources_m, RIM_M, radio.carrier_hz, polarised
    )
    expected, traced = keys(exact), keys(paths)
    unexpected = ~np.isin(traced, expected)
    if unexpected.any():
        where, among = np.unique(paths.epoch[unexpected]), paths.walls[unexpected]
        there = image_paths(plan, positions_m[where], depth, sources_m, rim_m=-RIM_M, among=among).flat()
        at_corners = keys(replace(there, epoch=where[there.epoch]))
        expected = np.union1d(expected, np.intersect1d(traced[unexpected], at_corners))
    found = np.intersect1d(expected, traced).size
    report = TraceReport(
        expected=expected.size,
        found=found,
        missing=expected.size - found,
        extra=traced.size - found,
        retraced=retraced,
    )
    return PathSet.build(paths, len(positions_m), len(sources_m)), report


def _complete(
    trace: Callable[..., PathList],
    positions: int,
    samples: int,
    epoch: NDArray[np.int64],
    expected: NDArray[np.int64],
    keys: Callable[[PathList], NDArray[np.int64]],
) -> tuple[PathList, int]:
    """Trace until nothing ``expected`` at any ``epoch`` is missing; the paths, and positions traced again."""
    part: PathList | None = None
    where, retraced = np.arange(positions), 0
    for attempt, (share, width) in enumerate(_ATTEMPTS):
        if part is not None:
            where = np.unique(epoch[~np.isin(expected, keys(part))])
            if not where.size:
                break
            retraced += where.size
        rays = max(1, round(share * samples))
        width = _BATCH if attempt == 0 and positions <= _BATCH else width
        found = trace(np.roll(where, max(attempt - 1, 0)), rays, width=width)
        part = found if part is None else distinct_paths(PathList.concatenate([part, found]))
    assert part is not None
    return part, retraced


def trace_batches(
    radio: RadioScene,
    source: Array,
    index: int,
    positions: Array,
    epochs: NDArray[np.int64],
    samples: int,
    *,
    depth: int,
    polarised: bool,
    bends: Bends | None = None,
    width: int = _BATCH,
) -> PathList:
    """Trace the paths of one source to some epochs, in full batches: the last is filled by repeating epochs.

    Parameters
    ----------
    radio, source, depth, samples, polarised, bends
        As for :func:`raytrace.propagation.solver.solve`.
    index : int
        ``PathList.anchor`` of the paths.
    positions : ndarray, shape (n, 3)
        Positions of the agent, metres.
    epochs : ndarray of int64, shape (m,)
        Rows of ``positions`` to trace to: ``PathList.epoch``.
    width : int
        Positions in a batch.
    """
    filled = np.resize(epochs, -(-len(epochs) // width) * width)
    parts = []
    for batch in filled.reshape(-1, width):
        traced = solve(
            radio,
            source,
            positions[batch],
            depth=depth,
            samples=samples,
            polarised=polarised,
            bends=bends,
        )
        parts.append(replace(traced, epoch=batch[traced.epoch], anchor=np.full(len(traced), index)))
    return distinct_paths(PathList.concatenate(parts))


def distinct_paths(paths: PathList) -> PathList:
    """One of each path, the shortest.

    A path around a corner names either of its walls, and a wall has two ends to go around: delay and
    direction tell which are one.
    """
    around = paths.interactions == DIFFRACTION
    walls = np.where(around, NO_SURFACE, paths.walls)
    bearing = np.where(around.any(axis=1), np.rint(paths.arrival_azimuth_rad / _SAME_BEARING_RAD), 0.0)
    names = [*paths.interactions.T, *walls.T, bearing, paths.anchor, paths.epoch]
    order = np.lexsort([paths.delay_s, *names])
    new = np.ones(len(paths), dtype=np.bool_)
    new[1:] = np.any([name[order][1:] != name[order][:-1] for name in names], axis=0)
    longer = np.diff(paths.delay_s[order]) * SPEED_OF_LIGHT_M_S > _SAME_LENGTH_M
    new[1:] |= around.any(axis=1)[order][1:] & longer
    return paths.select(order[new])
