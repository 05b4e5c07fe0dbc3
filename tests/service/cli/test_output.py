"""What the command line prints and how it ends: brackets, warnings, full disks, missing folders."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.dataset import write_netcdf
from raytrace.propagation.backend import Check
from service.cli import missing_paths, progress
from service.cli.console import made_parents, plain_console
from service.cli.doctor import print_findings
from service.cli.report import print_evaluation, print_inventory

ROOT = Path(__file__).parents[3]
Runner = Callable[..., SimpleNamespace]


def test_remedies_keep_their_brackets(capsys: pytest.CaptureFixture[str]) -> None:
    """The name of an extra is not taken for markup of the terminal library: the remedy can be typed off."""
    remedy = "pip install 'hapslam[raytrace]'"
    print_findings([Check("a [bold] name", False, "[red]", remedy)], plain_console())
    printed = capsys.readouterr().out
    for text in (remedy, "a [bold] name", "[red]", "BAD", "remedy:"):
        assert text in printed


def test_names_of_users_keep_their_brackets(capsys: pytest.CaptureFixture[str]) -> None:
    """Plans, anchors and materials may have any name; so have files that are told of while work goes on."""
    name = "plan[/]:smile:[red]"
    facts: dict[str, Any] = {
        "name": name, "seed": 1, "complete": True, "epochs": 1, "epochs_there": 1, "anchors": ["[b]"],
        "content": "cfr", "sweeps": 0, "radio": None, "echo": None, "bytes": 1, "files": 1,
        "statistics": None, "versions": None, "damaged": ["[link]x.nc"],
    }  # fmt: skip
    print_inventory(facts, plain_console())
    print_evaluation(
        {
            "position_mae_m": 0.0, "position_rmse_m": 0.0, "position_final_m": 0.0, "epochs": 1,
            "derotated_rmse_m": 0.0, "rotation_rad": 0.0, "nees_position_per_dim": None, "anchors": [name],
            "anchors_error_m": [None], "walls_found": 0, "walls_true": 0, "walls_false": 0, "vrp_ospa_m": 0.0,
            "lost": False,
        },
        plain_console(),
    )  # fmt: skip
    reporter = progress.Reporter()
    reporter.say(f"drawn without {name}")
    with reporter.stage("[stage]") as advance:
        advance(1, 2, name)
    printed = capsys.readouterr()
    assert printed.out.count(name) == 2
    assert "[link]x.nc" in printed.out
    assert f"drawn without {name}" in printed.err
    assert "[stage]" in printed.err


def test_long_stages_tell_how_far_they_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a terminal, minutes of work are not silent, and short work has its one line alone."""
    monkeypatch.setattr(progress, "_EVERY_S", 0.05)
    with progress.Reporter().stage("trace") as advance:
        advance(3, 7, "tracing paths")
        time.sleep(0.3)
    assert "3 of 7, tracing paths" in capsys.readouterr().err
    monkeypatch.setattr(progress, "_EVERY_S", 60.0)
    with progress.Reporter().stage("trace") as advance:
        advance(3, 7)
    assert len(capsys.readouterr().err.splitlines()) == 1


def manifest(folder: Path, missing: int) -> Path:
    listed = {"file": "paths-00000.nc", "kind": "paths", "bytes": 1, "sha256": "0" * 64}
    entry = {**listed, "check": {"expected": 78, "found": 78 - missing, "missing": missing, "extra": 0}}
    echo = {**listed, "file": "echo-00000.nc", "kind": "echo", "returns": {"specular": 3}}
    folder.mkdir()
    facts = {"format": "hapslam-dataset", "version": 1, "shards": [entry, echo]}
    (folder / "manifest.json").write_text(json.dumps(facts))
    return folder


def test_missing_paths_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A dataset that lost paths has a line that counts them; one that is whole has none."""
    assert not missing_paths.tell_missing([manifest(tmp_path / "whole", 0)])
    assert capsys.readouterr().err == ""
    assert missing_paths.tell_missing([manifest(tmp_path / "poor", 6)])
    assert "of 78 paths 6 missing" in capsys.readouterr().err


@pytest.mark.parametrize(("strict", "status"), [([], 0), (["--strict"], 3)])
def test_strict_ends_with_a_status_of_its_own(
    main: Runner, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, strict: list[str], status: int
) -> None:
    """`trace` warns of missing paths, and fails for them where the user says so."""

    def generate_agents(plan: Any, out: Path, *_: Any, **__: Any) -> tuple[Path, ...]:
        return (manifest(out, 6),)

    monkeypatch.setattr("raytrace.dataset.agents.generate_agents", generate_agents)
    run = main("trace", "l-room", "--out", tmp_path / "new" / "folders" / "room", *strict)
    assert run.status == status
    assert "6 missing" in run.err
    assert (tmp_path / "new" / "folders").is_dir()


def test_parents_are_made(tmp_path: Path) -> None:
    """A file may be written into folders that are not there yet; no name is no folder."""
    assert made_parents(tmp_path / "a" / "b" / "map.png") == tmp_path / "a" / "b" / "map.png"
    assert (tmp_path / "a" / "b").is_dir()
    assert made_parents(None) is None


def limited(code: str, bytes_: int) -> subprocess.CompletedProcess[str]:
    """Run code in a process that may write files of so many bytes: a quota."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_, bytes_)),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_full_disk_is_one_line(tmp_path: Path, demo: tuple[Path, SimpleNamespace]) -> None:
    """Writing HDF5 where there is no room ends with status 2 and one line, no signal, and leaves nothing."""
    out = tmp_path / "m.nc"
    code = (
        "from service.cli.main import main\n"
        f"main(['extract', {str(demo[0] / 'dataset')!r}, '--quiet', '--out', {str(out)!r}])"
    )
    run = limited(code, 10_000)
    assert run.returncode == 2, run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
    assert "hapslam: error:" in run.stderr
    assert "File too large" in run.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_does_not_reach_hdf5(tmp_path: Path) -> None:
    """What is written is whole or not there: the library that aborts on full disks writes to memory."""
    data = xr.Dataset({"a": ("x", np.arange(100_000.0))})
    write_netcdf(data, tmp_path / "whole.nc")
    assert xr.open_dataset(tmp_path / "whole.nc", engine="h5netcdf").load().equals(data)
    code = (
        "import numpy as np, xarray as xr\nfrom pathlib import Path\n"
        "from estimator.dataset import write_netcdf\n"
        "try:\n    write_netcdf(xr.Dataset({'a': ('x', np.arange(100_000.0))}), "
        f"Path({str(tmp_path / 'b.nc')!r}))\nexcept OSError as error:\n    print(error)"
    )
    run = limited(code, 10_000)
    assert (run.returncode, run.stderr) == (0, "")
    assert "File too large" in run.stdout
    assert not (tmp_path / "b.nc").exists()


def test_output_that_nobody_can_take_is_one_line() -> None:
    """A full disk behind the standard output is an error with status 2, not a complaint of Python's own."""
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(
            [sys.executable, "-c", "from service.cli.main import main; main(['scene', 'schema'])"],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            check=False,
        )
    assert run.returncode == 2
    assert run.stderr.strip() == "hapslam: error: [Errno 28] No space left on device"


def test_a_read_only_folder_is_one_line(
    main: Runner, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What the system refuses has the status of what is refused: 2."""

    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(13, "Permission denied", "room.toml")

    monkeypatch.setattr("raytrace.plan.files.save_floorplan", refuse)
    run = main("scene", "random", "--kind", "rectangle", "--out", tmp_path / "room.toml")
    assert run.status == 2
    assert run.err.strip() == "hapslam: error: [Errno 13] Permission denied: 'room.toml'"
