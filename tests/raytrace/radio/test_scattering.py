"""Diffuse power against the integral over a Lambertian wall."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.materials import permittivity, slab_reflection
from raytrace.propagation.directions import directions_of
from raytrace.propagation.passive import TraceReport
from raytrace.propagation.paths import PathSet
from raytrace.propagation.reflectors import surfaces_of
from raytrace.propagation.scene import RadioScene, build_scene
from raytrace.propagation.solver import solve
from raytrace.radio.channel import channel_response
from raytrace.radio.scattering import diffuse_response

Traced = tuple[FloorPlan, RadioScene, PathSet, TraceReport]

SCATTERING = 0.4


def one_rough_wall() -> FloorPlan:
    corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 8.0), (0.0, 8.0)]
    walls = [
        {
            "name": f"w{i}",
            "from_m": corners[i],
            "to_m": corners[(i + 1) % 4],
            "material": "concrete" if i == 0 else "glass",
        }
        for i in range(4)
    ]
    return parse_floorplan(
        {
            "format": "hapslam-floorplan",
            "version": 1,
            "name": "rough",
            "walls": walls,
            "scattering": {"concrete": SCATTERING},
            "anchors": [{"name": "pa1", "position_m": (3.0, 4.0, 2.5)}],
            "agent": {"waypoints_m": [(6.0, 3.0), (6.0, 5.0)], "smoothing_m": 0.0, "epochs": 3},
        }
    )


def lambertian_gain(plan: FloorPlan, agent: np.ndarray) -> float:
    """Power gain over the wall y = 0 by quadrature.

    An element dA returns ``S^2 |Gamma|^2 cos(in) cos(out) dA / (pi r1^2 r2^2)`` of what
    free space would give at unit distance; vertical polarisation is kept.
    """
    x, dx = np.linspace(0.0, 10.0, 2001, retstep=True)
    z, dz = np.linspace(0.0, 3.0, 601, retstep=True)
    x, z = (0.5 * (a[1:] + a[:-1]) for a in (x, z))
    points = np.stack(np.broadcast_arrays(x[:, None], 0.0, z[None]), axis=-1)
    anchor = plan.anchors_m()[0]
    first, second = points - anchor, agent - points
    r1, r2 = np.linalg.norm(first, axis=-1), np.linalg.norm(second, axis=-1)
    cosine_in, cosine_out = -first[..., 1] / r1, second[..., 1] / r2
    te, tm = slab_reflection(cosine_in, permittivity("concrete", 28e9), 0.2, 28e9)
    # The share of a vertically polarised field that lies across the plane of incidence.
    direction = first / r1[..., None]
    vertical = np.array([0.0, 0.0, 1.0]) - direction[..., 2:] * direction
    vertical /= np.linalg.norm(vertical, axis=-1, keepdims=True)
    across = np.cross(direction, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    share = np.sum(across * vertical, axis=-1) ** 2
    reflected = share * np.abs(te) ** 2 + (1 - share) * np.abs(tm) ** 2
    density = SCATTERING**2 * reflected * cosine_in * cosine_out / (np.pi * r1**2 * r2**2)
    wavelength = SPEED_OF_LIGHT_M_S / 28e9
    return float((wavelength / (4 * np.pi)) ** 2 * density.sum() * dx * dz)


def test_diffuse_power_is_lamberts() -> None:
    """The summed power of diffuse paths equals the integral, within the rays' sampling error and 0.1 dB."""
    plan = one_rough_wall()
    radio = build_scene(plan, plan.radio.carrier_hz)
    agent = plan.track()[1]
    paths = solve(radio, plan.anchors_m()[0], agent[None], depth=1, samples=40_000, los=False, diffuse=True)
    power = np.abs(paths.amplitude) ** 2
    expected = lambertian_gain(plan, agent)
    # An even lattice of rays is better than independent draws, whose standard error this is.
    error = np.std(power) * np.sqrt(len(power))
    assert (power > 0).sum() > 1000
    assert error < 0.03 * expected
    assert abs(power.sum() - expected) < 3 * error
    assert abs(10 * np.log10(power.sum() / expected)) < 0.1


def test_diffuse_echo_falls_as_the_square_of_the_distance() -> None:
    """Of a large rough wall of metal a lone antenna hears ``(lambda / 4 pi)^2 S^2 / (2 d^2)``, within 0.1 dB.

    That is Lambert's law over a half-space, the integral of ``cos^2 / (pi r^4)``: not the fourth power of
    the distance that a point target has.
    """
    corners = [(0.0, 0.0), (800.0, 0.0), (800.0, 800.0), (0.0, 800.0)]
    walls = [
        {"name": f"w{i}", "from_m": corners[i], "to_m": corners[(i + 1) % 4], "height_m": 800.0}
        for i in range(4)
    ]
    plan = parse_floorplan(
        {
            "format": "hapslam-floorplan",
            "version": 1,
            "name": "cliff",
            "walls": [{**walls[0], "material": "metal"}, *walls[1:]],
            "scattering": {"metal": SCATTERING},
            "anchors": [{"name": "pa1", "position_m": (400.0, 2.0, 400.0)}],
            "agent": {"waypoints_m": [(400.0, 2.0), (400.0, 20.0)], "smoothing_m": 0.0, "epochs": 3},
        }
    )
    radio = build_scene(plan, plan.echo.carrier_hz)
    half = np.array([0.0, 0.0, 0.5 * plan.echo.separation_m])
    wavelength = SPEED_OF_LIGHT_M_S / plan.echo.carrier_hz
    for distance in (2.0, 4.0, 8.0, 16.0):
        place = np.array([400.0, distance, 400.0])
        paths = solve(
            *(radio, place + half, (place - half)[None]), depth=1, samples=100_000, los=False, diffuse=True
        )
        power = np.sum(np.abs(paths.amplitude) ** 2)
        expected = (wavelength / (4 * np.pi)) ** 2 * SCATTERING**2 / (2 * distance**2)
        assert abs(10 * np.log10(power / expected)) < 0.1, distance


def test_response_is_the_sum_of_the_paths() -> None:
    """The batched response holds for every epoch the sum of that epoch's diffuse paths."""
    plan = updated(one_rough_wall(), {"tracing.diffuse_samples": 500})
    radio = build_scene(plan, plan.radio.carrier_hz)
    response, count = diffuse_response(plan, radio, np.arange(plan.agent.epochs))
    assert response.shape == (3, 1, 1, 1, 1, 819)
    total = 0
    for epoch, place in enumerate(plan.track()):
        paths = solve(radio, plan.anchors_m()[0], place[None], depth=1, samples=500, los=False, diffuse=True)
        alone = channel_response(PathSet.build(paths, 1, 1), plan.radio.grid())[0, 0, 0]
        np.testing.assert_allclose(response[epoch, 0, 0, 0, 0], alone, atol=1e-3 * np.abs(alone).max())
        total += len(paths)
    assert total == count


def test_places_stay_where_they_are(hard_room: Traced) -> None:
    """The scattering places are the same at every epoch: neighbouring channels are alike in power."""
    plan, radio, _, _ = hard_room
    near = updated(plan, {"agent.epochs": 40, "tracing.diffuse_samples": 500})
    response, _ = diffuse_response(near, radio, np.arange(near.agent.epochs))
    assert response.shape[0] == 40  # more than one batch, the last one filled up
    power = np.mean(np.abs(response) ** 2, axis=(2, 3, 4, 5))
    assert np.all(power > 0)
    assert np.median(np.abs(10 * np.log10(power[1:] / power[:-1]))) < 3.0


@pytest.mark.parametrize(
    ("lobes", "alpha_i", "share"),
    [({"pattern": "directive"}, 1, 1.0), ({"pattern": "backscattering"}, 7, 0.3)],
)
def test_lobes_are_those_of_the_models(lobes: dict[str, object], alpha_i: int, share: float) -> None:
    """Path by path, a lobe's power over the Lambertian one is the ratio of the two patterns.

    The same rays scatter at the same places, so that only the patterns differ. A pattern is the
    sum of lobes ``((1 + cos psi)/2)^alpha`` about the specular and the incident direction over its
    integral on the hemisphere, here by quadrature; the Lambertian one is ``cos(theta)/pi``.
    """
    plan = one_rough_wall()
    alpha_r, place = 5, plan.track()[:1]
    parameters = {"alpha_r": alpha_r, "alpha_i": alpha_i, "specular_share": share, **lobes}
    lobed = updated(plan, {"scattering_patterns": {plan.walls[0].material: parameters}})
    power = []
    for each in (plan, lobed):
        radio = build_scene(each, each.radio.carrier_hz)
        traced = solve(radio, each.anchors_m()[0], place, depth=1, samples=2000, los=False, diffuse=True)
        power.append(
            traced.select(np.argsort(traced.departure_azimuth_rad * 1e3 + traced.departure_elevation_rad))
        )
    lambert, lobe = power
    normal = surfaces_of(plan).normal[lambert.walls[:, 0]]
    towards = directions_of(lambert.departure_azimuth_rad, lambert.departure_elevation_rad)
    back = directions_of(
        lambert.arrival_azimuth_rad, lambert.arrival_elevation_rad
    )  # from the agent to the wall
    normal = np.where(np.sum(normal * towards, axis=1)[:, None] > 0, -normal, normal)
    specular = towards - 2 * np.sum(towards * normal, axis=1)[:, None] * normal
    scattered = -back

    def shape(directions: np.ndarray, mirror: np.ndarray, incident: np.ndarray) -> np.ndarray:
        forward = (0.5 + 0.5 * np.sum(directions * mirror, axis=-1)) ** alpha_r
        return (
            share * forward + (1 - share) * (0.5 + 0.5 * np.sum(directions * -incident, axis=-1)) ** alpha_i
        )

    rise, turn = np.meshgrid((np.arange(60) + 0.5) / 60, 2 * np.pi * np.arange(120) / 120, indexing="ij")
    across = np.stack(
        np.broadcast_arrays(np.sqrt(1 - rise**2) * np.cos(turn), np.sqrt(1 - rise**2) * np.sin(turn))
    )
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(normal, up)
    grid = (
        across[0][..., None] * side[:, None, None]
        + across[1][..., None] * up
        + rise[..., None] * normal[:, None, None]
    )
    integral = 2 * np.pi * shape(grid, specular[:, None, None], towards[:, None, None]).mean(axis=(1, 2))
    expected = shape(scattered, specular, towards) / integral / (np.sum(scattered * normal, axis=1) / np.pi)
    ratio = np.abs(lobe.amplitude) ** 2 / np.abs(lambert.amplitude) ** 2
    assert len(ratio) > 100
    np.testing.assert_allclose(ratio, expected, rtol=0.02)
    assert np.ptp(10 * np.log10(expected)) > 4.0
