"""Kept machine code: compiled by one of several processes, loaded by the others, old versions removed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from estimator.kept_code import KeptCode

ROOT = Path(__file__).resolve().parents[2]
SOURCE = """
from estimator.compiled import compiled

@compiled
def inner(x):
    total = 0.0
    for i in range(10):
        total += x ** i / (i + 1.0)
    return total

@compiled
def outer(x):
    return inner(x) + {version}
"""
RUN = """
import sys
sys.path.insert(0, sys.argv[1])
sys.stdin.read(1)
import numba
import kept_example as one
try:
    one.outer("no number")
except numba.TypingError:
    pass
print(one.outer(0.5), sum(one.outer.stats.cache_hits.values()), flush=True)
"""


def start(folder: Path) -> subprocess.Popen[str]:
    """A process that asks for the function as soon as it gets a letter."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "kept"), "PYTHONPATH": str(ROOT)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    return subprocess.Popen(
        [sys.executable, "-c", RUN, str(folder)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def answers(processes: list[subprocess.Popen[str]]) -> list[list[str]]:
    """What they print once all may begin: a value, and how often they loaded its code."""
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("x")
        process.stdin.flush()
    return [process.communicate(timeout=120)[0].split() for process in processes]


def test_one_of_two_processes_compiles(tmp_path: Path) -> None:
    """Both get the same value; the second loads it, though the first failed to compile for other types."""
    (tmp_path / "kept_example.py").write_text(SOURCE.format(version=1))
    found = answers([start(tmp_path), start(tmp_path)])
    assert found[0][0] == found[1][0]
    assert sorted(loaded for _, loaded in found) == ["0", "1"]


def half(x: float) -> float:
    """What is compiled over and over."""
    return 0.5 * x


def test_old_versions_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of seven versions of a function, the newest four stay."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    for mark in range(7):
        dispatcher = numba.njit(half)
        dispatcher._cache = KeptCode(half, f"{mark:012x}")
        assert dispatcher(3.0) == 1.5
        for path in tmp_path.rglob(f"*-{mark:012x}.*"):
            os.utime(path, (mark, mark))
    kept = sorted(path.stem.split("-")[-1] for path in tmp_path.rglob("*.nbi"))
    assert kept == [f"{mark:012x}" for mark in (3, 4, 5, 6)]
    assert len(list(tmp_path.rglob("*.nbc"))) == 4
