"""The first work of a process, before anyone waits for it: code is compiled or loaded by it.

While a file of a stranger is read no other can be opened (:mod:`service.session.confinement`), the files of
modules included: whatever reading imports has to be imported before.
"""

from __future__ import annotations

import codecs
import io
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from estimator.arrays import BeamSet
from estimator.errors import HapslamError
from estimator.measurement_files import save_measurements
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.slam.methods import PAIRS
from service.messages.documents import dump, epoch_text, sweep_text
from service.messages.session_requests import SessionRequest
from service.messages.si_epoch import SiEpoch
from service.messages.terms import SessionTerms
from service.session.beam_sweeps import EchoTask
from service.session.entries import EpochLimits
from service.session.example import example
from service.session.files import FileTask
from service.session.fold import Job, fold, measurement_set
from service.session.raw_channels import ChannelsTask
from service.session.tasks import TaskContext

__all__ = ["warm_up_methods", "warm_up_reading", "warm_up_smoothing", "warm_up_steps"]

_EPOCHS = 40  # of the example: anchors are found in them, and walls are born
_FEW = 12  # of them: enough for births and sweeps
_CODECS = ("ascii", "cp437", "latin-1", "utf-8", "utf-16", "utf-32", "idna", "unicode_escape")
_TONES, _BEAMS = 64, 16


def warm_up_steps() -> None:
    """Step the beginning of the shipped example."""
    config, walls, epochs = _begun()
    fold(Job("", dump(config), (sweep_text(0, walls),), None, tuple(map(epoch_text, epochs))))


def warm_up_methods() -> None:
    """Step the example's first epochs with every method and engine, and with sweeps on the way.

    So that what few sessions need is compiled before, too, in a process that nobody waits for.
    """
    config, walls, epochs = _begun()
    sensed = [replace(epoch, sweep=tuple(walls)) if epoch.index else epoch for epoch in epochs[:_FEW]]
    for method, engine in PAIRS:
        for known in (None, [[10.0, 8.0 * n] for n in range(len(config["anchors"]))]):
            wanted = dump(config | {"method": method, "engine": engine, "known_anchors_m": known})
            with suppress(HapslamError):  # not every method knows the anchors, or can do without
                fold(Job("", wanted, (sweep_text(0, walls),), None, tuple(map(epoch_text, sensed))))


def warm_up_smoothing() -> None:
    """Smooth the beginning of the shipped example, and load what pictures are drawn with."""
    import estimator.evaluation.pictures  # noqa: F401
    from estimator.slam import run_slam
    from estimator.slam.smoothing.refine import refine

    config, walls, epochs = _begun()
    measurements = replace(measurement_set(config, walls), epochs=tuple(epochs))
    refine(measurements, run_slam(measurements, seed=1))


def _begun() -> tuple[dict[str, Any], list[GaussianVrp], list[Epoch]]:
    """Configuration, walls and first epochs of the shipped example."""
    shipped = example(1)
    wanted = SessionRequest.model_validate(shipped["session"])
    walls = [GaussianVrp(wall["vrp_m"], wall["covariance_m2"]) for wall in shipped["sweep"]["walls"]]
    entries = (SiEpoch.model_validate(entry) for entry in shipped["epochs"][:_EPOCHS])
    return (
        wanted.config(),
        walls,
        [entry.estimator_epoch(SessionTerms(tuple(wanted.anchors))) for entry in entries],
    )


def warm_up_reading() -> None:
    """Read a small file of each kind, and one of no kind."""
    import estimator.extract  # noqa: F401 (what datasets are read with)

    for name in _CODECS:
        codecs.lookup(name)
    context, limits, most = TaskContext(), EpochLimits(10, 100, 10), 2**20
    FileTask(_measurements(), most, limits).run(context)
    channels = {"cfr_re": _noise(2, 1, 1, _TONES), "cfr_im": _noise(2, 1, 1, _TONES)}
    axes = {"time_s": np.arange(2.0), "epoch": np.arange(2), "anchor": np.array(["a"])}
    tones = {"tone_offset_hz": np.arange(_TONES) * 1e6}
    ChannelsTask(_npz(channels | axes | tones), ("a",), 28e9, 1.0, None, True, most, limits).run(context)
    echo = {name: _noise(1, _BEAMS, _TONES) for name in ("echo_re", "echo_im")}
    body = _npz(echo | tones | {"sweep_epoch": np.zeros(1, dtype=np.int64)})
    EchoTask(body, 28e9, 1.0, BeamSet(4, 4, _BEAMS), "flash", most).run(context)
    for rubbish in (b"PK\x03\x04", b"\x89HDF\r\n\x1a\n"):
        try:
            FileTask(rubbish + bytes(100), most, limits).run(context)
        except HapslamError:
            continue


def _measurements() -> bytes:
    paths = AnchorPaths(np.full(2, 1e-7), np.full(2, 1e-9), np.full(2, -90.0))
    walls = (GaussianVrp(np.array([8.0, 0.0]), 0.01 * np.eye(2)),)
    with TemporaryDirectory(prefix="hapslam-") as folder:
        file = Path(folder) / "measurements.nc"
        save_measurements(MeasurementSet(("a",), walls, (Epoch(0, 0.0, (paths,), walls),), 28e9), file)
        return file.read_bytes()


def _noise(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.random.default_rng(0).normal(size=shape)


def _npz(arrays: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()
