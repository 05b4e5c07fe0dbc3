"""What is wrong with a request: where, what was expected, and what came."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

__all__ = ["WIDTH", "violations"]

WIDTH = 200  # characters of an offending value shown
_SHOWN = 20  # violations listed


def violations(errors: Iterable[Mapping[str, Any]], body: object = "") -> list[dict[str, str]]:
    """The first violations among Pydantic's errors.

    Parameters
    ----------
    errors : iterable of mapping
        Pydantic's.
    body : object
        What they are about, for places in JSON that cannot be read.
    """
    return [_violation(entry, body) for entry, _ in zip(errors, range(_SHOWN), strict=False)]


def _violation(entry: Mapping[str, Any], body: object) -> dict[str, str]:
    where, expected, got = entry["loc"], entry["msg"], _short(entry.get("input"))
    if entry["type"] == "missing":
        got = "nothing"
    elif entry["type"] == "json_invalid":
        place = int(where[-1])
        where, expected = where[:-1], f"{expected} at character {place}: {entry['ctx']['error']}"
        got = _short(str(body)[max(0, place - 10) : place + 10])
    return {
        "where": ".".join(str(part) for part in where)[:WIDTH],
        "expected": expected.encode("utf-8", "replace").decode(),
        "got": got,
    }


def _short(value: object) -> str:
    if isinstance(value, (dict, list, tuple, set)):
        text = f"a {type(value).__name__} of {len(value)}"
    elif isinstance(value, str):
        text = repr(value[:WIDTH])
    elif isinstance(value, int) and abs(value) > 10**30:
        text = "a huge number"
    else:
        text = repr(value)[:WIDTH]
    return text.encode("utf-8", "backslashreplace").decode()
