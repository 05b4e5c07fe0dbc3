"""Groups of settings: frozen dataclasses whose fields say which values they take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from estimator.errors import ConfigurationError

__all__ = ["Settings", "any_number", "not_negative", "positive", "probability"]

_RULES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "positive": (lambda value: value > 0, "a positive number"),
    "not_negative": (lambda value: value >= 0, "zero or a positive number"),
    "probability": (lambda value: 0 < value < 1, "a number between 0 and 1"),
    "any": (lambda value: True, "a finite number"),
}


def positive(default: float) -> Any:
    """A field that takes finite numbers above zero."""
    return field(default=default, metadata={"rule": "positive"})


def not_negative(default: float) -> Any:
    """A field that takes zero and finite numbers above it."""
    return field(default=default, metadata={"rule": "not_negative"})


def probability(default: float) -> Any:
    """A field that takes numbers above 0 and below 1."""
    return field(default=default, metadata={"rule": "probability"})


def any_number(default: float) -> Any:
    """A field that takes any finite number."""
    return field(default=default, metadata={"rule": "any"})


@dataclass(frozen=True)
class Settings:
    """Base of groups of settings: checks every field when an instance is made.

    Raises
    ------
    ConfigurationError
        If a value is not a finite number, not whole where things are counted, or not one that its field
        takes.
    """

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            holds, expected = _RULES[entry.metadata.get("rule", "any")]
            name = f"{type(self).__name__}.{entry.name}"
            if not isinstance(value, (int, float, np.number)) or not np.isfinite(value):
                raise ConfigurationError(f"{name}: expected a finite number, got {value!r}")
            if entry.type == "int" and not isinstance(value, (int, np.integer)):
                raise ConfigurationError(f"{name}: expected a whole number, got {value!r}")
            if not holds(value):
                raise ConfigurationError(f"{name}: expected {expected}, got {value!r}")
