"""Patterns, polarisation and mounting of antennas: against Sionna's, element by element and end to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.bounces import bounce_points
from raytrace.propagation.directions import directions_of, spherical_basis
from raytrace.propagation.fields import specular_transfer
from raytrace.propagation.passive import trace_passive
from raytrace.propagation.paths import PathList
from raytrace.propagation.reflectors import surfaces_of
from raytrace.propagation.scene import build_scene
from raytrace.propagation.solver import solve
from raytrace.radio.antennas import Element, Pattern, Polarization, mounted
from raytrace.radio.reception import receive


@pytest.mark.parametrize("pattern", ["iso", "dipole", "hw_dipole", "tr38901"])
@pytest.mark.parametrize("polarization", ["V", "H"])
def test_fields_are_those_of_the_ray_tracer(pattern: Pattern, polarization: Polarization) -> None:
    """In 500 random directions an unturned element has the field that Sionna's has, to single precision."""
    from raytrace.propagation.backend import prepare

    prepare()
    import mitsuba as mi
    from sionna.rt.antenna_pattern import antenna_pattern_registry

    rng = np.random.default_rng(3)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 500), rng.uniform(-1.5, 1.5, 500)
    sionna = antenna_pattern_registry.get(pattern)(polarization=polarization)
    parts = sionna.patterns[0](mi.Float(0.5 * np.pi - elevation), mi.Float(azimuth))
    theirs = np.stack([part.real.numpy() for part in parts], axis=-1)
    ours = Element(pattern, polarization).field(directions_of(azimuth, elevation), mounted(0.0))
    np.testing.assert_allclose(ours, theirs, atol=2e-5)


def test_mounting_turns_the_field_with_the_antenna() -> None:
    """A field is a vector: that of a mounted element is the unmounted one's, turned; its power is kept."""
    rng = np.random.default_rng(4)
    own = directions_of(rng.uniform(-np.pi, np.pi, 100), rng.uniform(-1.5, 1.5, 100))
    mount = mounted(rng.uniform(-np.pi, np.pi, 100), rng.uniform(-1.5, 1.5, 100))
    np.testing.assert_allclose(
        np.swapaxes(mount, -1, -2) @ mount, np.broadcast_to(np.eye(3), (100, 3, 3)), atol=1e-12
    )
    assert np.all(mounted(0.0, 0.3)[:, 0] == [np.cos(0.3), 0.0, -np.sin(0.3)])  # looks down
    element = Element("tr38901", "H")

    def vectors(directions: np.ndarray, axes: np.ndarray) -> np.ndarray:
        return np.einsum("npi,np->ni", spherical_basis(directions), element.field(directions, axes))

    turned = np.einsum("nij,nj->ni", mount, own)
    expected = np.einsum("nij,nj->ni", mount, vectors(own, mounted(np.zeros(100))))
    np.testing.assert_allclose(vectors(turned, mount), expected, atol=1e-12)


@pytest.fixture(scope="module")
def polarised() -> tuple[FloorPlan, PathList]:
    """Tilted three-sector anchors and a dipole at the agent, traced along a few positions."""
    data = load_floorplan("l-room-hard").model_dump(mode="json", exclude_none=True)
    data["agent"]["epochs"], data["agent"]["heading_deg"] = 8, 20.0
    data["radio"]["anchor_array"] = {"pattern": "tr38901", "polarization": "H"}
    data["radio"]["agent_array"] = {"elements": 1, "pattern": "dipole"}
    for anchor, (azimuth, tilt) in zip(data["anchors"], [(140.0, 10.0), (-70.0, 25.0)], strict=True):
        anchor["boresight_deg"], anchor["downtilt_deg"] = azimuth, tilt
    plan = parse_floorplan(data)
    paths, _ = trace_passive(plan)
    return plan, paths.flat()


def test_traced_polarisations_are_those_of_fresnel(polarised: tuple[FloorPlan, PathList]) -> None:
    """All four gains of every path, with floor and ceiling: to 0.05 dB of the strongest of the path.

    So the tracer has them, before they are sharpened. Left out are paths that a coefficient near
    zero leaves 40 dB below free space.
    """
    plan, sharp = polarised
    assert plan.polarised
    assert sharp.transfer.shape == (len(sharp), 2, 2)
    np.testing.assert_array_equal(sharp.amplitude, sharp.transfer[:, 0, 0])
    track, anchors = plan.track(), plan.anchors_m()
    radio = build_scene(plan, plan.radio.carrier_hz)
    parts = [
        replace(part, anchor=np.full(len(part), index))
        for index, anchor in enumerate(anchors)
        for part in [solve(radio, anchor, track, depth=2, samples=plan.tracing.samples, polarised=True)]
    ]
    paths = PathList.concatenate(parts)
    for order in range(3):
        some = paths.select(paths.order == order)
        bounces = bounce_points(plan, some, track)[:, :order]
        vertices = np.concatenate(
            [anchors[some.anchor][:, None], bounces, track[some.epoch][:, None]], axis=1
        )
        walls = some.walls[:, :order].astype(np.int64)
        exact = specular_transfer(plan, vertices, walls, surfaces_of(plan).normal, plan.radio.carrier_hz)
        scale = np.abs(exact).max(axis=(1, 2))
        free = SPEED_OF_LIGHT_M_S / plan.radio.carrier_hz / (4 * np.pi * some.delay_s * SPEED_OF_LIGHT_M_S)
        heard = scale > 1e-2 * free
        assert heard.mean() > 0.9
        error = np.abs(np.abs(some.transfer) - np.abs(exact)).max(axis=(1, 2)) / scale
        assert 20 * np.log10(1 + error[heard].max()) < 0.05
        # The carrier's phase is left out: what turns all four alike.
        signs = np.real(
            some.transfer * exact.conj() * np.exp(1j * np.angle(exact[:, :1, :1] / some.transfer[:, :1, :1]))
        )
        strong = (np.abs(exact) > 0.1 * scale[:, None, None]) & heard[:, None, None]
        assert np.all(signs[strong] > 0)  # all four turn together
    assert (paths.order == 1).sum() > 50


def test_mounted_antennas_give_the_ray_tracers_channel(polarised: tuple[FloorPlan, PathList]) -> None:
    """The received channel is the sum over the paths that Sionna finds with its own mounted antennas.

    Three per cent is what single precision leaves of the carrier's phases.
    """
    import sionna.rt as rt

    plan, _ = polarised
    one = updated(plan, {"agent.epochs": 1})
    paths, _ = trace_passive(one)
    response = receive(one, paths, np.array([0]))[0, :, 0, 0, 0]
    scene = build_scene(one, one.radio.carrier_hz).scene
    ends = {"num_rows": 1, "num_cols": 1, "polarization_model": "tr38901_2"}
    scene.tx_array = rt.PlanarArray(pattern="tr38901", polarization="H", **ends)
    scene.rx_array = rt.PlanarArray(pattern="dipole", polarization="V", **ends)
    frequency = one.radio.carrier_hz + one.radio.grid().offsets_hz()
    for ours, anchor in zip(response, one.anchors, strict=True):
        for device in (*scene.transmitters, *scene.receivers):
            scene.remove(device)
        turn = [float(np.deg2rad(degrees)) for degrees in (anchor.boresight_deg, anchor.downtilt_deg, 0.0)]
        scene.add(rt.Transmitter("anchor", list(anchor.position_m), orientation=turn))
        scene.add(rt.Receiver("agent", one.track()[0].tolist(), orientation=[one.heading_rad, 0.0, 0.0]))
        traced = rt.PathSolver()(
            scene, max_depth=2, samples_per_src=60_000, refraction=False, synthetic_array=True
        )
        gain = (traced.a[0].numpy() + 1j * traced.a[1].numpy())[0, 0, 0, 0]
        delay = traced.tau.numpy()[0, 0].astype(np.float64)
        theirs = np.sum(gain[:, None] * np.exp(-2j * np.pi * frequency * delay[:, None]), axis=0)
        assert np.abs(ours - theirs).max() < 0.03 * np.abs(theirs).max()
