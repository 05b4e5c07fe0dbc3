"""One shard of a dataset: some successive epochs, traced, summed, noised and written.

What a shard holds follows from the plan, the seed and its place alone, so it can be
made anywhere, in any order, and again: the bytes are the same. The noise of the passive
channels and of the echo, timing jitter and calibration errors come from separate
streams of the seed, as do leakage and its phase noise; of each stream, shard ``k`` uses what lies
``k`` jumps ahead (a jump is longer than any shard), except for what the device is, calibration and
coupling, and for odometry, which all shards share.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import write_shard
from estimator.errors import BackendError
from estimator.threads import one_blas_thread
from raytrace.dataset.odometry import with_odometry
from raytrace.dataset.output import Output
from raytrace.dataset.shards import echo_shard, passive_shard, paths_shard
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.bent_tracing import trace_bent
from raytrace.propagation.engine import Scene, scene_of, specular_paths, traced
from raytrace.propagation.passive import TraceReport
from raytrace.propagation.paths import DIFFRACTION, REFRACTION, PathList, PathSet
from raytrace.propagation.shadowing import shadowed
from raytrace.radio.channel import add_noise
from raytrace.radio.echo import EchoSweep, sweep_echo
from raytrace.radio.impairments import jitter, miscalibrate
from raytrace.radio.leakage import leakage_response
from raytrace.radio.reception import receive
from raytrace.radio.scattering import diffuse_response
from raytrace.radio.targets import target_paths

__all__ = ["STAGES", "MadeShard", "Progress", "ShardTask", "Stages", "make_shard"]

Progress = Callable[[int, int, str], None]

STAGES = ("starting the ray tracer", "tracing paths", "summing channels", "sweeping beams", "writing")

_STREAMS = ("passive", "echo", "timing", "calibration", "coupling", "leakage", "odometry")
# The ray tracer serves one thread of a process at a time.
_TRACER = threading.Lock()


@dataclass(frozen=True)
class ShardTask:
    """All that it takes to make a shard.

    Parameters
    ----------
    plan : FloorPlan
        What to trace.
    seed : int
        Seed of the dataset.
    output : Output
        What to write.
    index : int
        Number of the shard, in the names of its files.
    first, stop : int
        Its epochs, ``first`` to ``stop - 1``.
    """

    plan: FloorPlan
    seed: int
    output: Output
    index: int
    first: int
    stop: int

    @property
    def epochs(self) -> NDArray[np.int64]:
        """The epochs of the shard."""
        return np.arange(self.first, self.stop, dtype=np.int64)

    @property
    def sweeps(self) -> tuple[int, ...]:
        """Epochs of the beam sweeps that fall into the shard."""
        return tuple(epoch for epoch in self.plan.sweep_epochs if self.first <= epoch < self.stop)

    def stream(self, name: str, shared: bool = False) -> np.random.Generator:
        """Random numbers of one of the streams, those of this shard or those that all share."""
        sequence = np.random.SeedSequence(self.seed, spawn_key=(_STREAMS.index(name),))
        return np.random.Generator(np.random.PCG64(sequence).jumped(0 if shared else self.index))


@dataclass(frozen=True)
class MadeShard:
    """What :func:`make_shard` made.

    Parameters
    ----------
    first, stop : int
        Its epochs.
    entries : tuple of dict
        Entries of its files for the manifest. That of the paths has in ``check`` how they
        compare with the image method, and in ``others`` how many bend, once or more often; that of
        the echo has in ``returns`` what was heard, that of the channels in ``diffuse`` how many diffuse
        paths they contain.
    seconds : dict of str to float
        Wall-clock seconds of each stage.
    """

    first: int
    stop: int
    entries: tuple[dict[str, Any], ...]
    seconds: dict[str, float]


class Stages:
    """Times the stages of a shard and tells the progress."""

    def __init__(self, progress: Progress | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Run a stage."""
        done = len(self.seconds)
        if self._progress is not None:
            self._progress(done, len(STAGES), STAGES[done])
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start

    def finished(self) -> None:
        """Tell that nothing remains to be done."""
        if self._progress is not None:
            self._progress(len(STAGES), len(STAGES), "done")


@one_blas_thread()
def make_shard(task: ShardTask, folder: Path, stages: Stages | None = None) -> MadeShard:
    """Trace the epochs of a shard and write its files.

    Parameters
    ----------
    task : ShardTask
        Which.
    folder : Path
        The dataset's directory; files of the same names are replaced.
    stages : Stages, optional
        What to tell of the progress.

    Raises
    ------
    BackendError
        If the ray tracer cannot run on this machine, or the folder is not there.
    """
    stages = Stages() if stages is None else stages
    if not folder.is_dir():
        raise BackendError(f"{folder}: expected a folder that all workers share, it is not there")
    plan, name = task.plan, "{}-" + f"{task.index:05d}.nc"
    place = {"epochs": [task.first, task.stop]}
    with _TRACER:
        with stages("scene"):
            radio = scene_of(plan, plan.radio.carrier_hz)
        with stages("passive"):
            positions = plan.track()[task.first : task.stop]
            paths, report = specular_paths(
                plan, radio, plan.anchors_m(), positions, plan.tracing.depth, polarised=plan.polarised
            )
            others: dict[str, int] = {}
            if plan.tracing.bends:
                bent, once = trace_bent(plan, traced(radio), positions)
                paths = PathSet.build(
                    PathList.concatenate([paths.flat(), bent]), len(positions), len(plan.anchors)
                )
                others = _counts(bent, once)
            if plan.has_bodies:
                weaker = shadowed(plan, paths.flat(), positions, plan.times_s()[task.epochs])
                paths = PathSet.build(weaker, len(positions), len(plan.anchors))
        with stages("channels"):
            response = receive(plan, paths, task.epochs)
            if plan.has_bodies:
                scattered, shift_hz = target_paths(plan, task.epochs)
                response = response + receive(plan, scattered, task.epochs, shift_hz)
            diffuse_paths = 0
            if plan.scatters:
                diffuse, diffuse_paths = diffuse_response(plan, traced(radio), task.epochs)
                response = response + diffuse
            response = jitter(
                response,
                plan.radio.grid(),
                plan.radio.timing_jitter_s,
                task.stream("timing"),
                plan.clock_errors_s()[task.epochs],
            )
            received = add_noise(response, plan.radio.noise_variance(), task.stream("passive"))
        with stages("echo"):
            sweep, heard = _sweep(task, radio)
    with stages("write"):
        shard = passive_shard(plan, received, task.epochs, task.output.content)
        shard = with_odometry(shard, plan, task.stream("odometry", shared=True))
        entries = [
            write_shard(
                folder, "passive", name.format("passive"), shard, True, **place, diffuse=diffuse_paths
            )
        ]
        if sweep is not None:
            shard = echo_shard(plan, heard, task.sweeps)
            facts = {"returns": sweep.as_dict()}
            entries.append(write_shard(folder, "echo", name.format("echo"), shard, True, **place, **facts))
        shard = paths_shard(plan, paths, task.epochs)
        facts = {"check": report.as_dict(), **({"others": others} if plan.tracing.bends else {})}
        entries.append(write_shard(folder, "paths", name.format("paths"), shard, True, **place, **facts))
    return MadeShard(task.first, task.stop, tuple(entries), dict(stages.seconds))


def _counts(paths: PathList, once: TraceReport) -> dict[str, int]:
    """How many paths refract somewhere, how many diffract, and what is missing of those that bend once."""
    kinds = (("refracted", REFRACTION), ("diffracted", DIFFRACTION))
    counts = {name: int(np.sum((paths.interactions == kind).any(axis=1))) for name, kind in kinds}
    return {**counts, "bent_once": once.expected, "bent_once_missing": once.missing}


def _sweep(task: ShardTask, radio: Scene) -> tuple[EchoSweep | None, NDArray[np.complex128]]:
    """The sweeps of a shard, if there are any, without and with calibration errors and noise."""
    plan = task.plan
    if not task.sweeps:
        return None, np.empty((0, 0, 0), dtype=np.complex128)
    same = plan.echo.carrier_hz == plan.radio.carrier_hz
    sweep = sweep_echo(plan, radio if same else None, task.sweeps)
    heard = sweep.response
    if plan.echo.isolation_db is not None:
        streams = task.stream("coupling", shared=True), task.stream("leakage")
        heard = heard + leakage_response(plan.echo, plan.echo.isolation_db, len(heard), *streams)
    response = miscalibrate(
        heard,
        plan.echo.grid(),
        plan.echo.gain_error_db,
        float(np.deg2rad(plan.echo.phase_error_deg)),
        plan.echo.range_error_m,
        task.stream("calibration", shared=True),
    )
    return sweep, add_noise(response, plan.echo.noise_variance(), task.stream("echo"))
