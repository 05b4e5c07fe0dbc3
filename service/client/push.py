"""`hapslam push`: a measurement file sent to a service, to be taken up where it was broken off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from estimator.errors import InputError
from estimator.measurement_files import load_measurements
from service.client.calls import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry, truth_entry

__all__ = ["Pushed", "push_file"]


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
