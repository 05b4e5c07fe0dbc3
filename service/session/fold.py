"""A session's state as the fold of its measurement log.

The same functions serve a request (a few epochs on top of a snapshot), a rebuild (all
epochs from the start) and ``hapslam service verify``; they run in the worker processes
and know neither the database nor HTTP.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.errors import ConfigurationError, FileFormatError, InputError
from estimator.measurements import Epoch, GaussianVrp, MeasurementSet
from estimator.slam.protocol import Engine, Prior, epoch_rng
from estimator.threads import one_blas_thread
from service.messages.documents import dump, estimate_document, read_epoch, read_sweep
from service.messages.packed import pack_estimate
from service.session.state_cache import StateCache
from service.storage.folded import Folded

if TYPE_CHECKING:
    from service.session.tasks import TaskContext

__all__ = [
    "ForgottenError",
    "Job",
    "NotPromptError",
    "digest",
    "engine_of",
    "fold",
    "measurement_set",
]

_LARGEST_COUNT = 2_000  # of hypotheses, epochs and so on: what a noise model may ask for


@dataclass(frozen=True)
class Job:
    """Epochs to take into a session.

    Parameters
    ----------
    session_id : str
        The session.
    config : str
        Its configuration, JSON.
    sweeps : tuple of str
        Its sweeps, as in the log; looked at if there is no snapshot.
    snapshot : bytes or None
        The state to start from; None for the state before the first epoch, or for one that the
        worker may remember.
    epochs : tuple of str
        The epochs that follow, as in the log.
    remembered : bytes, optional
        Digest of the snapshot to start from, instead of the snapshot.
    prompt_s : float, optional
        Processor time after which it is given up if more than one epoch is left; by default it is finished.
    """

    session_id: str
    config: str
    sweeps: tuple[str, ...]
    snapshot: bytes | None
    epochs: tuple[str, ...]
    remembered: bytes | None = None
    prompt_s: float | None = None

    def run(self, context: TaskContext) -> Folded:
        """Fold it; see :func:`fold`."""
        return fold(self, context.cache, context.begin_step)


class ForgottenError(Exception):
    """The worker does not remember the state; it needs the snapshot."""


class NotPromptError(Exception):
    """The job takes longer than was thought; another worker should do it."""


def digest(snapshot: bytes) -> bytes:
    """SHA-256 of a snapshot."""
    return hashlib.sha256(snapshot).digest()


def measurement_set(config: Mapping[str, Any], walls: Sequence[GaussianVrp] = ()) -> MeasurementSet:
    """A session's configuration and walls in the estimator's terms, without epochs."""
    known = config.get("known_anchors_m")
    model, nr = dict(config["measurement_model"]), config.get("nr") or {}
    if nr.get("clock") == "free":
        model.setdefault("clock_free_std_m", nr["clock_std_m"])
    return MeasurementSet(
        anchors=tuple(config["anchors"]),
        walls=tuple(walls),
        epochs=(),
        carrier_hz=config["carrier_hz"],
        settings={"measurement_model": model},
        known_anchors_m=None if known is None else np.array(known),
        max_speed_m_s=config.get("max_speed_m_s"),
        echo_bias_std_m=config.get("echo_bias_std_m"),
    )


def engine_of(config: Mapping[str, Any]) -> Engine:
    """The engine of a session.

    Raises
    ------
    ConfigurationError
        If the method, the engine or the noise model is none that the estimator knows, or
        the noise model asks for more than a service can give.
    """
    from estimator.slam.run import config_for, engine_for  # slow to import, and not needed to begin

    model = config_for(measurement_set(config), engine=config["engine"])
    plain = measurement_set({**config, "measurement_model": {}})
    defaults = config_for(plain, engine=config["engine"]).flat()
    for name, value in model.flat().items():
        counts = isinstance(defaults[name], int) and not isinstance(defaults[name], bool)
        if counts and name in config["measurement_model"]:
            whole = isinstance(value, int) and not isinstance(value, bool)
            if not whole or value > _LARGEST_COUNT:
                raise ConfigurationError(
                    f"measurement_model.{name}: expected an integer to {_LARGEST_COUNT}, got {value}"
                )
    return engine_for(config["method"], config["engine"], model)


@one_blas_thread()
def fold(
    job: Job, cache: StateCache | None = None, begin_step: Callable[[str], None] = lambda what: None
) -> Folded:
    """Take a job's epochs into its session's state, as a batch run would.

    Parameters
    ----------
    job : Job
        The session and what is new.
    cache : StateCache, optional
        Saves reading the snapshot again.
    begin_step : callable, optional
        Told before each epoch what is about to be stepped.

    Raises
    ------
    InputError
        If the engine cannot take an epoch, or its estimates are not finite.
    FileFormatError
        If the snapshot is damaged, or of another version of the engine.
    ForgottenError
        If the state to start from is given by its digest and not in the cache.
    NotPromptError
        If it takes more processor time than ``job.prompt_s``.
    """
    config, engine = _configured(job.config)
    state = None if job.snapshot is None else _loaded(engine, job.snapshot)
    if job.remembered is not None:
        state = cache.get(job.session_id, job.remembered) if cache is not None else None
        if state is None:
            raise ForgottenError
    rows: list[dict[str, Any]] = []
    integrity = "unknown"
    begin = time.thread_time()  # not the clock's: on a busy machine nothing would be prompt
    try:
        if state is None:
            walls = [wall for sweep in job.sweeps for wall in read_sweep(sweep)]
            prior = replace(Prior.of(measurement_set(config, walls)), sweeps=_begins_with_a_sweep(job.epochs))
            state = engine.start(prior, epoch_rng(config["seed"], -1))
        for text in job.epochs:
            if rows and job.prompt_s is not None and time.thread_time() - begin > job.prompt_s:
                raise NotPromptError
            epoch = read_epoch(text)
            begin_step(_described(epoch))
            state = engine.step(state, epoch, epoch_rng(config["seed"], epoch.index))
            estimate = engine.estimate(state)
            integrity = estimate.integrity.state
            document = estimate_document(epoch.index, epoch.time_s, config["anchors"], estimate)
            rows.append(_row(document) | {"packed": pack_estimate(epoch.index, epoch.time_s, estimate)})
    except (ArithmeticError, np.linalg.LinAlgError, IndexError) as error:
        raise InputError(f"the {engine.name} engine cannot take these measurements: {error}") from error
    snapshot = engine.save(state)
    sha256 = digest(snapshot)
    if cache is not None:
        cache.put(job.session_id, sha256, state)
    return Folded(snapshot, sha256, tuple(rows), time.thread_time() - begin, integrity)


def _begins_with_a_sweep(epochs: Sequence[str]) -> bool:
    return bool(epochs) and bool(read_epoch(epochs[0]).sweep)


def _loaded(engine: Engine, snapshot: bytes) -> Any:
    """The state in a snapshot; whatever keeps it from being read, the log can give it anew."""
    try:
        return engine.load(snapshot)
    except MemoryError:
        raise
    except Exception as error:
        raise FileFormatError(f"snapshot: expected a state of the {engine.name} engine: {error}") from error


def _described(epoch: Epoch) -> str:
    paths = sum(len(entry) for entry in epoch.paths)
    return f"epoch {epoch.index} ({len(epoch.paths)} anchors, {paths} paths)"


@lru_cache(maxsize=256)
def _configured(text: str) -> tuple[Mapping[str, Any], Engine]:
    """A session's configuration and engine; both are only read."""
    config = json.loads(text)
    return config, engine_of(config)


def _row(document: dict[str, Any]) -> dict[str, Any]:
    """A row of ``estimates``; raises InputError where a figure is not finite."""
    agent = document["agent"]
    (x, y), covariance = agent["position_m"], agent["covariance"]
    try:
        text = dump(document)
    except ValueError as error:
        raise InputError(
            f"epoch {document['epoch']}: expected measurements that the engine can explain, "
            "its estimates would not be finite numbers"
        ) from error
    return {
        "epoch": document["epoch"],
        "time_s": document["time_s"],
        "x_m": x,
        "y_m": y,
        "variance_x_m2": covariance[0][0],
        "covariance_xy_m2": covariance[0][1],
        "variance_y_m2": covariance[1][1],
        "rotation_std_rad": document["rotation_std_rad"],
        "hypotheses": document["hypotheses"],
        "walls": len(document["walls"]),
        "document": text,
    }
