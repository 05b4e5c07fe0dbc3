"""What SLAM costs: steps, runs in processes, and growth with anchors, walls and paths."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.executors import open_workers
from estimator.experiments.cases import Case
from estimator.experiments.runs import Run, perform
from estimator.measurements import MeasurementSet
from estimator.simulate import SimulationConfig
from estimator.slam import Prior, epoch_rng
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.run import config_for, engine_for
from estimator.threads import one_blas_thread
from service.bench.floors import association_s, joint_update_s
from service.bench.resident import PeakMemory
from service.bench.rooms import EPOCHS, many_anchors, many_paths, many_walls, paper_room, request
from service.bench.rows import Row

__all__ = ["growth_rows", "request_rows", "step_rows"]

_FIRST = 8  # epochs with many hypotheses
_SEEDS = 5
_RUNS, _PROCESSES = 100, 2
_PARTICLES = 100_000
_JOINT = 23, 12  # states of agent, anchors and walls, and paths of an epoch, in the middle of Fig. 13's walk
_STEP_BAR_MS, _FIRST_BAR_MS, _RUNS_BAR_S = 0.6, 3.0, 15.0
_WORST_BAR_MS, _STEP_BAR_MIB = 100.0, 100.0
_REQUEST, _REQUEST_BAR_S, _REQUEST_BAR_MIB = (64, 64, 200), 3.0, 300.0
_PEER = "belief propagation SLAM of its authors, 1e5 particles (as stated)"
_PEER_MS, _PEER_FEATURES = 293.0, 11  # a step with two anchors


@dataclass(frozen=True)
class _Growth:
    """A size that grows, and the measurements of each."""

    what: str
    sizes: tuple[int, ...]
    measured: Callable[[int], MeasurementSet]


_GROWTHS = (
    _Growth("anchors", (2, 4, 8, 16), many_anchors),
    _Growth("walls", (4, 8, 12, 20), many_walls),
    _Growth("paths of each anchor", (5, 10, 20, 50, 200), many_paths),
)


def step_rows(quick: bool) -> Iterator[Row]:
    """The Gaussian engine's step in Fig. 13's room, its first epochs and its runs; the particle engine's."""
    epochs, seeds = (40, 1) if quick else (EPOCHS, _SEEDS)
    room = paper_room()
    _stepped(room.measure(SimulationConfig(), 0), epochs)  # warm
    taken = 1e3 * np.array(
        [_stepped(room.measure(SimulationConfig(), 1 + i), epochs)[0] for i in range(seeds)]
    )
    name = "gaussian engine, hybrid, Fig. 13"
    floor = 1e3 * joint_update_s(*_JOINT)
    peer = f"floor: one joint update in NumPy, {_JOINT[0]} states, {_JOINT[1]} paths"
    mean = float(taken.mean())
    yield Row(f"{name}: step, mean of {epochs}", mean, "ms", _STEP_BAR_MS, peer, floor)
    first = float(np.median(taken[:, :_FIRST], axis=0).max())
    yield Row(f"{name}: dearest of the first {_FIRST} steps", first, "ms", _FIRST_BAR_MS, peer, floor)
    if not quick:
        yield _runs(mean)
    for method in ("hybrid", "va"):
        yield _particle_step(method, 6 if quick else 40)


def growth_rows(quick: bool) -> Iterator[Row]:
    """Median and worst step, and what memory a step needs, as one size grows and the others stay."""
    epochs = 6 if quick else 40
    for growth in _GROWTHS:
        smallest = growth.sizes[0]
        least: tuple[float, ...] = ()
        for size in growth.sizes[: 2 if quick else None]:
            seconds, mib = _stepped(growth.measured(size), epochs)
            found = 1e3 * float(np.median(seconds)), 1e3 * float(seconds.max()), float(mib.max())
            least = least or found
            name, peer = f"growth, {size} {growth.what}: step", f"in proportion to {smallest}"
            linear = [value * size / smallest for value in least]
            yield Row(f"{name}, median of {epochs}", found[0], "ms", None, peer, linear[0])
            yield Row(f"{name}, worst", found[1], "ms", _WORST_BAR_MS, peer, linear[1])
            yield Row(f"{name}, peak memory", found[2], "MiB", _STEP_BAR_MIB)


def request_rows() -> Iterator[Row]:
    """A request that no measurement is like, in a process of its own: CPU time and memory of all of it."""
    with open_workers(_PROCESSES) as workers:
        seconds, mib = next(iter(workers.unordered(_asked, [_REQUEST])))
    walls, anchors, paths = _REQUEST
    name = f"request of {walls} walls, {anchors} anchors, {paths} paths of each"
    floor = association_s(walls + 1, paths, anchors)
    peer = "floor: each path compared with each feature once"
    yield Row(f"{name}: CPU time", seconds, "s", _REQUEST_BAR_S, peer, floor)
    yield Row(f"{name}: peak memory of its process", mib, "MiB", _REQUEST_BAR_MIB)


def _stepped(measurements: MeasurementSet, epochs: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """CPU seconds and MiB of each step of the Gaussian engine."""
    engine = engine_for("hybrid", "gaussian", config_for(measurements))
    state = engine.start(Prior.of(measurements), epoch_rng(1, -1))
    memory, taken, needed = PeakMemory(), [], []
    for epoch in measurements.epochs[:epochs]:
        memory.begin()
        begin = time.process_time()
        state = engine.step(state, epoch, epoch_rng(1, epoch.index))
        taken.append(time.process_time() - begin)
        needed.append(memory.growth_mib())
    return np.array(taken), np.array(needed)


def _runs(step_ms: float) -> Row:
    """Whole runs, simulated and judged, in processes: the CPU time of all divided by their number."""
    room, case = paper_room(), Case("hybrid", "gaussian")
    tasks = [Run(room, case, 1 + i, _PARTICLES) for i in range(_RUNS)]
    begin = _family_s()
    with open_workers(_PROCESSES) as workers:
        workers.map(perform, tasks)
    each = (_family_s() - begin) / _PROCESSES
    name = f"{_RUNS} runs of Fig. 13, hybrid, in {_PROCESSES} processes: CPU time of each"
    steps = 1e-3 * step_ms * EPOCHS * _RUNS / _PROCESSES
    return Row(name, each, "s", _RUNS_BAR_S, "floor: their steps alone", steps)


def _family_s() -> float:
    """CPU seconds of this process and of those that it has awaited."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@one_blas_thread()
def _asked(size: tuple[int, int, int]) -> tuple[float, float]:
    """CPU seconds of a request, and the highest memory (MiB) of the process that answers it."""
    small = request(2, 1, 2)
    for measurements in (small, request(*size)):  # the first loads what was compiled
        memory = PeakMemory()
        memory.begin()
        begin = time.process_time()
        engine = engine_for("hybrid", "gaussian", config_for(measurements))
        state = engine.start(Prior.of(measurements), epoch_rng(1, -1))
        engine.estimate(engine.step(state, measurements.epochs[0], epoch_rng(1, 0)))
        seconds, mib = time.process_time() - begin, memory.peak_mib()
    return seconds, mib


def _particle_step(method: str, epochs: int) -> Row:
    """Steps of the particle engine, beside what its peer would take for as many features.

    A feature is what one anchor may be heard over: the anchor itself, and each wall or virtual anchor.
    """
    measurements = paper_room().measure(SimulationConfig(), 1, know_anchors=True)
    config = config_for(measurements, ParticleConfig.of(particles=_PARTICLES))
    engine = engine_for(method, "particle", config)
    state = engine.start(Prior.of(measurements), epoch_rng(1, -1))
    taken: list[tuple[float, int]] = []
    for epoch in measurements.epochs[:epochs]:
        begin = time.process_time()
        state = engine.step(state, epoch, epoch_rng(1, epoch.index))
        owners = state.features.owner
        taken.append(
            (time.process_time() - begin, int(np.sum(np.where(owners < 0, len(epoch.paths), 1))) + 2)
        )
    seconds, features = np.median(taken[epochs // 2 :], axis=0).tolist()
    return Row(
        f"particle engine, {method}, {_PARTICLES:.0e} particles, {features:.0f} features: step",
        1e3 * seconds,
        "ms",
        0.5 * _PEER_MS * features / _PEER_FEATURES,
        _PEER,
        _PEER_MS * features / _PEER_FEATURES,
    )
