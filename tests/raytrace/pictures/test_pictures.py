"""Pictures: what they show is checked as numbers, and that they are drawn at all."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.collections import LineCollection, QuadMesh

from estimator.dataset import Dataset, open_dataset
from estimator.errors import InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, free_space_loss_db
from raytrace.dataset.generate import generate
from raytrace.pictures.datasets import delay_profile, draw_delay_profile, draw_range_angle, range_angle
from raytrace.pictures.plans import draw_coverage, draw_paths, draw_plan, path_vertices, received_power
from raytrace.plan.files import load_floorplan, updated
from raytrace.propagation.images import image_paths
from raytrace.propagation.reflectors import surfaces_of


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Twelve epochs in the L-room, with two sweeps."""
    plan = updated(
        load_floorplan("l-room"),
        {"agent.epochs": 12, "echo.sweep_epochs": [0, 11], "tracing.engine": "images"},
    )
    out = tmp_path_factory.mktemp("pictures") / "room"
    generate(plan, out, 1)
    return open_dataset(out)


def test_vertices_are_the_paths() -> None:
    """Legs add up to the delays, bounces lie on their walls, and angles are mirrored there."""
    plan = updated(load_floorplan("l-room-hard"), {"tracing.depth": 2})
    track = plan.track()[::50]
    paths = image_paths(plan, track).flat()
    vertices = path_vertices(plan, paths, track)
    length = np.nansum(np.linalg.norm(np.diff(vertices, axis=1), axis=-1), axis=1)
    np.testing.assert_allclose(length, paths.delay_s * SPEED_OF_LIGHT_M_S, rtol=1e-12)
    surfaces = surfaces_of(plan)
    for bounce in range(2):
        mine = paths.order > bounce
        wall = paths.walls[mine, bounce]
        before, at, after = (vertices[mine, bounce + step] for step in range(3))
        normal = surfaces.normal[wall]
        np.testing.assert_allclose(np.sum((at - surfaces.origin[wall]) * normal, axis=1), 0.0, atol=1e-9)
        unit = [leg / np.linalg.norm(leg, axis=1, keepdims=True) for leg in (at - before, after - at)]
        mirrored = unit[0] - 2 * np.sum(unit[0] * normal, axis=1, keepdims=True) * normal
        np.testing.assert_allclose(unit[1], mirrored, atol=1e-9)


def test_coverage_is_the_power_of_the_paths() -> None:
    """Line of sight alone gives EIRP less free-space loss; behind the corner and outside there is nothing."""
    plan = load_floorplan("l-room")
    x, y, power = received_power(plan, depth=0)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    anchor = plan.anchors_m()[1]
    distance = np.sqrt(np.sum((places - anchor[:2]) ** 2, axis=-1) + (anchor[2] - plan.agent.height_m) ** 2)
    expected = plan.radio.eirp_dbm - free_space_loss_db(distance, plan.radio.carrier_hz)
    seen = np.isfinite(power[..., 1])
    np.testing.assert_allclose(power[..., 1][seen], expected[seen], atol=1e-6)
    outside = (places[..., 0] < 50) & (places[..., 1] > 40)
    assert np.isnan(power[outside]).all()
    assert not np.isnan(power[~outside]).any()
    column, row = np.argmin(np.abs(x - 60)), np.argmin(np.abs(y - 55))
    assert power[column, row, 1] == -np.inf  # the corner at (50, 40) hides pa2
    assert np.all(received_power(plan, depth=1)[2][seen] >= power[seen] - 1e-9)


def test_delay_profile_peaks_at_the_path() -> None:
    """One path on a bin has its gain there, and a Hann window's leakage far from it."""
    tones, spacing = 400, 480e3
    length_m = 30 * SPEED_OF_LIGHT_M_S / (2 * tones * spacing)
    offsets = (np.arange(tones) - tones / 2) * spacing
    response = 1e-3 * np.exp(-2j * np.pi * offsets * length_m / SPEED_OF_LIGHT_M_S)
    length, power = delay_profile(response, spacing)
    assert length[np.argmax(power)] == pytest.approx(length_m)
    assert power.max() == pytest.approx(-60.0, abs=1e-6)
    assert power[200:700].max() < -130.0


def test_range_angle_finds_the_nearest_wall(room: Dataset) -> None:
    """The strongest echo at the start, 10 m from the west wall, comes from there: 10 m at 180 degrees."""
    azimuth, ranges, power = range_angle(room, 0)
    assert np.all(np.diff(azimuth) > 0)
    beam, bin_ = np.unravel_index(np.argmax(power), power.shape)
    assert np.abs(np.angle(np.exp(1j * (azimuth[beam] - np.pi)))) < 2 * np.pi / 64
    assert ranges[bin_] == pytest.approx(10.0, abs=0.4)  # half a bin, and 3 cm of the front end
    with pytest.raises(InputError, match="sweep: expected 0 to 1, got 2"):
        range_angle(room, 2)


def test_pictures_are_drawn(room: Dataset) -> None:
    """Each has its parts and can be written; nothing opens a window."""
    plan = load_floorplan("office")
    figures = {
        "plan": draw_plan(plan),
        "paths": draw_paths(plan, 20, depth=1),
        "coverage": draw_coverage(plan, depth=0),
        "profile": draw_delay_profile(room),
        "sweep": draw_range_angle(room, 1),
    }
    for figure in figures.values():
        for form, head in (("png", b"\x89PNG"), ("svg", b"<?xml")):
            stream = io.BytesIO()
            figure.savefig(stream, format=form, dpi=40)
            assert stream.getvalue().lstrip().startswith(head)
    walls = [c for c in figures["plan"].axes[0].collections if isinstance(c, LineCollection)]
    assert sum(len(c.get_segments()) for c in walls) == len(plan.walls)
    paths = image_paths(plan, plan.track()[20:21], 1).flat()
    drawn = [c for c in figures["paths"].axes[0].collections if isinstance(c, LineCollection)]
    assert len(paths) in {len(c.get_segments()) for c in drawn}
    panels = [a for a in figures["profile"].axes if any(isinstance(c, QuadMesh) for c in a.collections)]
    assert len(panels) >= len(room.manifest["anchors"])


def test_what_is_not_there_cannot_be_drawn() -> None:
    """Epochs and anchors beyond the plan are refused."""
    plan = load_floorplan("l-room")
    with pytest.raises(InputError, match="epoch: expected 0 to 235, got 236"):
        draw_paths(plan, 236)
    with pytest.raises(InputError, match="anchor: expected 0 to 1, got 2"):
        draw_coverage(plan, 0, anchor=2)
