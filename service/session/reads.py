"""What is made of a session's estimates on request: done in processes that read the database.

Each is a task that names a session and the key it must belong to, and gives back what is sent.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import Connection, Row

from service.errors import TooLargeError
from service.messages.documents import dump
from service.session.geojson import feature_collection, json_fg
from service.session.locations import location_data
from service.session.mcap_file import mcap_file
from service.session.results import (
    latest_epoch,
    map_document,
    measurements_file,
    picture,
    result_file,
    session_measurements,
    session_result,
)
from service.session.smoothing import smoothed_document
from service.session.tasks import TaskContext
from service.session.trajectories import tum_text
from service.storage.store import Store

__all__ = [
    "ExportFormat",
    "ExportRead",
    "MapFormat",
    "MapRead",
    "MeasurementsRead",
    "PictureRead",
    "Read",
    "SmoothRead",
    "TrackRead",
    "check_smoothable",
]

ExportFormat = Literal["netcdf", "mcap", "tum"]
MapFormat = Literal["json", "geojson", "json-fg", "location"]
_MAPS: dict[MapFormat, Callable[[dict[str, Any], str], dict[str, Any]]] = {
    "json": lambda document, _: document,
    "geojson": lambda document, _: feature_collection(document),
    "json-fg": json_fg,
    "location": location_data,
}
_COLUMNS = (
    "epoch",
    "time_s",
    "x_m",
    "y_m",
    "variance_x_m2",
    "covariance_xy_m2",
    "variance_y_m2",
    "rotation_std_rad",
    "hypotheses",
    "walls",
)


@dataclass(frozen=True)
class Read:
    """A read of one session.

    Parameters
    ----------
    session_id : str
        The session.
    key_id : str or None
        The key it must belong to.
    """

    session_id: str
    key_id: str | None

    def run(self, context: TaskContext) -> Any:
        """Read in one consistent transaction; raises NotFoundError or ConflictError."""
        store = context.database
        with store.reading() as connection:
            return self.look(store, store.session(self.session_id, self.key_id, connection), connection)

    def look(self, store: Store, row: Row[Any], connection: Connection) -> Any:
        """What is found."""
        raise NotImplementedError


@dataclass(frozen=True)
class TrackRead(Read):
    """The track as columns of equal length, JSON."""

    first: int
    limit: int

    def look(self, store: Store, row: Row[Any], connection: Connection) -> str:
        """The columns."""
        rows = store.track(row.id, self.first, connection, self.limit, _COLUMNS)
        columns = list(zip(*rows, strict=True)) or [()] * len(_COLUMNS)
        return dump(dict(zip(_COLUMNS, columns, strict=True)))


@dataclass(frozen=True)
class MapRead(Read):
    """The map at an epoch, JSON."""

    epoch: int
    format: MapFormat

    def look(self, store: Store, row: Row[Any], connection: Connection) -> str:
        """The document."""
        result = session_result(store, row, connection, self.epoch)
        document = map_document(result, json.loads(row.config)["start_frame"])
        return dump(_MAPS[self.format](document, row.id))


@dataclass(frozen=True)
class PictureRead(Read):
    """The map at an epoch as a picture."""

    epoch: int
    suffix: Literal["png", "svg"]

    def look(self, store: Store, row: Row[Any], connection: Connection) -> bytes:
        """The file."""
        return picture(session_result(store, row, connection, self.epoch), row.name, self.suffix)


@dataclass(frozen=True)
class ExportRead(Read):
    """All estimates as a file."""

    format: ExportFormat

    def look(self, store: Store, row: Row[Any], connection: Connection) -> bytes:
        """The file."""
        latest_epoch(row, None)
        result = session_result(store, row, connection)
        if self.format == "netcdf":
            return result_file(result)
        frame = json.loads(row.config)["start_frame"]
        document = map_document(result, frame)
        if self.format == "mcap":
            return mcap_file(result, document, (frame or {}).get("heading_rad", 0.0))
        rows = zip(result.time_s.tolist(), document["track_m"], strict=True)
        return tum_text((time_s, x, y) for time_s, (x, y) in rows).encode()


@dataclass(frozen=True)
class MeasurementsRead(Read):
    """The measurement log as a file."""

    def look(self, store: Store, row: Row[Any], connection: Connection) -> bytes:
        """The file."""
        return measurements_file(store, row, connection)


def check_smoothable(row: Row[Any], max_epochs: int) -> None:
    """Raise ConflictError if a session has no epoch yet, TooLargeError if it has too many to be smoothed."""
    latest_epoch(row, None)
    if row.next_epoch > max_epochs:
        raise TooLargeError(
            f"expected a session of at most {max_epochs} epochs to smooth, it has {row.next_epoch}"
        )


@dataclass(frozen=True)
class SmoothRead(Read):
    """The run smoothed, JSON."""

    lag: int
    max_epochs: int

    def look(self, store: Store, row: Row[Any], connection: Connection) -> str:
        """The document."""
        check_smoothable(row, self.max_epochs)
        measured = session_measurements(store, row, connection)
        start_frame = json.loads(row.config)["start_frame"]
        return smoothed_document(measured, session_result(store, row, connection), start_frame, self.lag)
