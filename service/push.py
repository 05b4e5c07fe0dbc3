"""`hapslam push`: a measurement file sent to a service, to be taken up where it was broken off."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from estimator.dataset import open_dataset
from estimator.errors import InputError
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet, load_measurements
from service.client import Client

__all__ = ["Pushed", "epoch_entry", "push_file", "session_entry", "sweep_entry", "truth_entry"]

_COLUMNS = tuple(entry.name for entry in fields(AnchorPaths))


@dataclass(frozen=True)
class Pushed:
    """What was sent.

    Parameters
    ----------
    session : str
        The session's id.
    epochs : int
        Epochs in the file.
    new : int
        How many of them the session did not have yet.
    """

    session: str
    epochs: int
    new: int


def session_entry(measurements: MeasurementSet, **more: Any) -> dict[str, Any]:
    """The request that makes a session for a measurement set."""
    known = measurements.known_anchors_m
    return {
        "anchors": list(measurements.anchors),
        "carrier_hz": measurements.carrier_hz,
        "measurement_model": dict(measurements.settings.get("measurement_model", {})),
        "known_anchors_m": None if known is None else known.tolist(),
        **more,
    }


def sweep_entry(measurements: MeasurementSet) -> dict[str, Any]:
    """The request that gives a session the walls sensed at the start."""
    return {"sweep": 0, "walls": _walls(measurements.walls)}


def _walls(walls: Iterable[GaussianVrp]) -> list[dict[str, Any]]:
    return [{"vrp_m": wall.mean_m.tolist(), "covariance_m2": wall.covariance_m2.tolist()} for wall in walls]


def epoch_entry(anchors: tuple[str, ...], epoch: Epoch) -> dict[str, Any]:
    """An epoch as ``POST .../epochs`` takes it; no figure is changed."""
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
    }


def push_file(
    client: Client,
    file: Path,
    session: str | None = None,
    name: str | None = None,
    method: str = "hybrid",
    engine: str = "gaussian",
    seed: int = 1,
    batch: int = 50,
    truth: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Pushed:
    """Send a measurement file.

    Parameters
    ----------
    client : Client
        The service.
    file : Path
        Measurement file.
    session : str, optional
        Session to go on with; what it has already is not sent again.
    name, method, engine, seed
        Of a new session.
    batch : int
        Epochs in a request.
    truth : Path, optional
        Dataset whose truth the page is to show.
    progress : callable, optional
        Called with (epochs done, epochs in all).

    Raises
    ------
    FileFormatError, InputError
        If the file or the truth cannot be read or used.
    ServiceUnavailableError, UnexpectedAnswerError
        If the service cannot be reached or refuses.
    """
    measurements = load_measurements(file)
    epochs = measurements.epochs
    if [epoch.index for epoch in epochs] != list(range(len(epochs))):
        raise InputError(f"{file}: expected epochs numbered 0, 1, 2, ... without a gap")
    known = None if truth is None else truth_entry(truth)
    if session is None:
        request = session_entry(measurements, name=name or file.stem, method=method, engine=engine, seed=seed)
        if known is not None:
            request["start_frame"] = known["start_frame"]
        session = client.create_session(request)
    state = client.session(session)
    if known is not None:
        client.put_truth(session, known)
    if state["next_sweep"] == 0 and state["next_epoch"] == 0:
        client.post_sweep(session, sweep_entry(measurements))
    begin = min(state["next_epoch"], len(epochs))
    if begin:  # the last known epoch once more: the service compares it with what it has
        client.post_epochs(session, [epoch_entry(measurements.anchors, epochs[begin - 1])])
    for first in range(begin, len(epochs), batch):
        part = epochs[first : first + batch]
        client.post_epochs(session, [epoch_entry(measurements.anchors, epoch) for epoch in part])
        if progress is not None:
            progress(first + len(part), len(epochs))
    return Pushed(session, len(epochs), len(epochs) - begin)


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
