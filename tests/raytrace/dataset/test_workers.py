"""Who makes the shards does not show in them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from estimator.dataset import Dataset
from estimator.errors import BackendError, ConfigurationError
from raytrace.dataset.generate import generate
from raytrace.dataset.output import Output
from raytrace.dataset.workers import Workers, workers
from raytrace.plan.floorplan import FloorPlan

ROOT = Path(__file__).resolve().parents[3]
Digests = Callable[[Path], dict[str, str]]


def test_two_processes_write_the_bytes_of_one(
    sharded: Dataset, short_plan: FloorPlan, cut: Output, tmp_path: Path, digests: Digests
) -> None:
    """Spawned workers, finishing in whatever order, make every file as one process does, the manifest too."""
    told: list[tuple[int, int, str]] = []
    with workers(jobs=2) as crew:
        generate(short_plan, tmp_path / "room", 1, lambda *now: told.append(now), output=cut, crew=crew)
    assert digests(tmp_path / "room") == digests(sharded.path)
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
            workers(scheduler=cluster.scheduler_address) as crew,
        ):
            assert crew.count == 2
            generate(short_plan, tmp_path / "room", 1, output=cut, crew=crew)
    assert digests(tmp_path / "room") == digests(sharded.path)


def test_a_scheduler_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """No answer, and no Dask, are errors that say so; so is a number of processes beside a scheduler."""
    with (
        pytest.raises(ConfigurationError, match="jobs: expected none beside a scheduler, got 2"),
        workers(2, "a"),
    ):
        pass
    with pytest.raises(ConfigurationError, match="jobs: expected at least 1, got 0"), workers(0):
        pass
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "distributed", None)
        with pytest.raises(ConfigurationError, match="hapslam\\[cluster\\]"), workers(scheduler="tcp://x:1"):
            pass
    pytest.importorskip("distributed", reason="Dask (the extra cluster) is not installed")
    monkeypatch.setattr("raytrace.dataset.workers._CONNECT_SECONDS", 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        unreachable = workers(scheduler="tcp://127.0.0.1:9")
        with pytest.raises(BackendError, match="expected a Dask scheduler at tcp://127.0.0.1:9"):
            unreachable.__enter__()


def _square(number: int) -> int:
    return number * number


def _die(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_worker_that_is_killed_is_told() -> None:
    """If the system kills a worker, the remedy is in the message and nothing hangs."""
    with workers(jobs=2) as crew:
        assert sorted(crew.run(_square, range(9))) == [n * n for n in range(9)]
    with workers(jobs=2) as crew, pytest.raises(BackendError, match="--resume and fewer --jobs"):
        list(crew.run(_die, range(3)))


def test_workers_end_with_the_process_that_started_them() -> None:
    """If it is killed and cannot tell them, no worker stays behind."""
    code = (
        "import time\n"
        "from raytrace.dataset.workers import workers\n"
        "with workers(2) as crew:\n"
        "    print(*set(crew.run(eval, ['__import__(\"os\").getpid()'] * 20)), flush=True)\n"
        "    time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        pids = [int(pid) for pid in parent.stdout.readline().split()]
        assert pids
        parent.kill()
    deadline = time.monotonic() + 10.0
    while any(Path(f"/proc/{pid}/stat").exists() and _alive(pid) for pid in pids):
        assert time.monotonic() < deadline, "a worker outlived its parent"
        time.sleep(0.02)


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_no_more_tasks_wait_than_two_for_each_worker() -> None:
    """Tasks are taken from their source as work gets done, so a million of them need no memory."""
    from concurrent.futures import ThreadPoolExecutor

    taken = 0

    def source() -> object:
        nonlocal taken
        for number in range(50):
            taken += 1
            yield number

    with ThreadPoolExecutor(2) as pool:
        for done, _ in enumerate(Workers(pool, 2).run(_square, source()), start=1):  # type: ignore[arg-type]
            assert taken - done <= 4
    assert taken == 50
