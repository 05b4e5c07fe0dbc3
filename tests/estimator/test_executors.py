"""Tasks in this process, in others and on a cluster: order, memory, failures, ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from estimator.errors import BackendError, ConfigurationError, InputError, WorkerLostError
from estimator.executors import Workers, available_cores, open_workers

ROOT = Path(__file__).resolve().parents[2]


def _square(number: int) -> int:
    return number * number


def _fail(task: int) -> int:
    if task == 2:
        raise InputError("task 2")
    return task


def _die(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def _where(_: int) -> tuple[int, str, bool]:
    return os.getpid(), os.environ["OPENBLAS_NUM_THREADS"], "numpy" in sys.modules


def test_results_are_in_the_order_of_the_tasks_and_progress_counts_them() -> None:
    """Chunks that finish in any order do not show in the results; the last progress is all of the tasks."""
    for workers in (Workers(), Workers(ThreadPoolExecutor(3), 3)):
        seen: list[tuple[int, int]] = []
        made = workers.map(_square, range(50), lambda done, total, seen=seen: seen.append((done, total)))
        assert made == [n * n for n in range(50)]
        assert [done for done, _ in seen] == sorted({done for done, _ in seen})
        assert seen[-1] == (50, 50)
        assert workers.map(_square, []) == []


def test_processes_have_one_thread_for_linear_algebra() -> None:
    """The limit stands before NumPy is loaded in them; a BLAS of more threads adds in another order."""
    with open_workers(2) as workers:
        found = workers.map(_where, range(8))
    assert os.getpid() not in {pid for pid, _, _ in found}
    assert {(threads, loaded) for _, threads, loaded in found} == {("1", False)}


def test_a_single_task_starts_no_process() -> None:
    """One task is done in this process: another would only cost its start."""
    with open_workers(2) as workers:
        assert workers.map(_pid, [0]) == [os.getpid()]


def _pid(_: int) -> int:
    return os.getpid()


def test_no_more_tasks_wait_than_two_for_each_worker() -> None:
    """Tasks are taken from their source as work gets done, so a million of them need no memory."""
    taken = 0

    def source() -> Iterator[int]:
        nonlocal taken
        for number in range(50):
            taken += 1
            yield number

    with ThreadPoolExecutor(2) as pool:
        for done, _ in enumerate(Workers(pool, 2).unordered(_square, source()), start=1):
            assert taken - done <= 4
    assert taken == 50


def test_a_failing_task_fails_all_at_once() -> None:
    """In one process the tasks after the failing one are not begun; in a pool its error comes out, too."""
    done: list[int] = []
    with pytest.raises(InputError, match="task 2"):
        Workers().map(_fail, range(10), lambda count, _: done.append(count))
    assert done == [1, 2]
    with ThreadPoolExecutor(2) as pool, pytest.raises(InputError, match="task 2"):
        Workers(pool, 2).map(_fail, range(10))


def test_a_killed_process_is_told() -> None:
    """A worker that dies is an error in one line, not a hang."""
    with open_workers(2) as workers, pytest.raises(WorkerLostError, match="one was killed .*fewer --jobs"):
        workers.map(_die, range(3))


def test_impossible_workers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """No jobs, jobs beside a scheduler, no Dask and no answer are told with what was expected."""
    with pytest.raises(ConfigurationError, match="jobs: expected at least 1, got 0"), open_workers(0):
        pass
    with (
        pytest.raises(ConfigurationError, match="jobs: expected none beside a scheduler, got 2"),
        open_workers(2, "a"),
    ):
        pass
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "distributed", None)
        with pytest.raises(ConfigurationError, match="hapslam\\[cluster\\]"), open_workers(scheduler="x"):
            pass
    pytest.importorskip("distributed", reason="Dask (the extra cluster) is not installed")
    monkeypatch.setattr("estimator.executors._CONNECT_SECONDS", 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Dask's own
        unreachable = open_workers(scheduler="tcp://127.0.0.1:9")
        with pytest.raises(BackendError, match="expected a Dask scheduler at tcp://127.0.0.1:9"):
            unreachable.__enter__()


def test_a_dask_cluster_does_the_tasks() -> None:
    """Where Dask is installed, results come back from its workers in the order of the tasks."""
    distributed = pytest.importorskip("distributed", reason="Dask (the extra cluster) is not installed")
    with (
        warnings.catch_warnings(),
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster,
        open_workers(scheduler=cluster.scheduler_address) as workers,
    ):
        warnings.simplefilter("ignore")  # Dask's own
        assert workers.count == 1
        assert workers.map(_square, range(20)) == [n * n for n in range(20)]


def test_workers_end_with_the_process_that_started_them() -> None:
    """If it is killed and cannot tell them, no worker stays behind."""
    code = (
        "import time\n"
        "from estimator.executors import open_workers\n"
        "with open_workers(2) as workers:\n"
        "    pids = workers.map(eval, ['__import__(\"os\").getpid()'] * 20)\n"
        "    print(*set(pids), flush=True)\n"
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
    while any(_alive(pid) for pid in pids):
        assert time.monotonic() < deadline, "a worker outlived its parent"
        time.sleep(0.02)


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_there_is_at_least_one_core() -> None:
    """The default number of processes is that of the cores which this process may use."""
    assert 1 <= available_cores() <= (os.cpu_count() or 1)
