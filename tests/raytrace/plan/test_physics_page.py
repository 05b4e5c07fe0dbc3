"""The page on physics says what plans really take."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from raytrace.plan.files import floorplan_schema, load_floorplan, parse_floorplan
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.plan_summary import floorplan_summary

PAGE = (Path(__file__).parents[3] / "docs" / "physics.md").read_text(encoding="utf-8")


def merged(base: dict[str, Any], more: dict[str, Any]) -> dict[str, Any]:
    both = dict(base)
    for key, value in more.items():
        both[key] = (
            merged(base[key], value) if isinstance(value, dict) and isinstance(base.get(key), dict) else value
        )
    return both


def test_snippets_make_a_plan() -> None:
    """All TOML of the page, put into the L-room together, is a plan, with everything it says in it."""
    data = load_floorplan("l-room").model_dump(mode="json", exclude_none=True)
    snippets = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    assert len(snippets) == 5
    for snippet in snippets:
        data = merged(data, tomllib.loads(snippet))
    data["walls"][0]["material"] = "panel"
    plan = parse_floorplan(data)
    assert [target.section_m2 for target in plan.targets[:2]] == [1.0, 10.0]
    assert [target.kind for target in plan.targets] == ["point", "point", "human", "agv"]
    assert list(plan.by_agent()) == ["agent", "ann"]
    assert plan.permittivity_of("panel", 28e9).real == 2.0
    assert plan.scattering_pattern_of("concrete").pattern == "backscattering"
    drift = "clocks differ by 2.36e-06 s, delays are unambiguous within 1.04e-06 s"
    assert drift in floorplan_summary(plan)["warnings"]
    assert parse_floorplan(plan.model_dump(mode="json", exclude_none=True)) == plan


def fields_of(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield prefix + name
        for part in re.findall(r"raytrace\.plan\.\w+\.(\w+)", str(field.annotation)):
            kind = next(kind for kind in parts() if kind.__name__ == part)
            yield from fields_of(kind, f"{prefix}{name}.")


def parts() -> list[type[BaseModel]]:
    from raytrace.plan.links import Part

    found, waiting = [], [Part]
    while waiting:
        kinds = waiting.pop().__subclasses__()
        found += kinds
        waiting += kinds
    return found


def test_fields_of_the_table_exist() -> None:
    """Every dotted field that the page names is one of the plan's, and those of the schema's parts."""
    known = set(fields_of(FloorPlan))
    named = set(re.findall(r"`((?:agent|anchors|echo|radio|tracing|walls)\.[a-z_.]+)`", PAGE))
    assert len(named) > 20
    assert named - known == set()
    schema = floorplan_schema()
    later = {"Target", "Clock", "Material", "ScatteringPattern", "AnchorArray", "FurtherAgent"}
    assert later <= set(schema["$defs"])
    fields = {"targets", "materials", "scattering_patterns", "agents"}
    assert fields <= set(schema["properties"])
    assert not fields & set(schema["required"])
