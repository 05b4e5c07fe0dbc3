"""The image method as the engine: the tracer's paths, without the tracer."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from estimator.errors import BackendError
from raytrace.plan.files import FloorPlanError, load_floorplan, updated
from raytrace.plan.random_plans import KINDS, random_plan
from raytrace.propagation.comparison import compare
from raytrace.propagation.engine import judge, scene_of, specular_paths, traced
from raytrace.propagation.passive import trace_specular
from raytrace.propagation.paths import PathList
from raytrace.propagation.reflectors import first_hits, surfaces_of
from raytrace.propagation.scene import build_scene
from raytrace.radio.radar_equation import horizontal_hits

ROOT = Path(__file__).resolve().parents[3]
# As where the packages are not installed: neither found nor imported.
BLOCKED = "import sys\nsys.modules.update(dict.fromkeys(('mitsuba', 'drjit', 'sionna')))\n"


def common(one: PathList, other: PathList, surfaces: int, anchors: int) -> tuple[PathList, PathList]:
    """Paths that both lists have, in one order."""
    mine, others = one.keys(anchors, surfaces), other.keys(anchors, surfaces)
    _, a, b = np.intersect1d(mine, others, return_indices=True)
    return one.select(a), other.select(b)


@pytest.mark.parametrize("polarised", [False, True])
@pytest.mark.parametrize("depth", [1, 3])
def test_paths_are_those_of_the_tracer(depth: int, polarised: bool) -> None:
    """Delays to 1e-12 s, directions to 1e-9 rad and gains to 1e-6 dB, at three depths, and none lost."""
    plan = updated(load_floorplan("office"), {"tracing.depth": depth})
    places, ends = plan.track()[::5], plan.anchors_m()
    scene = build_scene(plan, plan.radio.carrier_hz)
    theirs, report = trace_specular(plan, scene, ends, places, depth, polarised=polarised)
    alone = updated(plan, {"tracing.engine": "images"})
    ours, _ = specular_paths(
        alone, scene_of(alone, plan.radio.carrier_hz), ends, places, depth, polarised=polarised
    )
    assert report.missing == report.extra == 0
    verdict = compare(plan, places, ours.flat())
    assert verdict.missing == verdict.extra == verdict.wrong == 0
    mine, others = common(ours.flat(), theirs.flat(), len(plan.surface_names), len(ends))
    assert len(mine) >= 0.99 * len(theirs.flat()) > 100
    for field in fields(PathList):
        a, b = getattr(mine, field.name), getattr(others, field.name)
        if "_s" in field.name[-2:]:
            np.testing.assert_allclose(a, b, atol=1e-12)
        elif field.name.endswith("_rad"):
            np.testing.assert_allclose(np.exp(1j * a), np.exp(1j * b), atol=1e-9)
        elif field.name in ("amplitude", "transfer"):
            scale = np.abs(others.amplitude).reshape(-1, *(1,) * (a.ndim - 1))
            np.testing.assert_allclose(a / scale, b / scale, atol=1e-6)


@pytest.mark.parametrize("model", ["physical", "radar-equation"])
def test_a_dataset_needs_no_ray_tracer(tmp_path: Path, model: str) -> None:
    """With Mitsuba, Dr.Jit and Sionna blocked, a room is made, verified and sensed, echo included."""
    code = BLOCKED + (
        "from pathlib import Path\n"
        "from estimator.extract import extract\n"
        "from raytrace.dataset.generate import generate\n"
        "from raytrace.dataset.verify import verify\n"
        "from raytrace.plan.files import load_floorplan, updated\n"
        "plan = updated(load_floorplan('l-room'), {'tracing.engine': 'images', 'agent.epochs': 3, "
        f"'echo.model': {model!r}}})\n"
        "made = generate(plan, Path(sys.argv[1]), seed=1)\n"
        "assert verify(made.dataset).ok\n"
        "measured = extract(made.dataset)\n"
        "print(len(measured.walls), sum(len(p) for e in measured.epochs for p in e.paths))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "room")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    walls, paths = map(int, done.stdout.split())
    assert walls == 4
    assert paths > 20
    manifest = json.loads((tmp_path / "room" / "manifest.json").read_text())
    assert set(manifest["versions"]) == {"numpy"}
    assert manifest["statistics"]["judged_by_ray_tracer"] is None


def test_the_tracer_judges_a_sample() -> None:
    """Where it is installed, it confirms the image method at positions along the walk, and knows no more."""
    plan = updated(load_floorplan("corridor"), {"tracing.engine": "images"})
    verdict = judge(plan)
    assert verdict is not None
    assert verdict.positions == 16
    assert verdict.paths > 300
    assert verdict.unconfirmed == verdict.unknown == 0


def test_rays_meet_what_the_tracer_says() -> None:
    """Distances and angles of incidence of horizontal rays are the ray tracer's."""
    plan = load_floorplan("office")
    azimuth = np.linspace(0.013, 2.0 * np.pi, 300)
    place = plan.track()[5]
    distance, cosine = horizontal_hits(build_scene(plan, plan.echo.carrier_hz), place, azimuth)
    towards = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
    ours, own = first_hits(surfaces_of(plan), place, towards)
    np.testing.assert_allclose(ours, distance, atol=1e-4)
    np.testing.assert_allclose(own, cosine, atol=1e-5)


def test_what_needs_the_tracer_is_refused() -> None:
    """Refraction, diffraction and scattering with the image method are named, not left out in silence."""
    for change in ({"refraction": True}, {"diffraction": True}):
        with pytest.raises(FloorPlanError, match='expected engine = "sionna" with refraction or diffraction'):
            updated(
                load_floorplan("l-room"),
                {f"tracing.{k}": v for k, v in change.items()} | {"tracing.engine": "images"},
            )
    with pytest.raises(FloorPlanError, match='tracing.engine: expected "sionna" where materials scatter'):
        updated(load_floorplan("l-room"), {"scattering": {"concrete": 0.3}, "tracing.engine": "images"})
    plan = updated(load_floorplan("l-room"), {"tracing.engine": "images"})
    with pytest.raises(BackendError, match="for what is no specular path"):
        traced(scene_of(plan, 28e9))


@pytest.mark.soak
@pytest.mark.parametrize("kind", KINDS)
def test_random_plans_have_the_paths_of_the_tracer(kind: str) -> None:
    """Twenty plans of a kind, depths 1 to 3 in turn: nothing of either engine is missing in the other."""
    for seed in range(20):
        plan = random_plan(kind, np.random.default_rng([7, seed]), most_epochs=60)
        plan = updated(plan, {"tracing.depth": 1 + seed % 3, "tracing.engine": "images"})
        verdict = judge(plan)
        assert verdict is not None
        assert (verdict.unconfirmed, verdict.unknown) == (0, 0), seed
