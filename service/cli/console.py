"""What the command line prints on: text as it is, and folders for what it writes.

Names of plans, files and materials are the users', and packages have extras in brackets: the
terminal library's markup, emoji codes and highlighting are off for all that is printed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console

__all__ = ["made_parents", "plain_console"]


def plain_console(**options: Any) -> Console:
    """A console that prints brackets as brackets; ``options`` as of :class:`rich.console.Console`."""
    return Console(markup=False, emoji=False, highlight=False, **options)


def made_parents(path: Path | None) -> Path | None:
    """The same path, the folders above it made where they are missing: a callback of ``--out``."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
    return path
