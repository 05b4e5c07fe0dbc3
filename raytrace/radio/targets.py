"""What targets return and scatter, by the bistatic radar equation.

A point of radar cross section ``sigma`` in sight, ``d_t`` from the transmitter and ``d_r``
from the receiver, gives between isotropic antennas

    |a|^2 = lambda^2 sigma / ((4 pi)^3 d_t^2 d_r^2),

with the phase of the way there and back. So a target at ``d`` falls as ``d^-4`` in the echo, where a
wall's flash falls as ``d^-2``. Walls hide targets, and bodies shadow one another
(:mod:`raytrace.propagation.shadowing`); what a target sends on to walls or other targets is left out.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.targets import Motion, Target
from raytrace.propagation.directions import angles_of
from raytrace.propagation.obstacles import blocked
from raytrace.propagation.paths import DIFFUSE, NO_SURFACE, PathList, PathSet
from raytrace.propagation.reflectors import surfaces_of
from raytrace.propagation.shadowing import shadow_of
from raytrace.radio.cross_sections import scattering_points, sections_m2

__all__ = ["target_paths", "target_returns"]

Array = NDArray[np.float64]


def target_returns(
    plan: FloorPlan, sender_m: Array, receiver_m: Array, epoch: int = 0
) -> tuple[PathList, Array]:
    """Returns of the plan's targets that both ends of the echo see.

    Parameters
    ----------
    plan : FloorPlan
        ``plan.targets``, and the carrier of ``plan.echo``.
    sender_m, receiver_m : ndarray, shape (3,)
        Phase centres of the transmitting and the receiving beam, metres.
    epoch : int
        When.

    Returns
    -------
    paths : PathList
        One path for each point in sight, as if scattered once off no surface of the plan.
    doppler_hz : ndarray, shape (paths,)
        Their Doppler shifts, hertz.
    """
    velocity = plan.velocities_m_s()[[epoch]]
    paths, shift = _scattered(
        plan,
        plan.targets,
        sender_m[None],
        receiver_m[None],
        plan.times_s()[[epoch]],
        velocity,
        plan.echo.carrier_hz,
        moving_m_s=velocity[0],
    )
    return paths.flat(), shift[paths.valid]


def target_paths(plan: FloorPlan, epochs: NDArray[np.int64]) -> tuple[PathSet, Array]:
    """Paths from every anchor over the plan's bodies to the agent; mere points are heard in the echo alone.

    Parameters
    ----------
    plan : FloorPlan
        ``plan.targets`` that have a size, and the carrier of ``plan.radio``.
    epochs : ndarray of int64, shape (epochs,)
        Epochs of the plan's track.

    Returns
    -------
    paths : PathSet
        Axes (epochs, anchors, path), plan frame; a path's place is that of its point, not sorted.
    doppler_hz : ndarray, shape (epochs, anchors, path)
        Their Doppler shifts, hertz.
    """
    return _scattered(
        plan,
        [target for target in plan.targets if target.body_m is not None],
        plan.anchors_m(),
        plan.track()[epochs],
        plan.times_s()[epochs],
        plan.velocities_m_s()[epochs],
        plan.radio.carrier_hz,
    )


def _scattered(
    plan: FloorPlan,
    targets: list[Target] | tuple[Target, ...],
    senders_m: Array,
    receivers_m: Array,
    times_s: Array,
    velocity_m_s: Array,
    carrier_hz: float,
    moving_m_s: Array | float = 0.0,
) -> tuple[PathSet, Array]:
    """Paths from senders (k, 3), which move by ``moving_m_s``, over targets to receivers (n, 3)."""
    shape = (len(receivers_m), len(senders_m))
    surfaces, wavelength = surfaces_of(plan), SPEED_OF_LIGHT_M_S / carrier_hz
    places, sections, speeds, factors = [], [], [], []
    from_sender, from_receiver = (
        np.broadcast_to(ends, (*shape, 3)) for ends in (senders_m[None], receivers_m[:, None])
    )
    for target in targets:
        motion = target.motion(times_s)
        turn = _turns(motion.azimuth_rad)
        own = scattering_points(target)
        points = motion.place_m[:, None] + np.einsum("nij,pj->npi", turn, own)  # (n, points, 3)
        at = np.broadcast_to(points[:, None], (*shape, *points.shape[1:]))
        both = [_unit(ends[:, :, None] - at) for ends in (from_sender, from_receiver)]
        inward = [np.einsum("nij,nkpi->nkpj", turn, direction) for direction in both]
        places.append(at)
        sections.append(sections_m2(target, *inward))
        speeds.append(np.broadcast_to(motion.velocity_m_s[:, None, None], at.shape))
        factor = np.ones(at.shape[:-1])
        for body, where in _others(targets, target, times_s):
            for ends in (from_sender, from_receiver):
                factor = factor * _shadow(body, where, ends, at, wavelength)
        factors.append(factor)
    if not places:
        places, sections = [np.empty((*shape, 0, 3))], [np.empty((*shape, 0))]
        speeds, factors = [np.empty((*shape, 0, 3))], [np.empty((*shape, 0))]
    place, speed = np.concatenate(places, axis=2), np.concatenate(speeds, axis=2)
    section, factor = np.concatenate(sections, axis=2), np.concatenate(factors, axis=2)
    out, back = place - from_sender[:, :, None], place - from_receiver[:, :, None]
    hidden = np.zeros(section.shape, dtype=np.bool_)
    for ends in (from_sender, from_receiver):
        hidden |= blocked(surfaces, ends[:, :, None], place)
    there, again = np.linalg.norm(out, axis=-1), np.linalg.norm(back, axis=-1)
    delay = (there + again) / SPEED_OF_LIGHT_M_S
    gain = factor * wavelength * np.sqrt(section / (4.0 * np.pi) ** 3) / (there * again)
    amplitude = gain * np.exp(-2j * np.pi * carrier_hz * delay)
    closing = np.sum((moving_m_s - speed) * _unit(out), axis=-1)
    closing += np.sum((velocity_m_s[:, None, None] - speed) * _unit(back), axis=-1)
    departure, arrival = angles_of(out), angles_of(back)
    columns = {
        "delay_s": delay,
        "departure_azimuth_rad": departure[0],
        "departure_elevation_rad": departure[1],
        "arrival_azimuth_rad": arrival[0],
        "arrival_elevation_rad": arrival[1],
    }
    transfer = np.zeros((*section.shape, 0, 0), dtype=np.complex128)
    if plan.polarised:  # kept by the target
        transfer = np.where(hidden, 0.0, amplitude)[..., None, None] * np.eye(2, dtype=np.complex128)
    paths = PathSet(
        valid=~hidden,
        amplitude=np.where(hidden, 0.0, amplitude),
        order=np.where(hidden, 0, 1).astype(np.int16),
        walls=np.full((*section.shape, 1), NO_SURFACE, dtype=np.int16),
        interactions=np.where(hidden, 0, DIFFUSE).astype(np.int8)[..., None],
        transfer=transfer,
        **{name: np.where(hidden, np.nan, values) for name, values in columns.items()},
    )
    return paths, closing / wavelength


def _others(
    targets: list[Target] | tuple[Target, ...], target: Target, times_s: Array
) -> Iterator[tuple[Target, Motion]]:
    """Bodies other than a target, and where they are."""
    for body in targets:
        if body is not target and body.body_m is not None:
            yield body, body.motion(times_s)


def _shadow(body: Target, where: Motion, ends: Array, at: Array, wavelength_m: float) -> Array:
    """What a body leaves of legs from ends (n, k, 3) to points (n, k, p, 3), shape (n, k, p)."""
    n, k, p, _ = at.shape
    rows = np.repeat(np.arange(n), k * p)
    starts = np.broadcast_to(ends[:, :, None], at.shape)
    return shadow_of(
        body,
        where.place_m[rows],
        where.azimuth_rad[rows],
        starts.reshape(-1, 3),
        at.reshape(-1, 3),
        wavelength_m,
    ).reshape(n, k, p)


def _turns(azimuth_rad: Array) -> Array:
    """Axes of targets in the plan as columns, (n, 3, 3)."""
    c, s, zero = np.cos(azimuth_rad), np.sin(azimuth_rad), np.zeros_like(azimuth_rad)
    rows = [np.stack(row, axis=-1) for row in ((c, -s, zero), (s, c, zero), (zero, zero, zero + 1.0))]
    return np.stack(rows, axis=-2)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
