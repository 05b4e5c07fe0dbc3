"""The image method in place of the ray tracer, in this process: the same specular paths, exactly."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from raytrace.dataset.shard_task import MadeShard, ShardTask, Stages, make_shard
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.engine import ImageScene, engine_versions, scene_of


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


def _image_scene(plan: FloorPlan, carrier_hz: float) -> ImageScene:
    return ImageScene(plan, carrier_hz)


def _no_versions(plan: FloorPlan) -> dict[str, str]:
    return dict.fromkeys(("sionna-rt", "mitsuba", "drjit", "numpy", "llvm"), "image method")


_SCENES = ("raytrace.dataset.shard_task.scene_of", "raytrace.radio.echo.scene_of")
_VERSIONS = "raytrace.dataset.manifest.engine_versions"
_IMAGES = {**dict.fromkeys(_SCENES, _image_scene), _VERSIONS: _no_versions}
_RAYS = {**dict.fromkeys(_SCENES, scene_of), _VERSIONS: engine_versions}
