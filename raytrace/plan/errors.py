"""What pydantic finds wrong with a file of ours, in one line: the field, what was expected, what came."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import ValidationError

from estimator.errors import InputError

__all__ = ["PlanFault", "one_line"]


class PlanFault(InputError):
    """What is wrong with a plan: the field, what was expected, what came."""


def one_line(error: ValidationError) -> str:
    """The first fault of a pydantic error: field, what was expected, what came."""
    faults = error.errors(include_url=False)
    first = faults[0]
    field = "".join(_field_parts(first["loc"]))
    if first["type"] == "extra_forbidden":
        text = f"{field}: expected only known keys, got the unknown key {first['loc'][-1]!r}"
    elif first["type"] == "missing":
        text = f"{field}: expected a value, it is missing"
    else:
        wanted = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
        wanted = wanted if wanted.startswith("expected") else f"expected {wanted[0].lower()}{wanted[1:]}"
        came = "" if ", got " in wanted else f", got {_brief(first['input'])}"
        text = f"{field}: {wanted}{came}"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return text + more


def _field_parts(location: tuple[int | str, ...]) -> Iterator[str]:
    """``("walls", 2, "height_m")`` as the pieces of ``walls[2].height_m``."""
    for index, part in enumerate(location):
        if isinstance(part, int):
            yield f"[{part}]"
        else:
            yield f".{part}" if index else part


def _brief(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
