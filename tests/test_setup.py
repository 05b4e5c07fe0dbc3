"""Setting up on a machine whose Pythons are too old, incomplete or absent."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FINDER = ROOT / "requirements" / "find-python"


def fake_python(folder: Path, name: str, version: str, *lacks: str) -> None:
    """A program that answers as a Python of that version would, without some modules."""
    old = tuple(int(part) for part in version.split(".")) < (3, 11)
    refused = [*lacks, *(["version_info"] if old else [])]
    lines = [
        "#!/bin/sh",
        f'[ "$1" = --version ] && echo "Python {version}" && exit 0',
        'case "$2" in',
        *(f"  *{word}*) exit 1 ;;" for word in refused),
        "esac",
        "exit 0",
    ]
    (folder / name).write_text("\n".join(lines) + "\n")
    (folder / name).chmod(0o755)


def find(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the finder where nothing but the programs of the folder is on the path."""
    return subprocess.run(
        ["/bin/sh", str(FINDER), *arguments],
        env={"PATH": str(folder)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_the_first_good_python_is_taken(tmp_path: Path) -> None:
    """One that is too old and one without venv are passed over."""
    fake_python(tmp_path, "python3", "3.9.18")
    fake_python(tmp_path, "python3.13", "3.13.0", "ensurepip")
    fake_python(tmp_path, "python3.12", "3.12.1")
    found = find(tmp_path)
    assert (found.returncode, found.stdout, found.stderr) == (0, "python3.12\n", "")


def test_what_is_wrong_with_each_is_said(tmp_path: Path) -> None:
    """If none will do, the message names each with its fault and its remedy."""
    fake_python(tmp_path, "python3", "3.10.13")
    fake_python(tmp_path, "python3.11", "3.11.2", "ensurepip")
    found = find(tmp_path)
    assert (found.returncode, found.stdout) == (1, "")
    assert "expected Python 3.11 or newer with venv and ensurepip" in found.stderr
    assert "python3 is Python 3.10.13, too old" in found.stderr
    assert "python3.11 is Python 3.11.2, but lacks venv or ensurepip" in found.stderr
    assert "apt install python3-venv" in found.stderr


def test_no_python_at_all(tmp_path: Path) -> None:
    """A machine without Python gets the same message."""
    found = find(tmp_path)
    assert found.returncode == 1
    assert "found: none" in found.stderr


def test_a_named_python_is_taken_or_refused(tmp_path: Path) -> None:
    """make PYTHON=... takes that one, and never another in its place."""
    fake_python(tmp_path, "python3", "3.12.1")
    fake_python(tmp_path, "old", "3.8.0")
    assert find(tmp_path, sys.executable).stdout == f"{sys.executable}\n"
    refused = find(tmp_path, str(tmp_path / "old"))
    assert refused.returncode == 1
    assert "too old" in refused.stderr


@pytest.mark.parametrize("target", ["demo", "test", "coverage", "lint", "format"])
def test_every_target_sets_up_first(target: str, tmp_path: Path) -> None:
    """In a fresh clone each target begins with the environment, from pinned requirements alone."""
    for name in ("Makefile", "pyproject.toml", "requirements"):
        (tmp_path / name).symlink_to(ROOT / name)
    plan = subprocess.run(
        ["make", "--dry-run", target],
        cwd=tmp_path,
        env={"PATH": os.environ["PATH"]},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout
    assert plan.index("-m venv --clear .venv") < plan.index(
        "install --require-hashes -r requirements/run.txt"
    )
    assert "install --no-deps --no-build-isolation -e ." in plan
    assert ("requirements/dev.txt" in plan) == (target != "demo")


@pytest.mark.parametrize("name", ["run.txt", "dev.txt"])
def test_everything_is_pinned_by_hash_and_from_no_named_host(name: str) -> None:
    """Each requirement has one version and a SHA-256; no line names an index, a link or a folder."""
    text = (ROOT / "requirements" / name).read_text(encoding="utf-8").replace("\\\n", " ")
    entries = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    assert len(entries) > 30
    for entry in entries:
        requirement = entry.partition(" --hash")[0].strip()
        assert re.fullmatch(r"[a-z0-9._-]+(\[[a-z,]+\])?==[0-9][^ ;]*( ; .+)?", requirement), requirement
        hashes = re.findall(r"--hash=(\S+)", entry)
        assert hashes, requirement
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", found) for found in hashes), requirement
        assert "://" not in entry
        assert "--index" not in entry
