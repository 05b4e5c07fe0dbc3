"""DeepMIMO scenarios of version 4, whoever made them, as paths, positions and materials.

A scenario is a folder as :mod:`raytrace.dataset.export_deepmimo` describes it: ``params.json``, the scene
in ``objects.json`` and ``vertices.npz``, and matrices of paths for every pair of a transmitter and a set
of receivers. The first set of transmitters becomes anchors, the first set of receivers the agent's
positions. Interactions are 1 (reflection), 2 (diffraction), 3 (scattering) and 4 (transmission); surfaces are
not named in such files. Nothing in them is run, and pickled arrays are refused.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from raytrace.propagation.paths import (
    DIFFRACTION,
    DIFFUSE,
    NO_INTERACTION,
    NO_SURFACE,
    REFRACTION,
    SPECULAR,
    PathSet,
)

__all__ = ["DeepMimoScenario", "SceneFace", "read_deepmimo"]

Array = NDArray[np.float64]

# A matrix that unpacks to more is no scenario that a machine of this size could use, bytes.
_MOST_BYTES = 2**31
_MOST_BOUNCES = 16
_KINDS = np.array([NO_INTERACTION, SPECULAR, DIFFRACTION, DIFFUSE, REFRACTION], dtype=np.int8)
_ANGLES = ("aoa_az", "aoa_el", "aod_az", "aod_el")


@dataclass(frozen=True, eq=False)
class SceneFace:
    """A face of an object: the object's name, its material, and its corners, shape (n, 3), metres."""

    name: str
    material: str
    corners_m: Array


@dataclass(frozen=True, eq=False)
class DeepMimoScenario:
    """A scenario.

    Parameters
    ----------
    carrier_hz : float
        Carrier, hertz.
    anchors_m : ndarray, shape (anchors, 3)
        Transmitters, metres.
    positions_m : ndarray, shape (epochs, 3)
        Receivers, metres.
    paths : PathSet
        Axes (epochs, anchors, path): amplitudes with the carrier's phase, plan frame; ``walls`` are unknown.
    bounces_m : ndarray, shape (epochs, anchors, path, bounce, 3)
        Where paths interact, metres; NaN beyond.
    materials : mapping of str to (float, float)
        Relative permittivity and conductivity, S/m, by name.
    faces : tuple of SceneFace
        What the scene is made of; empty if the scenario has no scene.
    """

    carrier_hz: float
    anchors_m: Array
    positions_m: Array
    paths: PathSet
    bounces_m: Array
    materials: Mapping[str, tuple[float, float]]
    faces: tuple[SceneFace, ...]


def read_deepmimo(folder: Path) -> DeepMimoScenario:
    """Read a scenario.

    Parameters
    ----------
    folder : Path
        The scenario's folder.

    Raises
    ------
    FileFormatError
        If a file is missing, damaged or too large, shapes do not fit, or the version is another.
    """
    folder = Path(folder)
    try:
        return _scenario(folder, _json(folder / "params.json"))
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise FileFormatError(
            f"{folder}: expected a DeepMIMO scenario, {type(error).__name__} in params.json: {error}"
        ) from error


def _scenario(folder: Path, params: Any) -> DeepMimoScenario:
    version = str(params["version"])
    if not version.startswith("4."):
        raise FileFormatError(f"{folder}: expected a DeepMIMO scenario of version 4, got {version[:40]!r}")
    sets = sorted(params["txrx_sets"].values(), key=lambda one: int(one["id"]))
    sender = next((one for one in sets if one["is_tx"]), None)
    receiver = next((one for one in sets if one["is_rx"] and one is not sender), None)
    if sender is None or receiver is None:
        raise FileFormatError(
            f"{folder}: expected a set of transmitters and one of receivers, got {len(sets)}"
        )
    links = []
    for number in range(int(sender["num_points"])):
        place = f"t{int(sender['id']):03d}_tx{number:03d}_r{int(receiver['id']):03d}"
        links.append({name: _matrix(folder, name, place) for name in _QUANTITIES})
    if not links:
        raise FileFormatError(f"{folder}: expected at least one transmitter, got none")
    count = len(links[0]["rx_pos"])
    for link in links:
        _require_shapes(folder, link, count)
    width = max(link["power"].shape[1] for link in links)
    depth = max([1, *(link["inter_pos"].shape[2] for link in links)])
    grid = {name: np.stack([_filled(link[name], width) for link in links], axis=1) for name in _OF_PATHS}
    bounces = np.stack([_filled(_deep(link["inter_pos"], depth), width) for link in links], axis=1)
    return DeepMimoScenario(
        carrier_hz=float(params["rt_params"]["frequency"]),
        anchors_m=np.array([np.reshape(link["tx_pos"], 3) for link in links]),
        positions_m=links[0]["rx_pos"],
        paths=_path_set(grid, depth),
        bounces_m=bounces,
        materials={
            str(one["name"]): (float(one["permittivity"]), float(one["conductivity"]))
            for one in params["materials"].values()
        },
        faces=tuple(_faces(folder, params["materials"])),
    )


_OF_PATHS = ("power", "phase", "delay", "inter", *_ANGLES)
_QUANTITIES = (*_OF_PATHS, "inter_pos", "rx_pos", "tx_pos")


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"{path}: expected a file, could not read it: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: expected JSON, could not read it: {error}") from error


def _matrix(folder: Path, name: str, place: str) -> Array:
    return _array(folder / f"{name}_{place}.npz", name)


def _array(path: Path, name: str) -> Array:
    """The array of a name in an .npz file, as float64."""
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > _MOST_BYTES:
            raise FileFormatError(f"{path}: expected at most {_MOST_BYTES >> 20} MiB, got {size >> 20} MiB")
        with np.load(path, allow_pickle=False) as arrays:
            return np.asarray(arrays[name], dtype=np.float64)
    except OSError as error:
        raise FileFormatError(f"{path}: expected a file, could not read it: {error}") from error
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{path}: expected an array {name!r} of numbers, got none: {error}") from error


def _require_shapes(folder: Path, link: Mapping[str, Array], count: int) -> None:
    """Whether all matrices of a link have a row for each receiver, and a column for each path."""
    shape = link["power"].shape
    for name in _OF_PATHS:
        if link[name].shape != shape or len(shape) != 2 or shape[0] != count:
            raise FileFormatError(
                f"{folder}: expected {name} of shape ({count}, paths), got {link[name].shape}"
            )
    points = link["inter_pos"].shape
    if len(points) != 4 or points[:2] != shape or points[3] != 3 or points[2] > _MOST_BOUNCES:
        raise FileFormatError(f"{folder}: expected inter_pos of shape {(*shape, 'bounces', 3)}, got {points}")
    if link["rx_pos"].shape != (count, 3) or link["tx_pos"].size != 3:
        raise FileFormatError(f"{folder}: expected places of three coordinates, got {link['rx_pos'].shape}")


def _filled(values: Array, width: int) -> Array:
    """A matrix (epochs, path, ...) with so many paths, NaN where there is none."""
    more = [(0, 0), (0, width - values.shape[1]), *[(0, 0)] * (values.ndim - 2)]
    return np.pad(values, more, constant_values=np.nan)


def _deep(points: Array, depth: int) -> Array:
    return np.pad(points, [(0, 0), (0, 0), (0, depth - points.shape[2]), (0, 0)], constant_values=np.nan)


def _path_set(grid: Mapping[str, Array], depth: int) -> PathSet:
    """Paths on the grid (epochs, anchors, path)."""
    valid = np.isfinite(grid["power"]) & np.isfinite(grid["delay"])
    code = np.where(valid, grid["inter"], 0.0)
    kinds, order = _interactions(np.where(np.isfinite(code), code, 0.0), depth)
    amplitude = np.where(valid, 10.0 ** (grid["power"] / 20.0) * np.exp(1j * np.deg2rad(grid["phase"])), 0.0)
    angles = {name: np.where(valid, np.deg2rad(grid[name]), np.nan) for name in _ANGLES}
    return PathSet(
        valid=valid,
        delay_s=np.where(valid, grid["delay"], np.nan),
        amplitude=amplitude,
        departure_azimuth_rad=angles["aod_az"],
        departure_elevation_rad=0.5 * np.pi - angles["aod_el"],
        arrival_azimuth_rad=angles["aoa_az"],
        arrival_elevation_rad=0.5 * np.pi - angles["aoa_el"],
        order=order,
        walls=np.full(kinds.shape, NO_SURFACE, dtype=np.int16),
        interactions=kinds,
        transfer=np.zeros((*valid.shape, 0, 0), dtype=np.complex128),
    )


def _interactions(code: Array, depth: int) -> tuple[NDArray[np.int8], NDArray[np.int16]]:
    """Kinds of interactions, from the transmitter on, of codes with a digit for each; and their number."""
    digits = np.rint(code).astype(np.int64)
    if digits.size and (digits.min() < 0 or digits.max() >= 10**depth):
        raise FileFormatError(f"inter: expected codes of at most {depth} digits, got {digits.max()}")
    order = np.zeros(digits.shape, dtype=np.int16)
    for place in range(depth):
        order[digits >= 10**place] = place + 1
    kinds = np.full((*digits.shape, depth), NO_INTERACTION, dtype=np.int8)
    for bounce in range(depth):
        there = order > bounce
        digit = digits[there] // 10 ** (order[there] - 1 - bounce).astype(np.int64) % 10
        if digit.size and not 1 <= digit.min() <= digit.max() < len(_KINDS):
            raise FileFormatError(f"inter: expected digits from 1 to {len(_KINDS) - 1}, got {digit.max()}")
        kinds[there, bounce] = _KINDS[digit]
    return kinds, order


def _faces(folder: Path, materials: Mapping[str, Any]) -> list[SceneFace]:
    """Faces of the scene's objects; none if the scenario has no scene."""
    if not (folder / "objects.json").exists():
        return []
    vertices = _array(folder / "vertices.npz", "vertices").reshape(-1, 3)
    names = {int(one["id"]): str(one["name"]) for one in materials.values()}
    faces = []
    for thing in _json(folder / "objects.json"):
        pairs = zip(thing["face_vertex_idxs"], thing["face_material_idxs"], strict=False)
        for corners, material in pairs:
            index = np.array(corners, dtype=np.int64)
            if index.size and not 0 <= index.min() <= index.max() < len(vertices):
                raise FileFormatError(f"{folder}: expected vertices below {len(vertices)}, got {index.max()}")
            faces.append(SceneFace(str(thing["name"]), names.get(int(material), "unknown"), vertices[index]))
    return faces
