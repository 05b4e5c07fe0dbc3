"""The image method in place of the ray tracer, in this process: the same specular paths, exactly."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from raytrace.dataset.shard_task import MadeShard, ShardTask, Stages, make_shard
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.backend import LlvmChoice
from raytrace.propagation.images import image_paths
from raytrace.propagation.passive import LEG_M, RIM_M, TraceReport
from raytrace.propagation.paths import PathSet


@contextmanager
def images_for_rays() -> Iterator[None]:
    """Within this context, this process makes datasets without the ray tracer."""
    with _with(_IMAGES):
        yield


@contextmanager
def rays_again() -> Iterator[None]:
    """Within this context, inside the other, it uses the ray tracer."""
    with _with(_RAYS):
        yield


def image_shard(task: ShardTask, folder: Path, stages: Stages | None = None) -> MadeShard:
    """A shard with the image method's paths, for processes where nothing is replaced."""
    with images_for_rays():
        return make_shard(task, folder, stages)


@contextmanager
def _with(functions: dict[str, Any]) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name, function in functions.items():
            patch.setattr(name, function)
        yield


def _image_paths(
    plan: FloorPlan,
    radio: object,
    sources_m: np.ndarray,
    positions_m: np.ndarray,
    depth: int,
    *,
    polarised: bool = False,
) -> tuple[PathSet, TraceReport]:
    assert not polarised, "expected a plan whose paths have no polarisations"
    del radio
    paths = image_paths(plan, positions_m, depth, sources_m, rim_m=RIM_M, leg_m=LEG_M)
    count = int(paths.valid.sum())
    return paths, TraceReport(expected=count, found=count, missing=0, extra=0, retraced=0)


def _no_scene(plan: FloorPlan, carrier_hz: float) -> SimpleNamespace:
    return SimpleNamespace(plan=plan, carrier_hz=carrier_hz)


def _no_llvm() -> LlvmChoice:
    return LlvmChoice(Path("none"), "0", "image method")


_IMAGES = {
    "raytrace.dataset.append.prepare": _no_llvm,
    "raytrace.dataset.generate.prepare": _no_llvm,
    "raytrace.dataset.shard_task.prepare": _no_llvm,
    "raytrace.dataset.shard_task.build_scene": _no_scene,
    "raytrace.dataset.shard_task.trace_specular": _image_paths,
    "raytrace.radio.echo.build_scene": _no_scene,
    "raytrace.radio.echo.trace_specular": _image_paths,
}
_RAYS = {name: pkgutil.resolve_name(name) for name in _IMAGES}
