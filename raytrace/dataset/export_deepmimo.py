"""A dataset as a DeepMIMO scenario (version 4): matrices of paths for every anchor.

A scenario is a folder that ``deepmimo.load`` takes: ``params.json``, the scene
(``objects.json``, ``vertices.npz``), and for the transmitter ``k`` of set 0 and the
receivers of set 1 one file for each quantity, ``<quantity>_t000_tx<k>_r001.npz``, axes
(position of the agent, path), strongest path first, NaN where there is none:

    power (dB), phase (degrees), delay (s), aoa_az, aoa_el, aod_az, aod_el (degrees),
    inter (one digit 1 for each reflection, 0 for the line of sight), inter_pos, rx_pos, tx_pos (m).

Azimuths are in the plan frame; DeepMIMO's elevation is a zenith angle. The phase contains
the carrier's, ``-2 pi f_c delay``, as that of every amplitude here. Only specular paths are
exported, without noise.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import Dataset, publish, temporary_name, write_text
from raytrace.dataset.shards import stored_paths, stored_plan
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.bounces import bounce_points
from raytrace.propagation.paths import PathSet
from raytrace.propagation.reflectors import surfaces_of

__all__ = ["export_deepmimo"]

_FORMAT_VERSION = "4.0.0"
_VACUUM_PERMITTIVITY_F_M = 8.854_187_8128e-12

Single = NDArray[np.float32]


def export_deepmimo(dataset: Dataset, out: Path) -> None:
    """Write a scenario that DeepMIMO loads.

    The matrices of one anchor are in memory at a time.

    Parameters
    ----------
    dataset : Dataset
        A dataset with its truth.
    out : Path
        Folder to write into, which exists; its name is the scenario's.

    Raises
    ------
    FileFormatError
        If a shard is missing or changed.
    """
    plan = stored_plan(dataset.truth())
    reached = 0
    for anchor, position in enumerate(plan.anchors_m()):
        matrices = _stacked(list(_matrices(dataset, plan, anchor)))
        matrices["tx_pos"] = position.astype(np.float32)
        matrices["rx_pos"] = plan.track().astype(np.float32)
        reached = max(reached, int(np.isfinite(matrices["power"][:, 0]).sum()))
        for name, values in matrices.items():
            _save(name, values, out / f"{name}_t000_tx{anchor:03d}_r001.npz")
    corners = surfaces_of(plan).corners()
    _save("vertices", corners.reshape(-1, 3).astype(np.float32), out / "vertices.npz")
    for name, content in (("objects", _objects(plan)), ("params", _params(dataset, plan, reached))):
        write_text(json.dumps(content, indent=2) + "\n", out / f"{name}.json")


def _matrices(dataset: Dataset, plan: FloorPlan, anchor: int) -> Iterator[dict[str, Single]]:
    """The matrices of one anchor, shard by shard."""
    track = plan.track()
    for shard in dataset.shards("paths"):
        paths = stored_paths(shard, plan.heading_rad).specular()
        points = _spread(paths, plan, track[shard["epoch"].values])[:, anchor]
        valid, amplitude = paths.valid[:, anchor], paths.amplitude[:, anchor]
        with np.errstate(divide="ignore"):
            power = np.where(valid, 20.0 * np.log10(np.abs(amplitude)), np.nan)
        codes = np.array([int("1" * bounces or "0") for bounces in range(paths.walls.shape[-1] + 1)])
        columns = {
            "power": power,
            "phase": np.rad2deg(np.angle(amplitude)),
            "delay": paths.delay_s[:, anchor],
            "aoa_az": _turned(paths.arrival_azimuth_rad[:, anchor]),
            "aoa_el": 90.0 - np.rad2deg(paths.arrival_elevation_rad[:, anchor]),
            "aod_az": _turned(paths.departure_azimuth_rad[:, anchor]),
            "aod_el": 90.0 - np.rad2deg(paths.departure_elevation_rad[:, anchor]),
            "inter": codes[paths.order[:, anchor]],
            "inter_pos": points,
        }
        strongest = np.argsort(np.where(valid, -power, np.inf), axis=-1, kind="stable")
        yield {
            name: np.take_along_axis(
                np.where(_like(valid, values), values, np.nan), _like(strongest, values), axis=1
            ).astype(np.float32)
            for name, values in columns.items()
        }


def _turned(azimuth_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Azimuths in degrees, in (-180, 180]."""
    return np.asarray(np.rad2deg(np.angle(np.exp(1j * azimuth_rad))))


def _like(mask: NDArray[Any], values: NDArray[Any]) -> NDArray[Any]:
    """A mask (epoch, path) with trailing axes to go with ``values``."""
    return mask.reshape(mask.shape + (1,) * (values.ndim - mask.ndim))


def _spread(paths: PathSet, plan: FloorPlan, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bounces of all paths on their grid, (epoch, anchor, path, bounce, 3)."""
    points = np.full((*paths.walls.shape, 3), np.nan)
    points[paths.valid] = bounce_points(plan, paths.flat(), positions)
    return points


def _stacked(parts: list[dict[str, Single]]) -> dict[str, Single]:
    """Matrices of successive epochs as one, as wide as the widest."""
    width = max(part["power"].shape[1] for part in parts)

    def filled(values: Single) -> Single:
        more = [(0, 0), (0, width - values.shape[1]), *[(0, 0)] * (values.ndim - 2)]
        return np.pad(values, more, constant_values=np.nan)

    return {name: np.concatenate([filled(part[name]) for part in parts]) for name in parts[0]}


def _objects(plan: FloorPlan) -> list[dict[str, Any]]:
    materials = _materials(plan)
    return [
        {
            "name": name,
            "label": "floorplans",
            "id": index,
            "face_vertex_idxs": [list(range(4 * index, 4 * index + 4))],
            "face_material_idxs": [materials.index(slab.material)],
        }
        for index, (name, slab) in enumerate(zip(plan.surface_names, plan.surface_slabs, strict=True))
    ]


def _materials(plan: FloorPlan) -> list[str]:
    return sorted({slab.material for slab in plan.surface_slabs})


def _material(plan: FloorPlan, index: int, name: str) -> dict[str, Any]:
    carrier_hz = plan.radio.carrier_hz
    complex_permittivity = plan.permittivity_of(name, carrier_hz)
    scattering = plan.scattering_of(name)
    return {
        "id": index,
        "name": name,
        "permittivity": complex_permittivity.real,
        "conductivity": -complex_permittivity.imag * 2.0 * np.pi * carrier_hz * _VACUUM_PERMITTIVITY_F_M,
        "scattering_model": plan.scattering_pattern_of(name).pattern if scattering else "none",
        "scattering_coefficient": scattering,
    }


def _params(dataset: Dataset, plan: FloorPlan, reached: int) -> dict[str, Any]:
    manifest: Mapping[str, Any] = dataset.manifest
    surfaces = len(plan.surface_names)
    depth = plan.tracing.depth
    traced = plan.tracing.engine == "sionna"
    return {
        "version": _FORMAT_VERSION,
        "rt_params": {
            "raytracer_name": "Sionna Ray Tracing" if traced else "hapslam image method",
            "raytracer_version": manifest["versions"]["sionna-rt"] if traced else metadata.version("hapslam"),
            "frequency": plan.radio.carrier_hz,
            "max_path_depth": depth,
            "max_reflections": depth,
            "max_diffractions": 0,
            "max_scattering": 0,
            "max_transmissions": 0,
            "num_rays": plan.tracing.samples,
            "synthetic_array": True,
            "raw_params": {"seed": manifest["seed"], "scene_sha256": manifest["scene"]["sha256"]},
        },
        "txrx_sets": {
            "txrx_set_0": _set(0, "anchors", len(plan.anchors), len(plan.anchors)),
            "txrx_set_1": _set(1, "agent", plan.agent.epochs, reached),
        },
        "materials": {
            f"material_{index}": _material(plan, index, name) for index, name in enumerate(_materials(plan))
        },
        "scene": {
            "num_scenes": 1,
            "n_objects": surfaces,
            "n_vertices": 4 * surfaces,
            "n_faces": surfaces,
            "n_triangular_faces": 2 * surfaces,
        },
    }


def _set(index: int, name: str, points: int, active: int) -> dict[str, Any]:
    return {
        "name": name,
        "id_orig": index,
        "id": index,
        "is_tx": index == 0,
        "is_rx": index == 1,
        "num_points": points,
        "num_active_points": active,
        "num_ant": 1,
        "dual_pol": False,
        "ant_rel_positions": [[0, 0, 0]],
        "array_orientation": [0, 0, 0],
    }


def _save(name: str, values: Single, path: Path) -> None:
    temporary = temporary_name(path)
    arrays: dict[str, Any] = {name: values}
    try:
        with temporary.open("wb") as stream:
            np.savez_compressed(stream, **arrays)
        publish(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
