"""Measurement sets and truths as the requests that send them; no figure is changed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from estimator.dataset import open_dataset
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from service.messages.documents import odometry_entry

__all__ = ["epoch_entry", "session_entry", "sweep_entry", "truth_entry"]

_COLUMNS = tuple(entry.name for entry in fields(AnchorPaths))


def session_entry(measurements: MeasurementSet, **more: Any) -> dict[str, Any]:
    """The request that makes a session for a measurement set."""
    known = measurements.known_anchors_m
    return {
        "anchors": list(measurements.anchors),
        "carrier_hz": measurements.carrier_hz,
        "measurement_model": dict(measurements.settings.get("measurement_model", {})),
        "known_anchors_m": None if known is None else known.tolist(),
        "max_speed_m_s": measurements.max_speed_m_s,
        "echo_bias_std_m": measurements.echo_bias_std_m,
        **more,
    }


def sweep_entry(measurements: MeasurementSet) -> dict[str, Any]:
    """The request that gives a session the walls sensed at the start."""
    return {"sweep": 0, "walls": _walls(measurements.walls)}


def _walls(walls: Iterable[GaussianVrp]) -> list[dict[str, Any]]:
    return [{"vrp_m": wall.mean_m.tolist(), "covariance_m2": wall.covariance_m2.tolist()} for wall in walls]


def epoch_entry(anchors: tuple[str, ...], epoch: Epoch) -> dict[str, Any]:
    """An epoch as ``POST .../epochs`` takes it; no figure is changed."""
    silent = epoch.asked is not None
    return {
        "epoch": epoch.index,
        "time_s": epoch.time_s,
        "anchors": {
            name: {
                column: values.tolist()
                for column in _COLUMNS
                if (values := getattr(paths, column)) is not None
            }
            for name, paths in zip(anchors, epoch.paths, strict=True)
        },
        "sweep": _walls(epoch.sweep),
        "heading_held": epoch.heading_held,
        **(
            {"asked": [name for name, yes in zip(anchors, epoch.was_asked, strict=True) if yes]}
            if silent
            else {}
        ),
        **odometry_entry(epoch),
    }


def truth_entry(dataset: Path) -> dict[str, Any]:
    """The truth of a dataset as ``PUT .../truth`` takes it."""
    data = open_dataset(dataset).truth()
    start = [float(value) for value in data.attrs["start_m"][:2]]
    walls = zip(data["wall"].values, data["wall_start_m"].values, data["wall_end_m"].values, strict=True)
    return {
        "frame": "plan",
        "start_frame": {"position_m": start, "heading_rad": float(data.attrs["heading_rad"])},
        "walls": [{"name": str(n), "from_m": a.tolist(), "to_m": b.tolist()} for n, a, b in walls],
        "anchors_m": data["anchor_position_m"].values[:, :2].tolist(),
        "track_m": data["track_m"].values[:, :2].tolist(),
    }
