"""`hapslam bench`: its rows, as a table and as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from service.bench import estimator_rows
from service.bench.comparison import Comparison
from service.bench.floors import association_s, joint_update_s, line_fits_s, spectrum_s
from service.bench.resident import PeakMemory
from service.bench.rooms import many_anchors, many_paths, many_walls, request
from service.bench.rows import Row, cpu_s

Runner = Callable[..., SimpleNamespace]

SCENES = ["corridor", "hall", "l-room-hard", "office", "warehouse"]  # but for the L-room


@pytest.mark.soak
def test_the_estimator_is_measured_in_earnest(main: Runner) -> None:
    """Real figures of the estimator, positive and within ten times their bars, with machine and versions."""
    run = main("bench", "--only", "estimator", "--quick", "--json")
    assert run.status == 0, run.err
    found = json.loads(run.out)
    assert found["machine"]["cores"] >= 1
    assert 0.01 < found["machine"]["small_operation_us"] < 100.0
    assert {"python", "numpy", "scipy"} <= set(found["versions"])
    rows = found["rows"]
    assert [row["part"] for row in rows] == ["estimator"] * len(rows)
    assert sum("NOMP, 819 tones, 15 paths" in row["name"] for row in rows) == 1
    for row in rows:
        assert row["value"] > 0.0 or row["unit"] == "MiB"  # a step may need no more than there is
        assert row["bar"] is None or row["value"] < 10.0 * row["bar"], row
    beside = [row for row in rows if row["peer"] is not None]
    assert len(beside) == sum(row["unit"] != "MiB" for row in rows)
    for row in beside:
        assert row["ratio"] == pytest.approx(row["peer_value"] / row["value"])


@pytest.mark.soak
def test_the_ray_tracer_is_measured_in_earnest(main: Runner) -> None:
    """Ours is beside one solver call per position and far faster; a small dataset stays within its memory.

    At depth 2 a few positions pay for what many share; still one is cheaper than half a call at depth 1.
    """
    run = main("bench", "--only", "raytrace", "--quick", "--json")
    assert run.status == 0, run.err
    rows = json.loads(run.out)["rows"]
    images = [row for row in rows if "image method alone" in row["name"]]
    datasets = [row for row in rows if row["name"].startswith("dataset")]
    first, *second = (row for row in rows if row not in [*images, *datasets])
    assert [row["name"].endswith(("images: peak memory", "images: size")) for row in datasets].count(
        True
    ) == 2
    memory, _, seconds, size = datasets[:4]
    assert len(images) == len(SCENES) + 1
    for row in images:
        assert row["peer_value"] == pytest.approx(3.0 * row["bar"])
        assert row["ratio"] > 3.0, row
    assert first["peer_value"] == pytest.approx(50.0 * first["bar"])
    assert first["ratio"] > 10.0
    for name, row in zip(["", *SCENES], second, strict=True):
        assert name in row["name"]
        assert row["bar"] == 0.5
        assert 0.0 < row["value"] < 0.5 * first["peer_value"]
    assert 0.1 < memory["value"] < memory["bar"] == 3.0
    assert seconds["value"] > 0.0
    assert size["value"] > 500 * 4 * 819 * 8 * 0.5 / 2**30


def test_the_table_says_what_is_met(main: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bar that is met, one that is not, none at all, and a peer, each as the table shows them."""

    def rows(quick: bool) -> Iterator[Row]:
        assert not quick
        yield Row("below", 1.0, "ms", 2.0)
        yield Row("above", 3.0, "ms", 2.0)
        yield Row("beside", 4.0, "s", peer="another", peer_value=10.0)

    monkeypatch.setattr(estimator_rows, "rows", rows)
    monkeypatch.setenv("COLUMNS", "120")
    run = main("bench", "--only", "estimator")
    assert run.status == 0, run.err
    lines = {line.split()[0]: line for line in run.out.splitlines() if line.strip()}
    assert "1 ms" in lines["below"]
    assert lines["below"].split("ms")[-1].strip() == "met"
    assert lines["above"].split("ms")[-1].strip() == "NOT met"
    assert "another: 10 s (x 2.5)" in lines["beside"]


def test_cpu_time_leaves_out_the_first_call() -> None:
    """The median counts the calls after the first, which warms caches."""
    calls: list[int] = []
    taken = cpu_s(lambda: calls.append(sum(range(1000 if calls else 3_000_000))), 3)
    assert len(calls) == 4
    assert 0.0 <= taken < 0.01


def test_peak_memory_is_that_of_the_work_watched() -> None:
    """What is allocated and freed in between counts, what was there before does not."""
    memory = PeakMemory()
    if not memory.available:
        pytest.skip("the system does not tell peaks of memory in /proc")
    held = np.ones(2**22)
    memory.begin()
    np.ones(2**23).sum()
    assert 60.0 < memory.growth_mib() < 80.0
    memory.begin()
    held.sum()
    assert memory.growth_mib() < 10.0


def test_the_growing_measurements_grow_in_one_size_alone() -> None:
    """So many anchors, walls seen at the start, and paths of an anchor, as the rows say."""
    few, many = many_anchors(2), many_anchors(8)
    assert (len(few.anchors), len(many.anchors)) == (2, 8)
    assert len(few.walls) == len(many.walls) == 4
    for size in (4, 20):
        walls = many_walls(size)
        assert (len(walls.anchors), len(walls.walls)) == (2, size)
    counts = [len(paths) for epoch in many_paths(50).epochs[:60] for paths in epoch.paths]
    assert np.mean(counts) == pytest.approx(50.0, abs=4.0 * np.sqrt(50.0 / len(counts)) + 1.0)
    asked = request(3, 2, 7)
    assert (len(asked.walls), [len(paths) for paths in asked.epochs[0].paths]) == (3, [7, 7])


def measured(monkeypatch: pytest.MonkeyPatch, operation_us: float, **values: float) -> None:
    """Have the estimator's rows give these values, on a machine whose small operation takes so long."""

    def rows(quick: bool) -> Iterator[Row]:
        for name, value in values.items():
            yield Row(name, value, "MiB" if name == "memory" else "ms")

    monkeypatch.setattr(estimator_rows, "rows", rows)
    monkeypatch.setattr("service.bench.rows.small_operation_us", lambda: operation_us)


def test_a_slower_machine_is_no_slower_code(
    main: Runner, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Twice the time on a machine of half the speed is the same; on the same machine it is worse."""
    measured(monkeypatch, 0.5, step=2.0, sweep=20.0, memory=100.0)
    (tmp_path / "before.json").write_text(main("bench", "--only", "estimator", "--json").out)
    measured(monkeypatch, 1.0, step=4.0, sweep=40.0, memory=104.0, new=1.0)
    same = main("bench", "--only", "estimator", "--compare", tmp_path / "before.json")
    assert same.status == 0, same.err
    assert "0 of 3 rows worse" in same.out
    assert "not there before" in [line for line in same.out.splitlines() if line.startswith("new")][-1]
    assert "x 1.00 (0.74 to 1.35): same" in same.out
    measured(monkeypatch, 0.5, step=4.0, sweep=10.0, memory=100.0)
    run = main("bench", "--only", "estimator", "--compare", tmp_path / "before.json", "--json")
    assert run.status == 1
    found = {row["name"]: row["compared"] for row in json.loads(run.out)["rows"]}
    assert found["step"]["ratio"] == pytest.approx(2.0)
    assert found["step"]["beyond"]
    assert found["sweep"]["ratio"] == pytest.approx(0.5)
    assert not found["sweep"]["beyond"]
    measured(monkeypatch, 0.5, step=2.0, sweep=20.0, memory=130.0)
    assert main("bench", "--only", "estimator", "--compare", tmp_path / "before.json").status == 1


def test_the_noise_band_is_as_wide_as_the_machine_is_restless() -> None:
    """Of times that scatter by noise alone, one in a few hundred is worse; of those 40 % slower most are."""
    rng = np.random.default_rng(1)
    count, std = 4000, 0.12
    operations = 0.5 * np.exp(std * rng.normal(size=(2, count)))
    entries = [{"name": str(i), "value": 3.0, "small_operation_us": operations[0, i]} for i in range(count)]
    comparison = Comparison({"quick": True, "rows": entries}, quick=True)
    unrest = comparison.unrest(operations[1].tolist())
    assert unrest == pytest.approx(std * np.sqrt(2.0), rel=0.1)
    beyond = [comparison.of(str(i), "ms", 3.0, operations[1, i], unrest) for i in range(count)]
    share = np.mean([one is not None and one.beyond for one in beyond])
    assert share == pytest.approx(0.00135, abs=0.003)  # one side of three deviations
    slower = [comparison.of(str(i), "ms", 6.0, operations[1, i], unrest) for i in range(count)]
    assert np.mean([one is not None and one.beyond for one in slower]) > 0.7


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "before.json: expected"),
        ('{"rows": []}', "expected what `hapslam bench --json` printed"),
        ('{"quick": false, "rows": [1]}', "expected what `hapslam bench --json` printed"),
        ('{"quick": true, "rows": []}', "expected a run in full, got the other kind"),
    ],
)
def test_what_is_no_earlier_run_is_refused(main: Runner, tmp_path: Path, text: str, message: str) -> None:
    """Before anything is measured."""
    (tmp_path / "before.json").write_text(text)
    run = main("bench", "--only", "estimator", "--compare", tmp_path / "before.json")
    assert run.status == 2
    assert message in run.err
    assert len(run.err.strip().splitlines()) == 1


def test_floors_are_positive_and_grow_with_the_work() -> None:
    """What the least costs is measured, not made up."""
    assert 0.0 < joint_update_s(10, 4) < joint_update_s(120, 60)
    assert 0.0 < association_s(4, 10, 1) < association_s(64, 200, 32)
    data = np.ones((2, 64), dtype=np.complex128)
    assert 0.0 < spectrum_s(data) < spectrum_s(np.ones((64, 4096), dtype=np.complex128))
    assert line_fits_s(np.random.default_rng(1).normal(size=(10, 5, 2))) > 0.0
