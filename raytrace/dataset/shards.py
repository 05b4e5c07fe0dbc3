"""The shards of a dataset as xarray datasets, and back: dimensions, units and frames.

Complex numbers are pairs ``_re``, ``_im``; every variable has CF ``units``. Channels,
beams and the arrival angles of the paths are in the agent's frame at the start;
departure angles, walls, anchors and the track are in the plan frame.
"""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import tomli_w
import xarray as xr
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from estimator.geometry import vrp_of_line
from estimator.waveform import impulse_response
from raytrace.plan.files import parse_floorplan
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.paths import DIFFRACTION, NO_INTERACTION, NO_SURFACE, REFRACTION, SPECULAR, PathSet
from raytrace.radio.reception import doppler_hz

__all__ = ["echo_shard", "passive_shard", "paths_shard", "stored_paths", "stored_plan", "truth_shard"]

_PATH_COLUMNS = (
    "delay_s",
    "departure_azimuth_rad",
    "departure_elevation_rad",
    "arrival_azimuth_rad",
    "arrival_elevation_rad",
    "order",
    "walls",
)
_PLAN_FRAME = "the plan's: z up, azimuth counter-clockwise from x"
_AGENT_FRAME = "the agent's at the start: the plan's, turned back by the agent's heading"
_ARRAY_FRAME = "the agent's at the sweep: that at the start, turned by sweep_heading_rad"


def passive_shard(
    plan: FloorPlan, cfr: NDArray[np.complex128], epochs: NDArray[np.int64], content: str = "cfr"
) -> xr.Dataset:
    """Noisy channels of some epochs, shape (epochs, anchors, snapshots, anchor antennas, antennas, tones).

    The axis of snapshots is written if the plan asks for more than one, that of the anchors'
    antennas if they have several. ``content`` is ``cfr``, ``cir`` (the same as impulse
    responses) or ``both``.
    """
    grid = plan.radio.grid()
    asked = {
        "epoch": True,
        "anchor": True,
        "snapshot": plan.radio.snapshots > 1,
        "anchor_antenna": plan.radio.anchor_array.antennas > 1,
        "antenna": True,
    }
    links = tuple(axis for axis, wanted in asked.items() if wanted)
    cfr = cfr.squeeze(tuple(place for place, wanted in enumerate(asked.values()) if not wanted))
    times = plan.times_s()[epochs]
    shard = xr.Dataset(
        {"time_s": ("epoch", times, {"units": "s", "long_name": "time since the first epoch"})},
        coords={**_epochs(epochs), **_anchors(plan)},
    )
    if plan.radio.snapshots > 1:
        after_s = np.arange(plan.radio.snapshots) * plan.radio.snapshot_interval_s
        facts = {"units": "s", "long_name": "time of the snapshot since that of the epoch"}
        shard = shard.assign_coords(snapshot_time_s=("snapshot", after_s, facts))
    if content in ("cfr", "both"):
        pair = _complex_pair("cfr", (*links, "tone"), cfr, np.float32, "channel gain with noise")
        shard = shard.assign(pair).assign_coords(_tones(grid.offsets_hz()))
    if content in ("cir", "both"):
        cir = impulse_response(cfr, grid)
        pair = _complex_pair("cir", (*links, "tap"), cir, np.float32, "channel tap with noise")
        delay = {"units": "s", "long_name": "delay of the tap"}
        shard = shard.assign(pair).assign_coords(tap_delay_s=("tap", grid.taps_s(), delay))
    return shard


def echo_shard(plan: FloorPlan, response: NDArray[np.complex128], sweeps: tuple[int, ...]) -> xr.Dataset:
    """Noisy beam sweeps, shape (sweeps, beams, tones), at some epochs."""
    azimuth = plan.echo.beams.beam_set().azimuths()
    epochs = np.array(sweeps, dtype=np.int64)
    turned = np.angle(np.exp(1j * (plan.headings_rad()[epochs] - plan.heading_rad)))
    gyroscope = {"units": "rad", "long_name": "heading at the sweep since the start, as a gyroscope tells it"}
    return xr.Dataset(
        {
            **_complex_pair("echo", ("sweep", "beam", "tone"), response, np.float32, "two-way beam response"),
            "sweep_epoch": ("sweep", epochs, {"units": "1", "long_name": "epoch of the sweep"}),
            "sweep_heading_rad": ("sweep", turned, gyroscope),
            "beam_azimuth_rad": ("beam", azimuth, {"units": "rad", "frame": _ARRAY_FRAME}),
        },
        coords=_tones(plan.echo.grid().offsets_hz()),
    )


def paths_shard(plan: FloorPlan, paths: PathSet, epochs: NDArray[np.int64]) -> xr.Dataset:
    """The specular paths of some epochs without noise, axes (epoch, anchor, path)."""
    dims = ("epoch", "anchor", "path")
    arrival = np.angle(np.exp(1j * (paths.arrival_azimuth_rad - plan.heading_rad)))
    doppler = doppler_hz(plan, paths, epochs)
    real = {
        "delay_s": (paths.delay_s, {"units": "s", "long_name": "absolute time of flight"}),
        "arrival_azimuth_rad": (arrival, {"units": "rad", "frame": _AGENT_FRAME}),
        "arrival_elevation_rad": (paths.arrival_elevation_rad, {"units": "rad"}),
        "departure_azimuth_rad": (paths.departure_azimuth_rad, {"units": "rad", "frame": _PLAN_FRAME}),
        "departure_elevation_rad": (paths.departure_elevation_rad, {"units": "rad"}),
        "doppler_hz": (doppler, {"units": "Hz", "long_name": "Doppler shift, positive if approaching"}),
    }
    return xr.Dataset(
        {
            **{name: (dims, values, attributes) for name, (values, attributes) in real.items()},
            **_complex_pair("amplitude", dims, paths.amplitude, np.float64, "gain with the carrier phase"),
            "path_valid": (
                dims,
                paths.valid.astype(np.int8),
                {"units": "1", "long_name": "1 where there is a path"},
            ),
            "order": (dims, paths.order, {"units": "1", "long_name": "number of bounces"}),
            "walls": (
                (*dims, "bounce"),
                paths.walls,
                {
                    "units": "1",
                    "long_name": "surface of each bounce from anchor to agent, -1 beyond the order",
                    "flag_values": np.arange(len(plan.surface_names), dtype=np.int16),
                    "flag_meanings": " ".join(name.replace(" ", "_") for name in plan.surface_names),
                },
            ),
            **(_interactions(paths) if plan.tracing.bends else {}),
        },
        coords={**_epochs(epochs), **_anchors(plan)},
    )


def _interactions(paths: PathSet) -> dict[str, tuple[tuple[str, ...], NDArray[np.int8], dict[str, Any]]]:
    kinds = {
        "none": NO_INTERACTION,
        "specular": SPECULAR,
        "refraction": REFRACTION,
        "diffraction": DIFFRACTION,
    }
    facts = {
        "units": "1",
        "long_name": "what the path does at each surface",
        "flag_values": np.array(list(kinds.values()), dtype=np.int8),
        "flag_meanings": " ".join(kinds),
    }
    return {"interactions": (("epoch", "anchor", "path", "bounce"), paths.interactions, facts)}


def truth_shard(plan: FloorPlan, reflects: NDArray[np.bool_]) -> xr.Dataset:
    """Floor plan, anchors, track and walls, in the plan frame.

    ``reflects``, shape (epochs, anchors, walls), says where a single bounce reaches the agent.
    """
    track = plan.track()
    start, end = plan.walls_m()
    metres = {"units": "m", "frame": _PLAN_FRAME}
    floorplan = plan.model_dump(mode="json", exclude_none=True)
    heading = {"units": "rad", "frame": _PLAN_FRAME, "long_name": "azimuth of the agent's x axis"}
    ahead = {"units": "s", "long_name": "agent's clock error less the anchor's, in every delay"}
    return xr.Dataset(
        {
            "anchor_position_m": (("anchor", "xyz"), plan.anchors_m(), metres),
            "track_m": (("epoch", "xyz"), track, metres),
            "time_s": ("epoch", plan.times_s(), {"units": "s"}),
            "agent_heading_rad": ("epoch", plan.headings_rad(), heading),
            "clock_error_s": (("epoch", "anchor"), plan.clock_errors_s(), ahead),
            "wall_start_m": (("wall", "xy"), start, metres),
            "wall_end_m": (("wall", "xy"), end, metres),
            "vrp_m": (
                ("wall", "xy"),
                vrp_of_line(start, end, track[0, :2]),
                {**metres, "long_name": "mirror image of the agent's start in each wall"},
            ),
            "reflects": (
                ("epoch", "anchor", "wall"),
                reflects.astype(np.int8),
                {"units": "1", "long_name": "1 where a single bounce on the wall reaches the agent"},
            ),
        },
        coords={
            **_epochs(np.arange(plan.agent.epochs, dtype=np.int64)),
            **_anchors(plan),
            "wall": ("wall", [wall.name for wall in plan.walls]),
        },
        attrs={
            "floorplan_toml": tomli_w.dumps(floorplan),
            "start_m": track[0],
            "heading_rad": plan.heading_rad,
        },
    )


def stored_plan(truth: xr.Dataset) -> FloorPlan:
    """The floor plan that a truth file holds.

    Raises
    ------
    FileFormatError
        If it holds none that can be read.
    """
    try:
        return parse_floorplan(tomllib.loads(truth.attrs["floorplan_toml"]), source="truth.nc")
    except (KeyError, tomllib.TOMLDecodeError) as error:
        raise FileFormatError(
            f"truth.nc: expected a floor plan in floorplan_toml, cannot read it: {error}"
        ) from error


def stored_paths(shard: xr.Dataset, heading_rad: float) -> PathSet:
    """The paths that :func:`paths_shard` wrote, in the plan frame; epochs count from the shard's first.

    Parameters
    ----------
    shard : Dataset
        A shard of paths.
    heading_rad : float
        Heading of the agent in the plan, radians.

    Raises
    ------
    FileFormatError
        If a variable is missing.
    """
    try:
        columns = {name: shard[name].values for name in _PATH_COLUMNS}
        amplitude = shard["amplitude_re"].values + 1j * shard["amplitude_im"].values
        valid = shard["path_valid"].values.astype(np.bool_)
    except KeyError as error:
        raise FileFormatError(f"paths: expected the variable {error} in the shard, it is missing") from error
    columns["arrival_azimuth_rad"] = columns["arrival_azimuth_rad"] + heading_rad
    specular = np.where(columns["walls"] == NO_SURFACE, NO_INTERACTION, SPECULAR).astype(np.int8)
    return PathSet(
        valid=valid,
        amplitude=amplitude,
        interactions=shard["interactions"].values if "interactions" in shard else specular,
        transfer=np.zeros((*valid.shape, 0, 0), dtype=np.complex128),
        **columns,
    )


def _complex_pair(
    name: str, dims: tuple[str, ...], values: NDArray[np.complex128], dtype: type, long_name: str
) -> dict[str, tuple[tuple[str, ...], NDArray[np.floating], dict[str, str]]]:
    return {
        f"{name}_{suffix}": (
            dims,
            part.astype(dtype),
            {"units": "1", "long_name": f"{long_name}, {word} part"},
        )
        for suffix, part, word in (("re", values.real, "real"), ("im", values.imag, "imaginary"))
    }


def _epochs(epochs: NDArray[np.int64]) -> dict[str, tuple[str, NDArray[np.int64], dict[str, str]]]:
    return {"epoch": ("epoch", epochs, {"units": "1"})}


def _anchors(plan: FloorPlan) -> dict[str, tuple[str, list[str]]]:
    return {"anchor": ("anchor", [anchor.name for anchor in plan.anchors])}


def _tones(offsets_hz: NDArray[np.float64]) -> dict[str, tuple[str, NDArray[np.float64], dict[str, str]]]:
    return {"tone_offset_hz": ("tone", offsets_hz, {"units": "Hz", "long_name": "offset from the carrier"})}
