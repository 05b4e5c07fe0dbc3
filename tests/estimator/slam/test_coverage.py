"""Every module of SLAM has a test that imports it by name."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SLAM = ROOT / "estimator" / "slam"
# particle and smoothing, bounds and the search for anchors have tests of their own rooms
ROOMS = ("models", "association", "gaussian")
ALONE = ("mixture_reduction.py", "protocol.py", "run.py", "methods.py", "archive.py")


def imported(file: Path) -> set[str]:
    """Dotted names that a file imports: modules, and what is imported from them."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


@pytest.fixture(scope="module")
def tested() -> set[str]:
    """All that tests import."""
    return set().union(*(imported(file) for file in (ROOT / "tests").rglob("test_*.py")))


def modules() -> list[str]:
    """Modules of the rooms, by their dotted names."""
    files = [file for room in ROOMS for file in (SLAM / room).rglob("*.py")] + [SLAM / name for name in ALONE]
    names = (".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files)
    return sorted(name for name in names if not name.endswith("__init__"))


@pytest.mark.parametrize("module", modules())
def test_every_module_has_a_test(module: str, tested: set[str]) -> None:
    """A module that only whole runs go through could be wrong in all that they do not show."""
    assert module in tested
