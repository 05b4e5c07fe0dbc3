"""Groups of settings: frozen dataclasses whose fields say which values they take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from estimator.errors import ConfigurationError

__all__ = [
    "SettingGroups",
    "Settings",
    "any_number",
    "not_negative",
    "positive",
    "probability",
    "share",
    "up_to_one",
]

Groups = TypeVar("Groups", bound="SettingGroups")

_RULES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "positive": (lambda value: value > 0, "a positive number"),
    "not_negative": (lambda value: value >= 0, "zero or a positive number"),
    "probability": (lambda value: 0 < value < 1, "a number between 0 and 1"),
    "up_to_one": (lambda value: 0 < value <= 1, "a positive number up to 1"),
    "share": (lambda value: 0 <= value <= 1, "a number from 0 to 1"),
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


def up_to_one(default: float) -> Any:
    """A field that takes numbers above 0 and up to 1."""
    return field(default=default, metadata={"rule": "up_to_one"})


def share(default: float) -> Any:
    """A field that takes numbers from 0 to 1."""
    return field(default=default, metadata={"rule": "share"})


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


class SettingGroups:
    """Base of configurations: frozen dataclasses whose fields are groups of settings.

    The names of settings are unique over all groups: :meth:`of` and :meth:`but` take them without the
    groups' names.
    """

    @classmethod
    def of(cls: type[Groups], **settings: Any) -> Groups:
        """The default with some settings changed, by their names alone; see :meth:`but`."""
        return cls().but(**settings)

    def but(self: Groups, **settings: Any) -> Groups:
        """The configuration with some settings changed, by their names alone.

        Raises
        ------
        ConfigurationError
            If there is no setting of that name, or its value is out of range.
        """
        unknown = sorted(set(settings) - set(self.flat()))
        if unknown:
            name = type(self).__name__
            raise ConfigurationError(f"{name}: expected names of settings, got {', '.join(unknown)}")
        groups = {}
        for name, group in self._groups().items():
            own = {one.name: settings[one.name] for one in fields(group) if one.name in settings}
            if own:
                groups[name] = replace(group, **own)
        return replace(self, **groups)  # type: ignore[type-var]

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The names of all settings."""
        return tuple(cls().flat())

    def flat(self) -> dict[str, Any]:
        """All settings by their names."""
        return {
            one.name: getattr(group, one.name) for group in self._groups().values() for one in fields(group)
        }

    def _groups(self) -> dict[str, Any]:
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}  # type: ignore[arg-type]
