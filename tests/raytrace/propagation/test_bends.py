"""Paths through walls and around corners: slabs, knife edges, and what datasets say of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import fresnel

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.dataset.generate import generate
from raytrace.dataset.verify import verify
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.materials import slab_reflection, slab_transmission
from raytrace.propagation import bent_tracing
from raytrace.propagation.bends import bent_once, corners_of, match_bends
from raytrace.propagation.bent_tracing import trace_bent
from raytrace.propagation.comparison import compare_bent
from raytrace.propagation.passive import RIM_M, trace_passive, trace_specular
from raytrace.propagation.paths import DIFFRACTION, REFRACTION, SPECULAR, PathList
from raytrace.propagation.scene import RadioScene, build_scene


def divided() -> FloorPlan:
    """A square room with a glass partition between the anchor and the agent, all at one height."""
    corners = [(0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (0.0, 10.0)]
    ends = zip(corners, corners[1:] + corners[:1], strict=True)
    walls = [{"name": f"w{k}", "from_m": a, "to_m": b, "material": "brick"} for k, (a, b) in enumerate(ends)]
    glass = {"name": "glass", "from_m": [8.0, 0.0], "to_m": [8.0, 10.0]}
    return parse_floorplan(
        {
            "format": "hapslam-floorplan",
            "version": 1,
            "name": "divided",
            "walls": [*walls, {**glass, "material": "glass", "thickness_m": 0.01}],
            "anchors": [{"name": "pa1", "position_m": [5.0, 5.0, 1.5]}],
            "agent": {"waypoints_m": [[12.0, 2.0], [12.0, 8.0]], "epochs": 12, "smoothing_m": 0.0},
            "tracing": {"depth": 2, "refraction": True},
        }
    )


def test_lossless_slab_keeps_the_power() -> None:
    """What is not reflected is transmitted, at any angle, where nothing is absorbed."""
    cosine = np.linspace(0.05, 1.0, 50)
    both = zip(
        slab_reflection(cosine, 4.0, 0.03, 28e9), slab_transmission(cosine, 4.0, 0.03, 28e9), strict=True
    )
    for reflected, transmitted in both:
        np.testing.assert_allclose(np.abs(reflected) ** 2 + np.abs(transmitted) ** 2, 1.0, atol=1e-12)


def test_wall_weakens_the_line_of_sight_as_a_slab_does() -> None:
    """Straight through the partition: the length of the straight line, free space times (43b) to 0.05 dB."""
    plan = divided()
    radio = build_scene(plan, plan.radio.carrier_hz)
    paths, report = trace_bent(plan, radio, plan.track())
    assert (report.expected, report.found, report.missing) == (12, 12, 0)
    straight = paths.select(paths.order == 1)
    assert len(straight) == 12
    assert np.all(straight.interactions[:, 0] == REFRACTION)
    assert {plan.surface_names[wall] for wall in straight.walls[:, 0]} == {"glass"}
    towards = plan.track()[straight.epoch] - plan.anchors_m()[0]
    length = np.linalg.norm(towards, axis=1)
    np.testing.assert_allclose(straight.delay_s * SPEED_OF_LIGHT_M_S, length, atol=1e-3)
    carrier = plan.radio.carrier_hz
    through, _ = slab_transmission(
        towards[:, 0] / length, plan.permittivity_of("glass", carrier), 0.01, carrier
    )
    exact = SPEED_OF_LIGHT_M_S / carrier / (4 * np.pi * length) * np.abs(through)
    np.testing.assert_allclose(20 * np.log10(np.abs(straight.amplitude) / exact), 0.0, atol=0.05)
    both = paths.select(paths.order == 2)
    kinds = {tuple(sorted(row)) for row in both.interactions.tolist()}
    assert (SPECULAR, REFRACTION) in kinds


def test_corner_diffracts_like_a_knife_edge() -> None:
    """Across the shadow's edge of the inner corner the field is that of a knife edge, to 1 dB.

    Every path around the corner is as long as the way by it. Near the edge of the shadow the
    material of the wedge does not matter, and the field over that of free space is
    ``(1 + j)/2 (1/2 - C(v) - j (1/2 - S(v)))``.
    """
    plan = updated(load_floorplan("l-room"), {"tracing.diffraction": True, "tracing.depth": 1})
    radio = build_scene(plan, plan.radio.carrier_hz)
    source, corner = plan.anchors_m()[1], np.array([50.0, 40.0])
    across = np.linspace(68.0, 70.15, 44)  # the edge of the shadow is at 70
    places = np.column_stack([across, np.full(44, 50.0), np.full(44, source[2])])
    bent, _ = trace_bent(plan, radio, places)
    bent = bent.select(bent.anchor == 1)
    assert np.all(bent.interactions[:, 0] == DIFFRACTION)
    np.testing.assert_array_equal(bent.epoch, np.arange(44))
    first, second = np.linalg.norm(source[:2] - corner), np.linalg.norm(places[:, :2] - corner, axis=1)
    np.testing.assert_allclose(bent.delay_s * SPEED_OF_LIGHT_M_S, first + second, atol=1e-3)

    specular, _ = trace_specular(plan, radio, plan.anchors_m(), places, 0)
    sight = np.where(specular.valid[:, 1, 0], specular.amplitude[:, 1, 0], 0.0)
    direct = np.linalg.norm(places - source, axis=1)
    wavelength = SPEED_OF_LIGHT_M_S / plan.radio.carrier_hz
    ratio = np.abs(bent.amplitude + sight) / (wavelength / (4 * np.pi * direct))
    sign = np.where(across < 70.0, 1.0, -1.0)
    v = sign * np.sqrt(4.0 / wavelength * (first + second - direct))
    sine, cosine = fresnel(v)
    knife = np.abs(0.5 * (1 + 1j) * ((0.5 - cosine) - 1j * (0.5 - sine)))
    np.testing.assert_allclose(20 * np.log10(ratio / knife), 0.0, atol=1.0)
    assert knife.min() < 0.15  # deep in the shadow
    assert specular.valid[:, 1, 0].any()


LARGE = [
    pytest.param(name, marks=pytest.mark.soak) for name in ("hall", "l-room-hard", "office", "warehouse")
]


@pytest.mark.parametrize("scene", ["corridor", "l-room", *LARGE])
def test_paths_that_bend_once_are_complete(scene: str) -> None:
    """Through walls and around corners of every shipped scene: none lost, none extra, each once."""
    plan = updated(
        load_floorplan(scene),
        {"tracing.refraction": True, "tracing.diffraction": True, "tracing.depth": 1},
    )
    positions = plan.track()[np.linspace(0, plan.agent.epochs - 1, 10).astype(int)]
    paths, report = trace_bent(plan, build_scene(plan, plan.radio.carrier_hz), positions)
    assert report.found == report.expected > 0
    found = compare_bent(plan, positions, paths)
    assert found.ok, found.named
    assert found.found == report.found == len(paths)
    assert found.delay_error_m < 1e-9
    # What was found is what is there: without a path it is missing, a millimetre longer it is wrong.
    fewer = compare_bent(plan, positions, paths.select(np.arange(1, len(paths))))
    assert (fewer.missing, fewer.extra) in ((1, 0), (0, 0))
    later = replace(paths, delay_s=paths.delay_s + 2e-3 / SPEED_OF_LIGHT_M_S)
    assert compare_bent(plan, positions, later).wrong > 0.99 * len(paths)
    elsewhere = replace(paths, delay_s=paths.delay_s + 30.0 / SPEED_OF_LIGHT_M_S)
    around = paths.interactions[:, 0] == DIFFRACTION
    assert compare_bent(plan, positions, elsewhere.select(around)).extra > 0.9 * around.sum()


def test_corners_are_where_two_alike_walls_meet() -> None:
    """One inner corner of the L, both its faces out of the wedge; other heights and materials make none."""
    plan = load_floorplan("l-room")
    corners = corners_of(plan)
    assert len(corners.place_m) == 6
    inner = int(np.flatnonzero(np.all(corners.place_m == (50.0, 40.0), axis=1))[0])
    assert sorted(map(tuple, corners.normals[inner].tolist())) == [(0.0, -1.0), (1.0, 0.0)]
    data = plan.model_dump(mode="json", exclude_none=True)
    data["walls"][0]["height_m"] = 2.9
    data["walls"][3]["material"] = "brick"
    assert len(corners_of(parse_floorplan(data)).place_m) == 2


def test_walls_of_a_corner_bend_alone_as_they_do_among_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Traced with the walls of its corner alone, made large, a path has the gain that it has in the plan."""
    plan = updated(load_floorplan("l-room"), {"tracing.diffraction": True, "tracing.depth": 1})
    positions = plan.track()[np.arange(0, 200, 16)]
    radio = build_scene(plan, plan.radio.carrier_hz)
    known = bent_once(plan, positions, RIM_M)
    paths, _ = trace_bent(plan, radio, positions)
    monkeypatch.setattr(bent_tracing, "trace_batches", _nothing_in(radio, bent_tracing.trace_batches))
    alone, report = trace_bent(plan, radio, positions)
    assert report.retraced == known.owed.sum()
    both = [match_bends(plan, positions, some, known) for some in (paths, alone)]
    rows = [dict(zip(m.known.tolist(), m.paths.tolist(), strict=True)) for m in both]
    common = sorted(set(rows[0]) & set(rows[1]))
    assert len(common) > 20
    one, other = (
        some.amplitude[[row[k] for k in common]] for some, row in zip((paths, alone), rows, strict=True)
    )
    np.testing.assert_allclose(np.abs(one / other), 1.0, rtol=2e-2)


def _nothing_in(radio: RadioScene, trace: Callable[..., PathList]) -> Callable[..., PathList]:
    """A tracer that finds nothing in one scene."""

    def found(scene: RadioScene, *arguments: object, **options: object) -> PathList:
        paths = trace(scene, *arguments, **options)
        return paths.select(np.zeros(len(paths), dtype=bool)) if scene is radio else paths

    return found


def test_without_switches_walls_are_opaque() -> None:
    """The plan's defaults bend nothing, and specular paths are the same with the switches and without."""
    plan = divided()
    opaque = updated(plan, {"tracing.refraction": False})
    assert plan.tracing.bends
    assert not opaque.tracing.bends
    one, other = trace_passive(plan)[0].flat(), trace_passive(opaque)[0].flat()
    np.testing.assert_array_equal(one.amplitude, other.amplitude)
    assert one.is_specular.all()


def test_datasets_mark_what_paths_do(tmp_path: Path) -> None:
    """Counts are in the manifest, kinds in the files; what bends more than once is not checked."""
    plan = updated(divided(), {"tracing.diffraction": True})
    with_bends = generate(plan, tmp_path / "bent", seed=1).dataset
    without = generate(
        updated(plan, {"tracing.refraction": False, "tracing.diffraction": False}),
        tmp_path / "opaque",
        seed=1,
    ).dataset
    counts, opaque = (d.manifest["statistics"]["passive"] for d in (with_bends, without))
    assert counts["refracted"] >= 12 + 12
    bent = ("refracted", "diffracted", "bent_once", "bent_once_missing")
    assert {**opaque, **{k: counts[k] for k in bent}} == counts
    assert (counts["bent_once"], counts["bent_once_missing"]) == (12, 0)
    paths = next(with_bends.shards("paths"))
    kinds = paths["interactions"].values
    assert paths["interactions"].dims == ("epoch", "anchor", "path", "bounce")
    assert int((kinds == REFRACTION).any(axis=-1).sum()) == counts["refracted"]
    assert "interactions" not in next(without.shards("paths"))
    np.testing.assert_array_equal(with_bends.truth()["reflects"], without.truth()["reflects"])
    assert f"{counts['refracted']} paths through walls" in (tmp_path / "bent" / "CARD.md").read_text()
    assert "through walls" not in (tmp_path / "opaque" / "CARD.md").read_text()
    checked = verify(with_bends)
    assert checked.ok
    assert checked.found == counts["found"] + counts["bent_once"]
    power = [np.mean(np.abs(next(d.shards("passive"))["cfr_re"].values) ** 2) for d in (with_bends, without)]
    assert power[0] > 100 * power[1]  # the agent now hears the anchor through the glass


def test_materials_of_ones_own() -> None:
    """A material given by its numbers reflects as the ITU's with the same numbers."""
    data = divided().model_dump(mode="json", exclude_none=True)
    data["anchors"][0]["position_m"] = [12.0, 1.0, 2.0]
    data["tracing"] = {"depth": 2}
    theirs = parse_floorplan(data)
    eta = theirs.permittivity_of("brick", theirs.radio.carrier_hz)
    conductivity = -eta.imag * 2 * np.pi * theirs.radio.carrier_hz * 8.8541878128e-12
    data["materials"] = {"my brick": {"relative_permittivity": eta.real, "conductivity_s_m": conductivity}}
    for wall in data["walls"][:4]:
        wall["material"] = "my brick"
    own = parse_floorplan(data)
    assert own.permittivity_of("my brick", own.radio.carrier_hz) == pytest.approx(eta)
    (one, report), (other, _) = trace_passive(own), trace_passive(theirs)
    assert report.missing == report.extra == 0
    np.testing.assert_allclose(one.amplitude, other.amplitude, rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize("polarised", [False, True])
def test_nothing_to_hear_is_no_fault(polarised: bool) -> None:
    """Behind an opaque wall there are no paths, with polarisation and without: an empty list."""
    plan = divided()
    if polarised:
        plan = updated(plan, {"radio.agent_array.polarization": "H"})
    radio = build_scene(plan, plan.radio.carrier_hz)
    paths, report = trace_specular(plan, radio, plan.anchors_m(), plan.track(), 2, polarised=plan.polarised)
    assert not paths.valid.any()
    assert report.expected == report.found == 0
