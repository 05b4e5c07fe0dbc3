"""Bodies in the way of paths: knife edges, both engines alike, and verified files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.special import fresnel

from estimator.dataset import open_dataset
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.dataset.generate import generate
from raytrace.dataset.verify import verify
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan, Target
from raytrace.propagation.images import image_paths
from raytrace.propagation.shadowing import shadow_of, shadowed

WAVELENGTH_M = SPEED_OF_LIGHT_M_S / 28e9


def screen(width_m: float = 0.5, height_m: float = 1.75) -> Target:
    return Target.model_validate(
        {
            "name": "t",
            "rcs_m2": 1.0,
            "waypoints_m": [[0.0, 0.0]],
            "size_m": [0.01, width_m, height_m],
        }
    )


def seen(body: Target, aside_m: np.ndarray, height_m: float = 1.0, ends_m: float = 5.0) -> np.ndarray:
    """Factor of legs along x that pass so far beside the body."""
    count = len(aside_m)
    motion = body.motion(np.zeros(count))
    start, end = (
        np.column_stack([np.full(count, x), aside_m, np.full(count, height_m)]) for x in (-ends_m, ends_m)
    )
    return shadow_of(body, motion.place_m, motion.azimuth_rad, start, end, WAVELENGTH_M)


def test_an_edge_takes_half_the_field_and_a_body_far_aside_nothing() -> None:
    """6 dB where the leg grazes an edge of a large screen; free space far aside, and behind its end."""
    wide = screen(200.0, 200.0)
    assert 20 * np.log10(seen(wide, np.array([100.0]), 100.0)[0]) == pytest.approx(-6.02, abs=0.1)
    assert 20 * np.log10(seen(wide, np.array([102.0]), 100.0)[0]) == pytest.approx(0.0, abs=0.3)
    before = screen().motion(np.zeros(1))
    start, end = np.array([[-5.0, 0.0, 1.0]]), np.array([[-1.0, 0.0, 1.0]])
    assert shadow_of(screen(), before.place_m, before.azimuth_rad, start, end, WAVELENGTH_M)[0] == 1.0


def test_knife_edges_follow_fresnel() -> None:
    """Behind the edge of a wide screen the field is that of Fresnel's half-plane within 1.5 dB."""
    wide = screen(200.0, 200.0)
    depth = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
    ours = seen(wide, 100.0 - depth, 100.0)
    parameter = depth * np.sqrt(2.0 / WAVELENGTH_M * (1 / 5.0 + 1 / 5.0))
    sine, cosine = fresnel(parameter)
    theirs = np.abs((0.5 - cosine) + 1j * (0.5 - sine)) / np.sqrt(2.0)
    np.testing.assert_allclose(20 * np.log10(ours), 20 * np.log10(theirs), atol=1.5)


def crowded(**changes: object) -> FloorPlan:
    """The L-room with a person on the way of the first positions' line of sight, and one who walks."""
    plan = updated(load_floorplan("l-room"), {"agent.epochs": 6})
    track, anchor = plan.track(), plan.anchors_m()[0]
    between = 0.05 * anchor[:2] + 0.95 * track[2, :2]
    data = plan.model_dump(mode="json", exclude_none=True)
    data["targets"] = [
        {"name": "still", "kind": "human", "waypoints_m": [between.tolist()]},
        {"name": "walker", "kind": "human", "waypoints_m": [[20.0, 20.0], [26.0, 20.0]], "speed_m_s": 1.3},
    ]
    return updated(parse_floorplan(data), {"tracing.depth": 1, **changes})


def test_a_person_shadows_the_line_of_sight() -> None:
    """Of paths at the person's height that cross it most is gone; those that pass elsewhere are as before."""
    plan = crowded(**{"agent.height_m": 1.4})
    low = updated(
        plan,
        {
            "anchors": [
                {**a.model_dump(mode="json"), "position_m": [*a.position_m[:2], 1.2]} for a in plan.anchors
            ]
        },
    )
    free = image_paths(low).flat()
    weaker = shadowed(low, free, low.track(), low.times_s())
    loss = 20 * np.log10(np.abs(weaker.amplitude) / np.abs(free.amplitude))
    direct = (free.anchor == 0) & (free.order == 0)
    assert loss[direct].min() < -10.0
    assert np.median(loss) == pytest.approx(0.0, abs=0.1)
    np.testing.assert_array_equal(weaker.delay_s, free.delay_s)


def test_both_engines_have_the_same_shadows_and_files_verify(tmp_path: Path) -> None:
    """Datasets of either engine hold the same shadowed gains to 1e-6 dB, and are verified with the bodies."""
    pytest.importorskip("sionna.rt", reason="the ray tracer is not installed")
    made = {}
    for engine in ("sionna", "images"):
        plan = crowded(**{"tracing.engine": engine})
        generate(plan, tmp_path / engine, seed=3)
        dataset = open_dataset(tmp_path / engine)
        found = verify(dataset)
        assert found.ok, found
        assert found.amplitude_error_db < 1e-6
        shard = next(iter(dataset.shards("paths")))
        made[engine] = shard["amplitude_re"].values + 1j * shard["amplitude_im"].values
    one, other = made.values()
    heard = np.abs(other) > 0.0
    np.testing.assert_allclose(20 * np.log10(np.abs(one[heard]) / np.abs(other[heard])), 0.0, atol=1e-6)
