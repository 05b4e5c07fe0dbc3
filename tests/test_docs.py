"""The documentation tells the truth: snippets run, links lead somewhere, the tree exists."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "docs/conventions.md",
    "docs/datasets.md",
    "docs/estimator.md",
    "docs/measured.md",
    "docs/plans.md",
    "docs/twin.md",
]


def blocks(page: str) -> Iterator[tuple[str, str]]:
    """Language and text of the fenced blocks of a page, in order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    yield from re.findall(r"^```(\w+)\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES)
def test_snippets_run(
    page: str, main: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The `$ hapslam` lines and the Python blocks of a page run in their order in one folder."""
    monkeypatch.chdir(tmp_path)
    for language, text in blocks(page):
        if language == "python":
            exec(compile(text, page, "exec"), {"__name__": "__main__"})
        elif language == "console":
            for line in text.splitlines():
                command, *arguments = shlex.split(line.removeprefix("$ "))
                assert command == "hapslam", f"{page}: expected '$ hapslam ...', got {line!r}"
                run = main(*arguments)
                assert run.status == 0, f"{page}: {line}: {run.err}"


def test_the_stages_of_an_epoch_name_real_modules() -> None:
    """The walk of one epoch through the engine leads to files that exist, and names each stage once."""
    text = (ROOT / "docs/estimator.md").read_text(encoding="utf-8")
    walk = text.split("## One epoch through the Gaussian engine")[1].split("\n## ")[0]
    modules = re.findall(r"`([\w/]+\.py)`", walk.split("| --- |")[-1])
    assert len(modules) == len(set(modules)) > 10
    for module in modules:
        assert (ROOT / "estimator/slam" / module).is_file(), module


def test_the_readme_has_snippets() -> None:
    """The README shows the command line and the library at work."""
    assert {"console", "python", "sh"} <= {language for language, _ in blocks("README.md")}


def test_the_readme_names_real_targets() -> None:
    """The make targets that the README and CONTRIBUTING name exist."""
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    for page in ("README.md", "CONTRIBUTING.md"):
        named = re.findall(
            r"^(?: {4})?make (\w+)", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE
        )
        assert named
        assert set(named) <= targets


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    """Links to files of the repository point to files that are there."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        if "://" not in target:
            assert ((ROOT / page).parent / target).exists(), target


def test_the_tree_of_the_readme_exists() -> None:
    """Every file and folder of the README's tree is there."""
    tree = re.search(
        r"^```\n(scenes/.*?)^```$", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S
    )
    assert tree is not None
    folder = ROOT
    for line in tree[1].splitlines():
        name = line.split()[0]
        place = (folder if line.startswith(" ") else ROOT) / name
        assert place.is_dir() if name.endswith("/") else place.is_file(), line
        if not line.startswith(" "):
            folder = place
