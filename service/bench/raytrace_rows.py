"""What tracing costs: paths beside one solver call per position, and a long dataset's time, size and memory.

Times of paths are CPU times of one process, which traces in one thread, so that a busy machine counts for
little; the image method's check is part of ours, and not of the naive way. That of the dataset is wall-clock.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimator.errors import BackendError
from service.bench.rows import Row, cpu_s

if TYPE_CHECKING:
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["rows"]

_PATHS = "paths of a position and anchor"
_ALONE = "image method alone"
_TIMES_FASTER = 50.0
_IMAGES_FASTER = 3.0
_SECOND_ORDER_BAR_MS = 0.5
_MEMORY_BAR_GIB = 3.0
_ANCHORS_M = ((68.0, 6.0, 2.5), (42.0, 36.0, 2.5), (5.0, 5.0, 2.5), (66.0, 57.0, 2.5))
_STEP_M = 0.05
_BLOCK = 2**24  # bytes


def rows(quick: bool) -> Iterator[Row]:
    """Measure row by row; nothing where the ray tracer is not installed.

    Parameters
    ----------
    quick : bool
        Fewer positions: some forty seconds rather than some minutes and 3 GB of temporary files.
    """
    if find_spec("sionna") is None:
        return
    try:
        yield from _passive(200 if quick else 1461, 10 if quick else 60)
        yield from _scenes(100 if quick else 1461)
        for engine in ("sionna", "images"):
            yield from _dataset(500 if quick else 100_000, engine)
    except BackendError:  # `hapslam doctor` tells why
        return


def _passive(positions: int, sample: int) -> Iterator[Row]:
    """Paths of the L-room's walk, two anchors; each depth traced once before, to compile."""
    from raytrace.plan.files import updated

    room = _walked("l-room", positions)
    what = f"{positions} positions x {len(room.anchors)} anchors, image oracle on"
    ours = {depth: _traced_ms(updated(room, {"tracing.depth": depth})) for depth in (1, 2)}
    naive = _naive_ms(room, sample)
    peer = f"a solver call per position, no oracle (sample of {sample})"
    yield Row(f"{_PATHS}, depth 1: {what}", ours[1], "ms", naive / _TIMES_FASTER, peer, naive)
    alone = _images_ms(updated(room, {"tracing.depth": 2}))
    yield Row(f"{_PATHS}, depth 2: {what}", ours[2], "ms", _SECOND_ORDER_BAR_MS, _ALONE, alone)


def _scenes(positions: int) -> Iterator[Row]:
    """Paths of the other shipped scenes, depth 2, traced; and of all by the image method alone."""
    from raytrace.plan.files import shipped_scenes

    images = []
    for name in shipped_scenes():
        plan = _walked(name, positions)
        what = f"{positions} positions x {len(plan.anchors)} anchors"
        traced, alone = _traced_ms(plan), _images_ms(plan)
        if name != "l-room":
            row = f"{_PATHS}, depth 2, {name}: {what}, image oracle on"
            yield Row(row, traced, "ms", _SECOND_ORDER_BAR_MS, _ALONE, alone)
        row = f"{_PATHS}, depth 2, {name}, image method alone: {what}"
        images.append(Row(row, alone, "ms", traced / _IMAGES_FASTER, "traced", traced))
    yield from images


def _walked(name: str, positions: int) -> FloorPlan:
    """A shipped scene with so many positions at equal steps on its walk, depth 2."""
    from raytrace.plan.files import load_floorplan, updated

    plan = load_floorplan(name)
    step = plan.agent.step_m * (plan.agent.epochs - 1) / positions
    return updated(plan, {"agent.epochs": positions, "agent.step_m": step, "tracing.depth": 2})


def _traced_ms(plan: FloorPlan) -> float:
    """CPU time per position and anchor."""
    from raytrace.propagation.passive import trace_passive
    from raytrace.propagation.scene import build_scene

    radio = build_scene(plan, plan.radio.carrier_hz)
    seconds = cpu_s(lambda: trace_passive(plan, radio), 1)
    return 1e3 * seconds / (plan.agent.epochs * len(plan.anchors))


def _images_ms(plan: FloorPlan) -> float:
    """CPU time per position and anchor of the image method, compiled before."""
    from raytrace.propagation.images import image_paths

    image_paths(plan, plan.track()[:2])
    return 1e3 * cpu_s(lambda: image_paths(plan), 1) / (plan.agent.epochs * len(plan.anchors))


def _naive_ms(plan: FloorPlan, sample: int) -> float:
    """The same for one solver call per position, as a loop over Sionna's devices is written.

    Positions are drawn anew for every run: kernels of earlier ones may lie compiled on disk.
    """
    import sionna.rt as rt

    from raytrace.propagation.scene import build_scene

    scene = build_scene(plan, plan.radio.carrier_hz).scene
    scene.tx_array = scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    for anchor in plan.anchors:
        scene.add(rt.Transmitter(anchor.name, list(anchor.position_m)))
    receiver = rt.Receiver("agent", [0.0, 0.0, 0.0])
    scene.add(receiver)
    solver, rng = rt.PathSolver(), np.random.default_rng()
    places = rng.choice(plan.track(), sample + 1, replace=False) + rng.uniform(0.0, 0.05, (sample + 1, 3))

    def trace(place: NDArray[np.float64]) -> None:
        receiver.position = place.tolist()
        paths = solver(
            scene, max_depth=1, samples_per_src=plan.tracing.samples, synthetic_array=False, refraction=False
        )
        paths.cir(normalize_delays=False, out_type="numpy")

    trace(places[0])
    begin = time.process_time()
    for place in places[1:]:
        trace(place)
    return 1e3 * (time.process_time() - begin) / (sample * len(plan.anchors))


@dataclass(frozen=True)
class _Made:
    """What a dataset took: wall-clock and CPU seconds, peak of resident memory, bytes, and its tones."""

    seconds: float
    cpu_s: float
    peak_kib: int
    size_bytes: int
    tones: int


def _dataset(positions: int, engine: str) -> Iterator[Row]:
    """A whole dataset with channels, in a process of its own, whose memory is read when it is done."""
    with (
        tempfile.TemporaryDirectory(prefix="hapslam-bench-") as folder,
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
    ):
        made = pool.submit(_generated, positions, Path(folder), engine).result()
        written_s = _written_s(Path(folder) / "floor", made.size_bytes)
    what = (
        f"dataset, {positions} positions x {len(_ANCHORS_M)} anchors x {made.tones} tones, depth 2, {engine}"
    )
    yield Row(f"{what}: peak memory", made.peak_kib / 2**20, "GiB", _MEMORY_BAR_GIB)
    yield Row(f"{what}: CPU time", made.cpu_s, "s")
    yield Row(f"{what}: time", made.seconds, "s", None, "floor: writing as many bytes", written_s)
    channels = positions * len(_ANCHORS_M) * made.tones * np.dtype(np.complex64).itemsize
    peer = "floor: its channels, 64 bits each"
    yield Row(f"{what}: size", made.size_bytes / 2**30, "GiB", None, peer, channels / 2**30)


def _generated(positions: int, folder: Path, engine: str) -> _Made:
    """Make a dataset."""
    from raytrace.dataset.generate import generate
    from raytrace.plan.files import updated

    plan = updated(_long_walk(positions), {"tracing.engine": engine})
    begin, begun = time.perf_counter(), time.process_time()
    dataset = generate(plan, folder / "room", seed=1).dataset
    seconds, used = time.perf_counter() - begin, time.process_time() - begun
    size = sum(file.stat().st_size for file in dataset.path.iterdir())
    return _Made(seconds, used, _peak_kib(), size, plan.radio.grid().tones)


def _written_s(file: Path, size: int) -> float:
    """Wall-clock seconds that the disk takes for so many bytes."""
    block = np.random.default_rng(1).bytes(_BLOCK)
    begin = time.perf_counter()
    with file.open("wb") as stream:
        for _ in range(max(size // _BLOCK, 1)):
            stream.write(block)
        stream.flush()
        os.fsync(stream.fileno())
    return time.perf_counter() - begin


def _long_walk(positions: int) -> FloorPlan:
    """The L-room with four anchors, its walk gone to and fro as often as it takes, in steps of 5 cm."""
    from raytrace.plan.files import load_floorplan, updated

    room = load_floorplan("l-room")
    way = room.agent.waypoints_m
    once_m = (room.agent.epochs - 1) * room.agent.step_m
    walk = list(way)
    for lap in range(int(positions * _STEP_M / once_m) + 1):
        walk += (way[::-1] if lap % 2 == 0 else way)[1:]
    return updated(
        room,
        {
            "name": "l-room-long",
            "anchors": [
                {"name": f"pa{number}", "position_m": list(place)}
                for number, place in enumerate(_ANCHORS_M, 1)
            ],
            "agent.waypoints_m": walk,
            "agent.step_m": _STEP_M,
            "agent.epochs": positions,
        },
    )


def _peak_kib() -> int:
    """Peak of this process's resident memory; that of Python's starter is not counted in, unlike rusage's."""
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1])
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
