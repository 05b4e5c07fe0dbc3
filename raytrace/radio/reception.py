"""What is received of traced paths: arrays and antennas at both ends, headings, motion between snapshots.

Arrays are small against all distances: a path is one plane wave to all elements.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.directions import angles_of, directions_of
from raytrace.propagation.paths import PathSet
from raytrace.radio.antennas import Element, mounted
from raytrace.radio.channel import channel_response

__all__ = ["doppler_hz", "receive"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def receive(
    plan: FloorPlan, paths: PathSet, epochs: NDArray[np.int64], shift_hz: Array | None = None
) -> Complex:
    """Noiseless channels of all paths at some epochs.

    Parameters
    ----------
    plan : FloorPlan
        Gives arrays, headings, velocity, snapshots and tones.
    paths : PathSet
        Axes (epochs, anchors, path), plan frame.
    epochs : ndarray of int64, shape (epochs,)
        Epochs of the plan that the first axis of ``paths`` stands for.
    shift_hz : ndarray, shape (epochs, anchors, path), optional
        Doppler shifts, hertz; by default those of paths off what stands (:func:`doppler_hz`).

    Returns
    -------
    ndarray of complex128, shape (epochs, anchors, snapshots, anchor antennas, antennas, tones)
        Channel gains (dimensionless).
    """
    shift_hz = doppler_hz(plan, paths, epochs) if shift_hz is None else shift_hz
    turning = _snapshots(plan, shift_hz)  # (..., snapshot, path)
    sent = _anchor_array(plan, paths)  # (..., anchor antenna, path)
    heard = _agent_array(plan, paths, epochs)  # (..., antenna, path)
    signals = turning[..., :, None, None, :] * sent[..., None, :, None, :] * heard[..., None, None, :, :]
    axes = signals.shape[2:-1]
    if plan.polarised:
        paths = replace(paths, amplitude=_polarised_gain(plan, paths, epochs))
    response = channel_response(
        paths, plan.radio.grid(), signals.reshape(*paths.valid.shape[:2], -1, signals.shape[-1])
    )
    return response.reshape(*response.shape[:2], *axes, response.shape[-1])


def doppler_hz(plan: FloorPlan, paths: PathSet, epochs: NDArray[np.int64]) -> Array:
    """Doppler shift of every path, ``v . k / lambda`` with ``k`` towards where it comes from.

    Positive where the agent approaches what it hears. Anchors and walls stand still.

    Parameters
    ----------
    plan, paths, epochs
        As for :func:`receive`.

    Returns
    -------
    ndarray, shape (epochs, anchors, path)
        Hertz; NaN where there is no path.
    """
    towards = directions_of(paths.arrival_azimuth_rad, paths.arrival_elevation_rad)
    speed = np.einsum("eapd,ed->eap", towards, plan.velocities_m_s()[epochs])
    return np.asarray(speed * plan.radio.carrier_hz / SPEED_OF_LIGHT_M_S)


def _snapshots(plan: FloorPlan, shift_hz: Array) -> Complex:
    """Turn of every path by each snapshot, (epochs, anchors, snapshots, path); the first has none."""
    after_s = np.arange(plan.radio.snapshots) * plan.radio.snapshot_interval_s
    turns = np.where(np.isfinite(shift_hz), shift_hz, 0.0)[..., None, :] * after_s[:, None]
    return np.asarray(np.exp(2j * np.pi * turns))


def _anchor_array(plan: FloorPlan, paths: PathSet) -> Complex:
    """Response of the anchors' antennas to every path, (epochs, anchors, antennas, path)."""
    own = np.einsum("aji,eapj->eapi", _anchor_mounts(plan), _departures(paths))
    return np.swapaxes(plan.radio.anchor_array.facing(0.0).steering(*angles_of(own)), -1, -2)


def _agent_array(plan: FloorPlan, paths: PathSet, epochs: NDArray[np.int64]) -> Complex:
    """Response of the agent's antennas to every path, (epochs, anchors, antennas, path)."""
    heading = plan.headings_rad()[epochs][:, None, None]
    azimuth = np.where(paths.valid, paths.arrival_azimuth_rad - heading, 0.0)
    elevation = np.where(paths.valid, paths.arrival_elevation_rad, 0.0)
    return np.swapaxes(plan.radio.agent_array.array().steering(azimuth, elevation), -1, -2)


def _polarised_gain(plan: FloorPlan, paths: PathSet, epochs: NDArray[np.int64]) -> Complex:
    """Gain of every path between the elements of both ends, (epochs, anchors, path)."""
    sender, receiver = (
        Element(array.pattern, array.polarization)
        for array in (plan.radio.anchor_array, plan.radio.agent_array)
    )
    azimuth = plan.headings_rad()[epochs] + plan.radio.agent_array.boresight_rad
    arrivals = directions_of(
        np.where(paths.valid, paths.arrival_azimuth_rad, 0.0),
        np.where(paths.valid, paths.arrival_elevation_rad, 0.0),
    )
    sent = sender.field(_departures(paths), _anchor_mounts(plan)[:, None])
    heard = receiver.field(arrivals, mounted(azimuth)[:, None, None])
    return np.asarray(np.einsum("eapr,eaprs,eaps->eap", heard, paths.transfer, sent))


def _anchor_mounts(plan: FloorPlan) -> Array:
    """Axes of the anchors' arrays in the plan, (anchors, 3, 3)."""
    turns = np.deg2rad([(anchor.boresight_deg, anchor.downtilt_deg) for anchor in plan.anchors])
    return mounted(turns[:, 0], turns[:, 1])


def _departures(paths: PathSet) -> Array:
    """Directions in which paths leave the anchors, (epochs, anchors, path, 3); x where there is no path."""
    return directions_of(
        np.where(paths.valid, paths.departure_azimuth_rad, 0.0),
        np.where(paths.valid, paths.departure_elevation_rad, 0.0),
    )
