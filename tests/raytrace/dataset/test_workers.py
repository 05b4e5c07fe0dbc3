"""Who makes the shards does not show in them."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from estimator.dataset import Dataset
from estimator.errors import WorkerLostError
from estimator.executors import open_workers
from raytrace.dataset.generate import generate
from raytrace.dataset.output import Output
from raytrace.plan.files import updated
from raytrace.plan.floorplan import FloorPlan

Digests = Callable[[Path], dict[str, str]]


def test_two_processes_write_the_bytes_of_one(
    short_plan: FloorPlan, cut: Output, tmp_path: Path, digests: Digests
) -> None:
    """Spawned ray tracers, finishing in whatever order, make every file as this one does, manifest too."""
    short_plan = updated(short_plan, {"tracing.engine": "sionna"})
    told: list[tuple[int, int, str]] = []
    with open_workers(jobs=2) as crew:
        generate(short_plan, tmp_path / "room", 1, lambda *now: told.append(now), output=cut, crew=crew)
    alone = generate(short_plan, tmp_path / "alone", 1, output=cut).dataset
    assert digests(tmp_path / "room") == digests(alone.path)
    assert [done for done, _, _ in told] == [0, 10, 20, 30, 40]
    assert "epochs/s" in told[-1][2]
    assert told[-1][2].endswith("0:00 left")


def test_a_cluster_writes_the_bytes_of_one(
    sharded: Dataset, short_plan: FloorPlan, cut: Output, tmp_path: Path, digests: Digests
) -> None:
    """The same through a Dask scheduler with two workers, to which tasks travel by network."""
    distributed = pytest.importorskip("distributed", reason="Dask (the extra cluster) is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Dask's own
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            open_workers(scheduler=cluster.scheduler_address) as crew,
        ):
            assert crew.count == 2
            generate(short_plan, tmp_path / "room", 1, output=cut, crew=crew)
    assert digests(tmp_path / "room") == digests(sharded.path)


def test_a_worker_that_is_killed_is_told(
    short_plan: FloorPlan, cut: Output, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the system kills a worker, the remedy is in the message and nothing hangs."""
    monkeypatch.setattr("raytrace.dataset.generate.make_shard", _die)
    with open_workers(2) as crew, pytest.raises(WorkerLostError, match="fewer --jobs") as caught:
        generate(short_plan, tmp_path / "room", 1, output=cut, crew=crew)
    assert caught.value.__notes__ == ["go on with --resume"]


def _die(*_: object, **__: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)
