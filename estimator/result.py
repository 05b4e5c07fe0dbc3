"""What a SLAM run gives: estimates with covariances for every epoch, and their file.

Positions are metres in the estimator's frame (origin RP, axes of the agent's arrays
at the start). Arrays have one row per epoch; slots that hold nothing (an anchor not
started, a wall not confirmed) are NaN and marked by a mask.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import read_netcdf, write_netcdf
from estimator.errors import FileFormatError, InputError
from estimator.joint_map import JOINT_SHAPES, JointMap, joint_map_of
from estimator.json_objects import json_object

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["EPOCH_SHAPES", "SlamResult", "load_result", "save_result"]

FORMAT = "hapslam-result"
VERSION = 2

_SHAPES: dict[str, tuple[tuple[str, ...], str]] = {
    "epoch": (("epoch",), "1"),
    "time_s": (("epoch",), "s"),
    "agent_mean": (("epoch", "state"), "m, m s-1"),
    "agent_covariance": (("epoch", "state", "state2"), "m2, m2 s-1, m2 s-2"),
    "rotation_std_rad": (("epoch",), "rad"),
    "anchor_valid": (("epoch", "anchor"), "1"),
    "anchor_mean_m": (("epoch", "anchor", "xy"), "m"),
    "anchor_covariance_m2": (("epoch", "anchor", "xy", "xy2"), "m2"),
    "wall_id": (("wall",), "1"),
    "wall_valid": (("epoch", "wall"), "1"),
    "wall_mean_m": (("epoch", "wall", "xy"), "m"),
    "wall_covariance_m2": (("epoch", "wall", "xy", "xy2"), "m2"),
    "hypotheses": (("epoch",), "1"),
    "log_evidence": (("epoch",), "1"),
    "anchor_existence": (("epoch", "anchor"), "1"),
    "wall_existence": (("epoch", "wall"), "1"),
    "candidate_weight": (("epoch", "candidate"), "1"),
    "candidate_agent_m": (("epoch", "candidate", "xy"), "m"),
    "candidate_wall_id": (("candidate_wall",), "1"),
    "candidate_wall_mean_m": (("epoch", "candidate", "candidate_wall", "xy"), "m"),
}
_LATER: dict[str, tuple[tuple[str, ...], str]] = {  # files of before may lack them
    "integrity_state": (("epoch",), "1"),
    "integrity_probability": (("epoch",), "1"),
    "protection_level_m": (("epoch",), "m"),
}
EPOCH_SHAPES = {name: axes for name, (axes, _) in (_SHAPES | _LATER).items() if axes[0] == "epoch"}
"""Axes of what a result tells of each epoch, by name."""


@dataclass(frozen=True, eq=False)
class SlamResult:
    """Estimates of one run.

    Parameters
    ----------
    method, engine : str
        What is known and sensed, and how inference is done.
    seed : int
        Seed of the run.
    anchors : tuple of str
        Anchor names; axis ``anchor`` has this order.
    epoch : ndarray of int64, shape (T,)
        Epoch numbers.
    time_s : ndarray, shape (T,)
        Seconds since the first epoch.
    agent_mean : ndarray, shape (T, 4)
        Agent position and velocity (x, y, vx, vy), metres and metres per second.
    agent_covariance : ndarray, shape (T, 4, 4)
        Its covariance, the rotation about RP included.
    rotation_std_rad : ndarray, shape (T,)
        Standard deviation of the map's rotation about RP, radians.
    anchor_valid : ndarray of bool, shape (T, K)
        Whether the anchor has been located.
    anchor_mean_m, anchor_covariance_m2 : ndarray, shapes (T, K, 2) and (T, K, 2, 2)
        Anchor positions.
    wall_id : ndarray of int64, shape (L,)
        Identity of each wall of the run, in order of appearance.
    wall_valid : ndarray of bool, shape (T, L)
        Whether the wall is confirmed at the epoch.
    wall_mean_m, wall_covariance_m2 : ndarray, shapes (T, L, 2) and (T, L, 2, 2)
        Walls as VRPs (mirror images of RP).
    hypotheses : ndarray of int64, shape (T,)
        Number of hypotheses kept.
    log_evidence : ndarray, shape (T,)
        Log of the evidence accumulated up to the epoch.
    anchor_existence, wall_existence : ndarray, shapes (T, K) and (T, L)
        Probability that the anchor, or the confirmed wall, is there.
    candidate_weight, candidate_agent_m : ndarray, shapes (T, C) and (T, C, 2)
        The likeliest hypotheses, the likeliest first: their probabilities, and where the agent would be.
    candidate_wall_id : ndarray of int64, shape (M,)
        Identity of each wall that any of them has at any epoch, unconfirmed ones included.
    candidate_wall_mean_m : ndarray, shape (T, C, M, 2)
        The walls of each hypothesis as VRPs, NaN for those that it has not.
    integrity_state : ndarray of int64, shape (T,)
        Whether the epoch may be relied on: 0 ok, 1 doubtful, 2 lost, -1 unknown.
    integrity_probability : ndarray, shape (T,)
        Probability that the agent is within a metre of where it is thought to be; NaN if unknown.
    protection_level_m : ndarray, shape (T,)
        The error of the position is smaller with 99.9 % probability, metres; NaN if unknown.
    joint : JointMap or None
        The map as a whole and which path was which feature, where the run was smoothed.
    settings : mapping
        Resolved configuration of the run and of its measurements (JSON types).
    dataset : str or None
        Path of the dataset relative to the result's folder, for ``evaluate`` and ``plot``.
    """

    method: str
    engine: str
    seed: int
    anchors: tuple[str, ...]
    epoch: NDArray[np.int64]
    time_s: NDArray[np.float64]
    agent_mean: NDArray[np.float64]
    agent_covariance: NDArray[np.float64]
    rotation_std_rad: NDArray[np.float64]
    anchor_valid: NDArray[np.bool_]
    anchor_mean_m: NDArray[np.float64]
    anchor_covariance_m2: NDArray[np.float64]
    wall_id: NDArray[np.int64]
    wall_valid: NDArray[np.bool_]
    wall_mean_m: NDArray[np.float64]
    wall_covariance_m2: NDArray[np.float64]
    hypotheses: NDArray[np.int64]
    log_evidence: NDArray[np.float64]
    anchor_existence: NDArray[np.float64]
    wall_existence: NDArray[np.float64]
    candidate_weight: NDArray[np.float64]
    candidate_agent_m: NDArray[np.float64]
    candidate_wall_id: NDArray[np.int64]
    candidate_wall_mean_m: NDArray[np.float64]
    settings: Mapping[str, Any] = field(default_factory=dict)
    dataset: str | None = None
    integrity_state: NDArray[np.int64] | None = None
    integrity_probability: NDArray[np.float64] | None = None
    protection_level_m: NDArray[np.float64] | None = None
    joint: JointMap | None = None

    @property
    def flagged(self) -> NDArray[np.bool_]:
        """Epochs (T,) that are doubtful or lost; none where the engine does not tell."""
        if self.integrity_state is None:
            return np.zeros(len(self.epoch), dtype=bool)
        return np.asarray(self.integrity_state > 0)


def save_result(result: SlamResult, path: Path) -> None:
    """Write a result file (netCDF); raises OutputExistsError if ``path`` exists."""
    variables = {}
    told = {name: shape for name, shape in _LATER.items() if getattr(result, name) is not None}
    for name, (dims, units) in (_SHAPES | told).items():
        values = getattr(result, name)
        if values.dtype == np.bool_:
            values = values.astype(np.int8)
        variables[name] = (dims, values, {"units": units})
    if result.joint is not None:
        for name, values in result.joint.variables().items():
            dims, units = JOINT_SHAPES[name]
            variables[name] = (dims, values, {"units": units})
    attributes = {
        "format": FORMAT,
        "version": VERSION,
        "method": result.method,
        "engine": result.engine,
        "seed": result.seed,
        "settings": json.dumps(dict(result.settings), sort_keys=True),
        "dataset": result.dataset or "",
        "frame": "origin: agent's start (RP); axes: the agent's arrays at the start; metres",
    }
    import xarray as xr

    data = xr.Dataset(variables, coords={"anchor": ("anchor", list(result.anchors))}, attrs=attributes)
    write_netcdf(data, path)


def load_result(path: Path) -> SlamResult:
    """Read a result file; raises FileFormatError if it is none."""
    data = read_netcdf(path, FORMAT, VERSION)
    missing = [name for name in (*_SHAPES, "anchor") if name not in data]
    if missing:
        raise FileFormatError(f"{path}: expected the variables {missing}, they are missing")
    shapes = _SHAPES | {name: shape for name, shape in _LATER.items() if name in data}
    joint = dict(JOINT_SHAPES) if any(name in data for name in JOINT_SHAPES) else {}
    absent = [name for name in joint if name not in data]
    if absent:
        raise FileFormatError(f"{path}: expected the variables {absent}, they are missing")
    for name, (dims, _) in (shapes | joint).items():
        if data[name].dims != dims:
            raise FileFormatError(f"{path}: expected {name} to have axes {dims}, got {data[name].dims}")
    attributes = data.attrs
    try:
        arrays = {name: data[name].values for name in shapes}
        for name in ("anchor_valid", "wall_valid"):
            arrays[name] = arrays[name].astype(bool)
        return SlamResult(
            method=str(attributes["method"]),
            engine=str(attributes["engine"]),
            seed=int(attributes["seed"]),
            anchors=tuple(str(name) for name in data["anchor"].values),
            settings=json_object(attributes["settings"], "attribute settings"),
            dataset=str(attributes["dataset"]) or None,
            joint=_joint(path, data, arrays) if joint else None,
            **arrays,
        )
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise FileFormatError(f"{path}: expected attributes of a result, got {error!r}") from error


def _joint(path: Path, data: xr.Dataset, arrays: Mapping[str, NDArray[Any]]) -> JointMap:
    """The joint map that a file holds."""
    epochs, anchors = arrays["anchor_valid"].shape
    try:
        return joint_map_of(lambda name: data[name].values, epochs, anchors, len(arrays["wall_id"]))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error
