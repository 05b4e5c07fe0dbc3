"""The shipped rooms, traced once for all tests."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from estimator.dataset import Dataset
from raytrace.dataset.generate import generate
from raytrace.dataset.output import Output
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.passive import TraceReport, trace_passive
from raytrace.propagation.paths import PathSet
from raytrace.propagation.scene import RadioScene, build_scene

Traced = tuple[FloorPlan, RadioScene, PathSet, TraceReport]


def _trace(name: str) -> Traced:
    plan = load_floorplan(name)
    radio = build_scene(plan, plan.radio.carrier_hz)
    return plan, radio, *trace_passive(plan, radio)


@pytest.fixture(scope="session")
def l_room() -> Traced:
    """Plan, scene, traced paths and report of the L-room."""
    return _trace("l-room")


@pytest.fixture(scope="session")
def hard_room() -> Traced:
    """The same of the L-room with floor, ceiling and scattering."""
    return _trace("l-room-hard")


@pytest.fixture(scope="session")
def short_plan() -> FloorPlan:
    """The L-room with forty epochs, three sweeps and two antennas, by the image method."""
    changes = {"agent.epochs": 40, "echo.sweep_epochs": [0, 12, 39], "radio.agent_array.elements": 2}
    return updated(load_floorplan("l-room"), {**changes, "tracing.engine": "images"})


@pytest.fixture(scope="session")
def cut() -> Output:
    """Shards of ten epochs, with frequency and impulse responses."""
    return Output(shard_epochs=10, content="both")


@pytest.fixture(scope="session")
def sharded(short_plan: FloorPlan, cut: Output, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The short walk as a dataset of four shards, made at once by one process; not to be changed."""
    return generate(short_plan, tmp_path_factory.mktemp("sharded") / "room", seed=1, output=cut).dataset


@pytest.fixture(scope="session")
def digests() -> Callable[[Path], dict[str, str]]:
    """SHA-256 of every file of a folder, by name."""

    def hashes(folder: Path) -> dict[str, str]:
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}

    return hashes


class _OpenedFiles:
    """Names of all files that are opened within; an audit hook cannot be taken away, only silenced."""

    def __enter__(self) -> list[str]:
        self.names: list[str] | None = []
        sys.addaudithook(self._hear)
        return self.names

    def __exit__(self, *_: object) -> None:
        self.names = None

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("open", "subprocess.Popen", "os.system", "exec") and self.names is not None:
            self.names.append(str(arguments[0]))


@pytest.fixture(scope="session")
def opened_files() -> Callable[[], AbstractContextManager[list[str]]]:
    """Listens to the files that are opened, and the programs that are started, within a context."""
    return _OpenedFiles
