"""A session's estimates in the terms of the batch commands: results, measurements, maps."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row

from estimator.evaluation.wall_lines import line_points, line_std, seen_span
from estimator.measurement_files import save_measurements
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult, save_result
from estimator.slam.protocol import INTEGRITY_STATES
from service.errors import ConflictError
from service.messages.documents import read_epoch, read_estimate, read_sweep
from service.messages.packed import RunTerms, pack_estimate, unpack_run
from service.session.fold import measurement_set
from service.storage.store import Store

__all__ = [
    "latest_epoch",
    "map_document",
    "measurements_file",
    "picture",
    "result_file",
    "session_measurements",
    "session_result",
]

_LAST = 2**31 - 1


def latest_epoch(row: Row[Any], epoch: int | None) -> int:
    """The epoch asked for, or the latest.

    Raises
    ------
    ConflictError
        If the session has not come so far.
    """
    last = row.next_epoch - 1
    if last < 0 or (epoch is not None and epoch > last):
        wanted = "an epoch" if epoch is None else f"epoch {epoch}"
        raise ConflictError(
            f"expected a session that has taken in {wanted}, it expects epoch {row.next_epoch} next",
            {"next_epoch": row.next_epoch},
        )
    return last if epoch is None else epoch


def session_result(store: Store, row: Row[Any], connection: Connection, last: int = _LAST) -> SlamResult:
    """The estimates up to an epoch, as a batch run gives them."""
    config = json.loads(row.config)
    packed = [
        found.packed if found.packed is not None else _packed(found.document)
        for found in store.packed_estimates(row.id, last, connection)
    ]
    terms = RunTerms(
        config["method"], config["engine"], config["seed"], tuple(config["anchors"]), {"session": config}
    )
    return unpack_run(packed, terms)


def _packed(text: str) -> bytes:
    """What a row lacks that was written before estimates were packed."""
    document = json.loads(text)
    return pack_estimate(document["epoch"], document["time_s"], read_estimate(document))


def result_file(result: SlamResult) -> bytes:
    """A result as a netCDF file."""
    with TemporaryDirectory(prefix="hapslam-") as folder:
        file = Path(folder) / "result.nc"
        save_result(result, file)
        return file.read_bytes()


def session_measurements(store: Store, row: Row[Any], connection: Connection) -> MeasurementSet:
    """What a session has been sent, as a batch run takes it."""
    walls = [wall for text in store.log(row.id, "sweep", connection) for wall in read_sweep(text)]
    epochs = tuple(read_epoch(text) for text in store.log(row.id, "epoch", connection))
    return replace(measurement_set(json.loads(row.config), walls), epochs=epochs)


def measurements_file(store: Store, row: Row[Any], connection: Connection) -> bytes:
    """A session's log as a measurement file (netCDF), as ``hapslam slam`` reads it."""
    with TemporaryDirectory(prefix="hapslam-") as folder:
        file = Path(folder) / "measurements.nc"
        save_measurements(session_measurements(store, row, connection), file)
        return file.read_bytes()


def picture(result: SlamResult, title: str, suffix: str) -> bytes:
    """The map as a picture, ``"png"`` or ``"svg"``; its title says where it is not to be relied on."""
    from estimator.evaluation.pictures import draw_map, save_figure  # Matplotlib is slow to import

    state = _integrity(result)["state"]
    if state in ("doubtful", "lost"):
        title = f"{state.upper()}: {title or 'do not rely on it'}"
    with TemporaryDirectory(prefix="hapslam-") as folder:
        file = Path(folder) / f"map.{suffix}"
        save_figure(draw_map(result, title=title or None), file)
        return file.read_bytes()


def _integrity(result: SlamResult) -> dict[str, Any]:
    """Whether the last epoch may be relied on, as far as the engine tells."""
    if result.integrity_state is None or result.protection_level_m is None:
        return {"state": "unknown", "protection_level_m": None}
    number, level = int(result.integrity_state[-1]), float(result.protection_level_m[-1])
    state = INTEGRITY_STATES[number] if number >= 0 else "unknown"
    return {"state": state, "protection_level_m": level if math.isfinite(level) else None}


def map_document(result: SlamResult, start_frame: dict[str, Any] | None) -> dict[str, Any]:
    """Walls as segments, anchors and agent at the last epoch of a result.

    Parameters
    ----------
    result : SlamResult
        Estimates, at least one epoch.
    start_frame : dict or None
        Where the agent started in the plan's frame; the map is given in that frame then.
    """
    origin = np.array((start_frame or {}).get("position_m", (0.0, 0.0)))
    heading = (start_frame or {}).get("heading_rad", 0.0)
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])

    def place(points: Any) -> Any:
        return (np.asarray(points) @ turn.T + origin).tolist()

    def spread(covariance: Any) -> Any:
        return (turn @ covariance @ turn.T).tolist()

    walls = []
    for column in np.flatnonzero(result.wall_valid[-1]):
        vrp, covariance = result.wall_mean_m[-1, column], result.wall_covariance_m2[-1, column]
        span = seen_span(result, int(column))
        along = np.linspace(*span, 9)
        walls.append(
            {
                "id": int(result.wall_id[column]),
                "vrp_m": place(vrp),
                "covariance_m2": spread(covariance),
                "segment_m": place(line_points(vrp, span)),
                "std_along_segment_m": line_std(vrp, covariance, along).tolist(),
            }
        )
    agent = result.agent_mean[-1]
    return {
        "epoch": int(result.epoch[-1]),
        "time_s": float(result.time_s[-1]),
        "frame": "estimator" if start_frame is None else "plan",
        "integrity": _integrity(result),
        "agent": {
            "position_m": place(agent[:2]),
            "velocity_m_s": (turn @ agent[2:]).tolist(),
            "covariance_m2": spread(result.agent_covariance[-1, :2, :2]),
        },
        "anchors": [
            {
                "name": name,
                "located": bool(valid),
                "position_m": place(mean) if valid else None,
                "covariance_m2": spread(covariance) if valid else None,
            }
            for name, valid, mean, covariance in zip(
                result.anchors,
                result.anchor_valid[-1],
                result.anchor_mean_m[-1],
                result.anchor_covariance_m2[-1],
                strict=True,
            )
        ],
        "walls": walls,
        "track_m": place(result.agent_mean[:, :2]),
    }
