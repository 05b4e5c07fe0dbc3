"""The engine that finds a plan's specular paths: the ray tracer, or the image method by itself.

``tracing.engine = "sionna"`` traces, and the image method judges every position. With ``"images"``
the image method's paths are the paths, by the same formulas, many times as fast, and where neither
Mitsuba nor Sionna can be imported; what scatters, refracts or diffracts still needs the ray tracer.
Its paths are then judged the other way round, at a sample of positions, where the tracer is installed.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib import metadata
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from estimator.errors import BackendError
from raytrace.plan.files import updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.backend import prepare
from raytrace.propagation.comparison import compare
from raytrace.propagation.images import image_paths
from raytrace.propagation.passive import LEG_M, TraceReport, trace_specular
from raytrace.propagation.paths import PathSet
from raytrace.propagation.scene import RadioScene, build_scene

__all__ = [
    "ImageScene",
    "Scene",
    "Verdict",
    "engine_versions",
    "judge",
    "scene_of",
    "specular_paths",
    "traced",
]

_TRACER = ("sionna-rt", "mitsuba", "drjit")
JUDGED = 16
"""Positions of a dataset at which the ray tracer judges the image method: some seconds in all."""


@dataclass(frozen=True)
class ImageScene:
    """A plan at one carrier, hertz, for the image method."""

    plan: FloorPlan
    carrier_hz: float


Scene = RadioScene | ImageScene


@dataclass(frozen=True)
class Verdict:
    """What the ray tracer found where the image method was judged.

    Parameters
    ----------
    positions : int
        Positions traced.
    paths : int
        Paths of the image method there that the tracer has, too.
    unconfirmed, unknown : int
        Paths that the tracer has not, and paths of the tracer that the image method has not.
    """

    positions: int
    paths: int
    unconfirmed: int
    unknown: int

    def as_dict(self) -> dict[str, int]:
        """The counts by name."""
        return asdict(self)


def scene_of(plan: FloorPlan, carrier_hz: float) -> Scene:
    """The scene of a plan at one carrier for its engine.

    Raises
    ------
    BackendError
        If the engine is the ray tracer and it cannot run on this machine.
    """
    if plan.tracing.engine == "images":
        return ImageScene(plan, carrier_hz)
    return build_scene(plan, carrier_hz)


def traced(scene: Scene) -> RadioScene:
    """The scene of a plan that has to be traced; raises BackendError if its engine is another."""
    if isinstance(scene, ImageScene):
        raise BackendError('tracing.engine: expected "sionna" for what is no specular path, got "images"')
    return scene


def specular_paths(
    plan: FloorPlan,
    scene: Scene,
    sources_m: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    depth: int,
    *,
    polarised: bool = False,
) -> tuple[PathSet, TraceReport]:
    """Specular paths from sources (k, 3) to positions (n, 3), metres, and how they were checked.

    Returns
    -------
    paths : PathSet
        Axes (n, k, path): absolute delays, plan frame.
    report : TraceReport
        What the tracer lost of the image method's paths; nothing, if these are the paths.
    """
    if not isinstance(scene, ImageScene):
        return trace_specular(plan, scene, sources_m, positions_m, depth, polarised=polarised)
    paths = image_paths(
        plan,
        positions_m,
        depth,
        sources_m,
        leg_m=LEG_M,
        carrier_hz=scene.carrier_hz,
        polarised=polarised,
    )
    count = int(paths.valid.sum())
    return paths, TraceReport(expected=count, found=count, missing=0, extra=0, retraced=0)


def judge(plan: FloorPlan) -> Verdict | None:
    """The image method's paths against the ray tracer's at positions spread over the track.

    None where the ray tracer is not installed or cannot run.
    """
    if find_spec("sionna") is None:
        return None
    epochs = np.unique(np.linspace(0, plan.agent.epochs - 1, JUDGED).astype(np.int64))
    positions = plan.track()[epochs]
    try:
        scene = build_scene(updated(plan, {"tracing.engine": "sionna"}), plan.radio.carrier_hz)
    except BackendError:
        return None
    paths, _ = trace_specular(plan, scene, plan.anchors_m(), positions, plan.tracing.depth)
    found = compare(plan, positions, paths.flat())
    return Verdict(len(epochs), found.found, found.missing, found.extra + found.wrong)


def engine_versions(plan: FloorPlan) -> dict[str, str]:
    """Versions of what makes the paths of a plan.

    Raises
    ------
    BackendError
        If the engine is the ray tracer and it cannot run on this machine.
    """
    versions = {"numpy": metadata.version("numpy")}
    if plan.tracing.engine == "images":
        return versions
    llvm = prepare().version
    return {**{name: metadata.version(name) for name in _TRACER}, **versions, "llvm": llvm}
