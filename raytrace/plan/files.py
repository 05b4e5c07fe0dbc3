"""Floor plans from TOML files and to them, checked on reading, and the JSON Schema of their format.

:func:`load_floorplan` reads a file or one of the shipped scenes; whatever is wrong with it
is told in one line that names the file, the field, what was expected and what came.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, cast

import tomli_w
from pydantic import ValidationError

from estimator.dataset import require_absent, write_text
from estimator.errors import InputError
from raytrace.plan.checks import check_plan
from raytrace.plan.errors import PlanFault, one_line
from raytrace.plan.floorplan import FORMAT, VERSION, FloorPlan
from raytrace.plan.links import Part
from raytrace.plan.sound_walls import sound_walls

__all__ = [
    "FloorPlanError",
    "floorplan_schema",
    "floorplan_text",
    "load_floorplan",
    "parse_floorplan",
    "save_floorplan",
    "shipped_scenes",
    "updated",
]


class FloorPlanError(InputError):
    """A floor plan is missing, cannot be parsed, or describes something impossible."""


def parse_floorplan(data: Mapping[str, Any], source: str = "floor plan") -> FloorPlan:
    """Build a plan from the contents of a TOML file, make its walls sound, and check that it makes sense.

    Parameters
    ----------
    data : mapping
        What :mod:`tomllib` returns.
    source : str
        The file's name, for messages.

    Raises
    ------
    FloorPlanError
        In one line: the file, the field, what was expected, and what came.
    """
    for key, wanted in (("format", FORMAT), ("version", VERSION)):
        if key not in data or data[key] != wanted or isinstance(data[key], bool):
            came = repr(data[key]) if key in data else "nothing"
            raise FloorPlanError(f"{source}: {key}: expected {wanted!r}, got {came}")
    if data.get("floor", 0) is None or data.get("ceiling", 0) is None:
        data = {key: value for key, value in data.items() if value is not None}
    try:
        plan = FloorPlan.model_validate(dict(data))
    except ValidationError as error:
        raise FloorPlanError(f"{source}: {one_line(error)}") from error
    try:
        plan = plan.repaired(*sound_walls(plan.walls))
        check_plan(plan)
    except PlanFault as fault:
        raise FloorPlanError(f"{source}: {fault}") from fault
    return plan


def load_floorplan(path_or_name: str | Path) -> FloorPlan:
    """Read a plan from a TOML file, or a shipped scene by its name (``"l-room"``).

    Raises
    ------
    FloorPlanError
        If there is no such file or scene, it is no TOML, or the plan is not valid.
    """
    path = Path(path_or_name)
    if not path.is_file() and str(path_or_name) in shipped_scenes():
        path = _scene_folder() / f"{path_or_name}.toml"
    if not path.is_file():
        names = ", ".join(shipped_scenes())
        raise FloorPlanError(
            f"{path_or_name}: expected a floor plan file or one of {names}; nothing is there"
        )
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))  # Windows' Notepad begins with a mark
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FloorPlanError(f"{path}: expected a TOML file, could not read it: {error}") from error
    return parse_floorplan(data, source=str(path))


def shipped_scenes() -> tuple[str, ...]:
    """Names of the scenes that come with the package, sorted."""
    return tuple(sorted(path.stem for path in _scene_folder().glob("*.toml")))


def _scene_folder() -> Path:
    """The installed package holds its scenes; a source tree has them at its root."""
    packaged = Path(str(resources.files("raytrace"))) / "scenes"
    return packaged if packaged.is_dir() else packaged.parent.parent / "scenes"


def updated(plan: FloorPlan, changes: Mapping[str, Any]) -> FloorPlan:
    """A validated copy with some values changed, keyed by dotted names.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    changes : mapping
        For example ``{"agent.epochs": 20, "echo.model": "radar-equation"}``.

    Raises
    ------
    FloorPlanError
        If a name is unknown or the changed plan is not valid.
    """
    data = plan.model_dump(mode="json")
    for dotted, value in changes.items():
        *parents, last = dotted.split(".")
        node, part = data, cast(Any, plan)
        for parent in parents:
            part = getattr(part, parent, None)
            if isinstance(part, (Part, dict)):
                node.setdefault(parent, {})
            if not isinstance(node.get(parent), dict):
                raise FloorPlanError(f"{plan.name}: {dotted}: expected the name of a value, got {parent!r}")
            node = node[parent]
        node[last] = value
    return parse_floorplan(data, source=plan.name)


def save_floorplan(plan: FloorPlan, path: Path) -> None:
    """Write a plan as TOML; what is as by default is left out.

    Raises
    ------
    OutputExistsError
        If ``path`` exists; nothing is overwritten.
    """
    path = Path(path)
    require_absent(path)
    write_text(floorplan_text(plan), path)


def floorplan_text(plan: FloorPlan) -> str:
    """A plan as TOML; what is as by default is left out."""
    head = {"format": plan.format, "version": plan.version}
    values = plan.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    for wall, full in zip(values["walls"], plan.walls, strict=True):
        wall.update(height_m=full.height_m, material=full.material, thickness_m=full.thickness_m)
    return tomli_w.dumps({**head, **values})


def floorplan_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of the contents of a floor plan file."""
    schema = FloorPlan.model_json_schema(mode="validation")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": f"{FORMAT}, version {VERSION}",
    }
