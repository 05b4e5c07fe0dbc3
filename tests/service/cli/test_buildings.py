"""`hapslam reproduce buildings`: the same buildings however they are sensed and in however many processes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from estimator.errors import ConfigurationError
from service.cli.buildings import DEFAULT_KINDS, Building, building_plan, wanted_kinds

Runner = Callable[..., SimpleNamespace]


def test_a_building_is_the_same_however_it_is_sensed() -> None:
    """Walls, anchors and walk follow from seed, kind and number; sensing is what was asked for."""
    plain = building_plan(Building("suite", 3, 7))
    rich = building_plan(Building("suite", 3, 7, sweep_every=10, odometry=True, aoa=True))
    once = building_plan(Building("suite", 3, 7, sweep_every=0))
    assert plain.walls == rich.walls == once.walls
    assert plain.anchors == rich.anchors
    assert plain.agent.waypoints_m == rich.agent.waypoints_m
    assert plain.tracing.engine == "images"
    assert (plain.echo.sweep_every, rich.echo.sweep_every, once.sweep_epochs) == (1, 10, (0,))
    assert (plain.agent.odometry is None, rich.agent.odometry is None) == (True, False)
    assert rich.radio.agent_array.array().tells_azimuth
    assert not plain.radio.agent_array.array().tells_azimuth
    others = (Building("suite", 4, 7), Building("suite", 3, 8), Building("shops", 3, 7))
    assert all(building_plan(other).walls != plain.walls for other in others)


def test_kinds_are_those_of_the_generator() -> None:
    """An unknown kind is refused with the list of those that there are; none means the default ones."""
    assert wanted_kinds("") == DEFAULT_KINDS
    assert wanted_kinds("ring, suite,ring") == ("ring", "suite")
    with pytest.raises(ConfigurationError, match=r"kinds: expected some of rectangle, .*, got 'castle'"):
        wanted_kinds("castle")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fig13", "--odometry"], "expected with buildings, got fig13"),
        (["buildings", "--methods", "hybrid"], "expected none for buildings"),
        (["buildings", "--kinds", "castle"], "got 'castle'"),
    ],
)
def test_what_does_not_fit_is_refused(main: Runner, tmp_path: Path, arguments: list[str], words: str) -> None:
    """Options of buildings belong to buildings, methods to figures; nothing is written."""
    run = main("reproduce", *arguments, "--out", tmp_path / "out")
    assert run.status == 2
    assert words in " ".join(run.err.split())
    assert not (tmp_path / "out").exists()


def timeless(printed: dict[str, Any]) -> dict[str, Any]:
    """Figures without the seconds, which differ from run to run."""
    return {
        name: timeless(value) if isinstance(value, dict) else value
        for name, value in printed.items()
        if not name.startswith("seconds")
    }


@pytest.mark.soak
def test_figures_do_not_depend_on_the_number_of_processes(main: Runner, tmp_path: Path) -> None:
    """Two buildings by one process and by two: the same figures but for the seconds."""
    arguments = ["reproduce", "buildings", "--kinds", "suite,shops", "--seed", 5, "--json", "--quiet"]
    one = main(*arguments, "--jobs", 1, "--out", tmp_path / "one")
    two = main(*arguments, "--jobs", 2, "--out", tmp_path / "two")
    assert (one.status, two.status) == (0, 0), one.err + two.err
    assert timeless(json.loads(one.out)) == timeless(json.loads(two.out))
    assert set(json.loads(one.out)) == {"suite", "shops", "all"}


@pytest.mark.soak
@pytest.mark.parametrize(
    ("options", "most_lost", "most_silent"),
    [
        (["--sweep-every", 1], 1, 0),
        (["--sweep-every", 2], 2, 1),
        (["--sweep-every", 10, "--odometry"], 2, 2),
        (["--sweep-every", 0], 100, 2),
    ],
)
def test_random_buildings_are_mapped(
    main: Runner,
    tmp_path: Path,
    record_property: Callable[[str, object], None],
    options: list[object],
    most_lost: int,
    most_silent: int,
) -> None:
    """100 random plans, 20 a kind: how many may be lost, and how many in silence, by how they are sensed."""
    run = main(
        "reproduce", "buildings", "--runs", 20, "--seed", 90210, *options, "--out", tmp_path / "out", "--json"
    )
    assert run.status == 0, run.err
    figures = json.loads(run.out)["all"]
    record_property("figures", json.dumps(figures))
    assert figures["lost"] <= most_lost
    assert figures["silent"] <= most_silent
