"""The rooms of the house and the directions between them."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LATE = {
    "main.py",
    "dataset.py",
    "scene.py",
    "buildings.py",
    "leakage.py",
    "raytrace_rows.py",
    "twin.py",
    "twin_plan.py",
    "twins.py",
    "known_plan.py",
}  # of the service, import raytrace

BLOCKED = """
import importlib.abc, sys

class Block(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"mitsuba", "drjit", "sionna"}:
            raise ModuleNotFoundError(f"blocked: {name}", name=name)

sys.meta_path.insert(0, Block())
"""


def modules(package: str) -> list[str]:
    """All modules of a package, by their dotted names (migrations are scripts, run by Alembic alone)."""
    files = [file for file in sorted((ROOT / package).rglob("*.py")) if "migrations" not in file.parts]
    return [
        ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for file in files
    ]


def imports(file: Path) -> Iterator[tuple[str, bool]]:
    """Modules that a file imports, and whether it does so when it is itself imported."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    inner = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        or (isinstance(function, ast.If) and ast.unparse(function.test) == "TYPE_CHECKING")
        for node in ast.walk(function)
    }
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: expected absolute imports"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        yield from ((name, id(node) not in inner) for name in names)


def run(code: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a fresh interpreter, in the root of the repository."""
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("package", ["estimator", "raytrace", "service"])
def test_everything_imports_where_the_ray_tracer_is_absent(package: str) -> None:
    """No module imports Mitsuba, Dr.Jit or Sionna at its top: each imports with these blocked."""
    names = modules(package)
    assert len(names) > 3
    done = run(BLOCKED + f"import importlib\nfor name in {names}: importlib.import_module(name)")
    assert done.returncode == 0, done.stderr


def test_importing_loads_no_ray_tracer() -> None:
    """`import estimator` and `import service`, with all their modules, leave Mitsuba and raytrace alone."""
    names = modules("estimator") + modules("service")
    code = f"import importlib, sys\nfor name in {names}: importlib.import_module(name)\n"
    done = run(code + "print(*sorted({name.split('.')[0] for name in sys.modules}))")
    assert done.returncode == 0, done.stderr
    assert not {"mitsuba", "drjit", "sionna", "raytrace"} & set(done.stdout.split())


def test_the_command_line_starts_light() -> None:
    """The command line imports neither NumPy nor Matplotlib before a command needs them."""
    done = run("import service.cli.main, sys; print(*sys.modules)")
    assert done.returncode == 0, done.stderr
    assert not {"numpy", "scipy", "xarray", "matplotlib"} & set(done.stdout.split())


def test_only_the_command_line_imports_the_ray_tracer_and_late() -> None:
    """Of estimator and service, the command line alone imports raytrace, and that inside its commands."""
    for package in ("estimator", "service"):
        for file in (ROOT / package).rglob("*.py"):
            for name, at_import in imports(file):
                if name.split(".")[0] == "raytrace":
                    assert file.name in LATE, f"{file}: {name}"
                    assert not at_import, f"{file}: {name}"
                if package == "estimator":
                    assert name.split(".")[0] != "service", f"{file}: {name}"


def test_files_are_small() -> None:
    """A module is one idea: none is longer than 400 lines."""
    for package in ("estimator", "raytrace", "service"):
        for file in (ROOT / package).rglob("*.py"):
            assert len(file.read_text(encoding="utf-8").splitlines()) <= 400, file
