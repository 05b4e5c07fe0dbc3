"""The command line: help, errors in one line, exit status, and nothing lost."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from estimator.errors import BackendError
from raytrace.propagation.backend import Check
from service.cli import main as cli
from service.cli.doctor import as_json, machine_findings

Runner = Callable[..., SimpleNamespace]
COMMANDS = [
    *("doctor", "demo", "trace", "campaign", "append", "merge", "verify", "info", "export"),
    *("extract", "slam", "evaluate", "plot"),
]


def assert_refused(run: SimpleNamespace, *words: str) -> None:
    """One line on standard error, with the words; status 2; nothing on standard output; no traceback."""
    assert run.status == 2
    assert run.out == ""
    (line,) = run.err.splitlines()
    assert line.startswith("hapslam: error: ")
    for word in words:
        assert word in line


@pytest.fixture
def dataset(demo: tuple[Path, SimpleNamespace], tmp_path: Path) -> Path:
    """A copy of a traced dataset."""
    return Path(shutil.copytree(demo[0] / "dataset", tmp_path / "dataset"))


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_examples(main: Runner, command: str) -> None:
    """Each command explains itself, with examples that call it."""
    run = main(command, "--help")
    assert run.status == 0
    assert "Examples" in run.out
    assert f"$ hapslam {command}" in run.out


def test_help_lists_the_commands(main: Runner) -> None:
    """The head of the help names every command."""
    run = main("--help")
    assert run.status == 0
    for command in COMMANDS:
        assert command in run.out


def test_version(main: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """The version is that of the distribution."""
    monkeypatch.setattr("importlib.metadata.version", lambda name: f"1.2.3 of {name}")
    run = main("--version")
    assert (run.status, run.out) == (0, "hapslam 1.2.3 of hapslam\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["trace", "nowhere", "--out", "OUT"], ["nowhere", "expected a floor plan file or one of corridor"]),
        (["trace", "nowhere.toml", "--out", "OUT"], ["nowhere.toml", "expected"]),
        (
            ["demo", "--scene", "nowhere", "--out", "OUT"],
            ["nowhere", "expected a floor plan file or one of corridor"],
        ),
        (
            ["extract", "nowhere", "--out", "OUT"],
            ["nowhere: expected a dataset directory with manifest.json"],
        ),
        (
            ["slam", "nowhere.nc", "--out", "OUT"],
            ["nowhere.nc: expected a hapslam-measurements file, found nothing"],
        ),
        (["evaluate", "nowhere.nc"], ["nowhere.nc: expected a hapslam-result file, found nothing there"]),
        (
            ["evaluate", "nowhere.nc", "--json"],
            ["nowhere.nc: expected a hapslam-result file, found nothing there"],
        ),
        (["plot", "nowhere.nc", "--out", "OUT.png"], ["nowhere.nc: expected a hapslam-result file"]),
    ],
)
def test_missing_files(main: Runner, tmp_path: Path, arguments: list[str], words: list[str]) -> None:
    """Each command names the file that is not there, and writes nothing."""
    run = main(*(argument.replace("OUT", str(tmp_path / "out")) for argument in arguments))
    assert_refused(run, *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("keep", [0, 1000, -1])
def test_a_truncated_dataset(main: Runner, dataset: Path, tmp_path: Path, keep: int) -> None:
    """A shard that is cut off is named; the dataset stays as it is and no measurements appear."""
    shard = dataset / "passive-00000.nc"
    cut = shard.read_bytes()[:keep]
    shard.write_bytes(cut)
    run = main("extract", dataset, "--out", tmp_path / "m.nc")
    assert_refused(run, "passive-00000.nc", "expected", "bytes", "truncated")
    assert shard.read_bytes() == cut
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset"]


def test_an_interrupted_dataset(main: Runner, dataset: Path, tmp_path: Path) -> None:
    """A dataset whose tracing was interrupted is refused."""
    manifest = dataset / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"complete": true', '"complete": false'))
    assert_refused(main("extract", dataset, "--out", tmp_path / "m.nc"), "its generation was interrupted")


def test_a_truncated_measurement_file(
    main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path
) -> None:
    """Half a file is refused, and no result appears."""
    whole = (demo[0] / "measurements.nc").read_bytes()
    (tmp_path / "m.nc").write_bytes(whole[: len(whole) // 2])
    run = main("slam", tmp_path / "m.nc", "--out", tmp_path / "r.nc")
    assert_refused(run, "m.nc", "expected a complete netCDF-4 file")
    assert [path.name for path in tmp_path.iterdir()] == ["m.nc"]


def test_files_given_to_the_wrong_command(
    main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path
) -> None:
    """Measurements are no result, a result is no measurements, a file is no dataset."""
    measurements, result = demo[0] / "measurements.nc", demo[0] / "result.nc"
    assert_refused(
        main("evaluate", measurements), "expected format 'hapslam-result'", "got 'hapslam-measurements'"
    )
    assert_refused(main("slam", result, "--out", tmp_path / "r.nc"), "expected format 'hapslam-measurements'")
    assert_refused(main("extract", result, "--out", tmp_path / "m.nc"), "expected a dataset directory")


@pytest.mark.parametrize(
    ("arguments", "taken"),
    [
        (["trace", "l-room", "--out"], "taken"),
        (["extract", "DEMO/dataset", "--out"], "taken.nc"),
        (["slam", "DEMO/measurements.nc", "--out"], "taken.nc"),
        (["plot", "DEMO/result.nc", "--out"], "taken.png"),
        (["demo", "--out"], "taken"),
    ],
)
def test_existing_output_is_kept(
    main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path, arguments: list[str], taken: str
) -> None:
    """What stands where a command would write is refused and kept."""
    (tmp_path / taken).write_text("mine")
    run = main(*(argument.replace("DEMO", str(demo[0])) for argument in arguments), tmp_path / taken)
    assert_refused(run, f"{taken}: expected a name that is free, but it exists; nothing was written")
    assert (tmp_path / taken).read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == [taken]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["slam", "DEMO/measurements.nc", "--out", "OUT/r.nc", "--method", "magic"],
            ["method", "hybrid", "'magic'"],
        ),
        (["slam", "DEMO/measurements.nc", "--out", "OUT/r.nc", "--engine", "steam"], ["engine", "'steam'"]),
        (
            ["plot", "DEMO/result.nc", "--out", "OUT/map.txt"],
            ["expected a name that ends in .png, .svg, .pdf"],
        ),
        (
            ["evaluate", "DEMO/result.nc", "--truth", "OUT"],
            ["expected a dataset directory with manifest.json"],
        ),
        (
            ["plot", "DEMO/result.nc", "--out", "OUT/map.png", "--truth", "OUT"],
            ["expected a dataset directory"],
        ),
    ],
)
def test_bad_values(
    main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    """What was expected is said in one line, and nothing is written."""
    run = main(*(a.replace("DEMO", str(demo[0])).replace("OUT", str(tmp_path)) for a in arguments))
    assert_refused(run, *words)
    assert list(tmp_path.iterdir()) == []


def test_a_bad_plan(main: Runner, tmp_path: Path) -> None:
    """The file, the field, what was expected and what came, in one line."""
    source = (Path(__file__).resolve().parents[3] / "scenes" / "l-room.toml").read_text()
    (tmp_path / "bad.toml").write_text(source.replace('material = "concrete"', 'material = "cheese"', 1))
    run = main("trace", tmp_path / "bad.toml", "--out", tmp_path / "room")
    assert_refused(run, "bad.toml", "material", "cheese")
    assert not (tmp_path / "room").exists()


@pytest.mark.parametrize(
    "arguments", [["trace", "l-room"], ["slam"], ["demo", "--seed", "-1"], ["demo", "--seed", "x"], ["fly"]]
)
def test_wrong_usage(main: Runner, arguments: list[str]) -> None:
    """Usage mistakes end with status 2 and one line that says where help is."""
    run = main(*arguments)
    assert run.status == 2
    assert run.out == ""
    assert run.err.count("\n") == 1
    assert run.err.startswith("hapslam")
    assert "--help tells more" in run.err


def test_a_system_that_refuses(main: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the system says (no space, no permission) is one line too, with status 2: nothing was done."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "room")

    monkeypatch.setattr("estimator.pipeline.evaluate_file", full)
    run = main("evaluate", "r.nc")
    assert (run.status, run.out) == (2, "")
    assert run.err == "hapslam: error: [Errno 28] No space left on device: 'room'\n"


def test_notes_are_part_of_the_line(main: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a failing demo leaves behind is said in the same line, however many lines the message has."""

    def fail(*_: object) -> None:
        error = BackendError("LLVM: expected 17,\n  got 14; install it")
        error.add_note("stages finished: none")
        raise error

    monkeypatch.setattr("estimator.pipeline.evaluate_file", fail)
    assert_refused(main("evaluate", "r.nc"), "LLVM: expected 17, got 14; install it; stages finished: none")


def test_mistakes_of_ours_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    """Anything else is a mistake in the program and keeps its traceback."""

    def bug(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("estimator.pipeline.evaluate_file", bug)
    with pytest.raises(ZeroDivisionError):
        cli.main(["evaluate", "r.nc"])


def test_evaluate_agrees_with_the_demo(
    main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path
) -> None:
    """`evaluate --json` prints what the demo did, but for the seconds; the truth may be named."""
    numbers = json.loads((demo[0] / "evaluation.json").read_text())
    del numbers["seconds"]
    run = main("evaluate", demo[0] / "result.nc", "--json")
    assert json.loads(run.out) == numbers
    moved = shutil.copy(demo[0] / "result.nc", tmp_path / "moved.nc")
    assert_refused(
        main("evaluate", moved), "moved.nc: expected its dataset with the truth at", str(tmp_path / "dataset")
    )
    run = main("evaluate", moved, "--truth", demo[0] / "dataset", "--json")
    assert json.loads(run.out) == {**numbers, "seconds_per_epoch": None}


def test_a_damaged_record_is_named(main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path) -> None:
    """A sidecar that is not a JSON object is not passed over in silence."""
    result = shutil.copy(demo[0] / "result.nc", tmp_path / "r.nc")
    for text, words in (("{", "expected JSON"), ("[]", "expected a JSON object, got list")):
        (tmp_path / "r.nc.run.json").write_text(text)
        assert_refused(main("evaluate", result, "--truth", demo[0] / "dataset"), "r.nc.run.json", words)


def test_tables_for_people(main: Runner, demo: tuple[Path, SimpleNamespace]) -> None:
    """Without --json a short table shows errors, anchors and walls."""
    run = main("evaluate", demo[0] / "result.nc")
    assert run.status == 0
    for words in ("position error", "rotation removed", "pa1", "pa2", "5 of 5 found", "0 false"):
        assert words in run.out


def test_plot_without_truth_says_so(main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path) -> None:
    """A result away from its dataset is drawn all the same, with a note why the truth is missing."""
    result = shutil.copy(demo[0] / "result.nc", tmp_path / "r.nc")
    run = main("plot", result, "--out", tmp_path / "map.svg")
    assert run.status == 0
    assert "drawn without the truth" in run.err
    assert (tmp_path / "map.svg").stat().st_size > 10_000
    run = main("plot", result, "--out", tmp_path / "map.png", "--truth", demo[0] / "dataset")
    assert (run.status, run.err) == (0, "")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_quiet_is_quiet(main: Runner, demo: tuple[Path, SimpleNamespace], tmp_path: Path) -> None:
    """With --quiet nothing is said when all goes well; without, a line per stage on standard error."""
    arguments = ("slam", demo[0] / "measurements.nc", "--out")
    run = main(*arguments, tmp_path / "a.nc", "--quiet")
    assert (run.status, run.out, run.err) == (0, "", "")
    run = main(*arguments, tmp_path / "b.nc")
    assert (run.status, run.out) == (0, "")
    assert run.err.startswith("slam ")


def test_doctor_says_what_is_there(hapslam: Runner) -> None:
    """Python, Mitsuba, LLVM, threads and database are reported, and all is well where the tests run."""
    run = hapslam("doctor", "--json")
    report = json.loads(run.out)
    assert (run.status, report["ok"]) == (0, True), report
    found = {check["name"]: check["value"] for check in report["checks"]}
    assert found["Python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["database"].startswith("SQLite 3.")
    assert {"LLVM", "Mitsuba variant", "Dr.Jit threads", "processors"} <= set(found)


@pytest.mark.parametrize("arguments", [["doctor"], ["doctor", "--json"]])
def test_doctor_names_the_remedy(hapslam: Runner, tmp_path: Path, arguments: list[str]) -> None:
    """A library that is none is found out without harm; status 1, and the remedy is printed."""
    (tmp_path / "libLLVM.so").write_bytes(b"not a library")
    run = hapslam(*arguments, DRJIT_LIBLLVM_PATH=str(tmp_path / "libLLVM.so"), COLUMNS="200")
    assert run.status == 1
    assert "Traceback" not in run.err
    assert "install LLVM" in run.out


def test_doctor_judges_the_database(monkeypatch: pytest.MonkeyPatch) -> None:
    """An SQLite that is too old comes with its remedy; one bad finding makes all bad."""
    monkeypatch.setattr("sqlite3.sqlite_version_info", (3, 7, 17))
    report = as_json(machine_findings(Check))
    assert report["ok"] is False
    assert [check["remedy"] for check in report["checks"] if not check["ok"]] == [
        "use a Python built with SQLite 3.35 or newer"
    ]
