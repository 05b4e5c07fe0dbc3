"""Several agents in one plan: a dataset of each, as if it were alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.dataset import open_dataset
from estimator.errors import ConfigurationError, OutputExistsError
from raytrace.dataset.agents import generate_agents, seed_of
from raytrace.dataset.generate import generate
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.plan_summary import floorplan_summary


@pytest.fixture(scope="module")
def pair() -> FloorPlan:
    data = load_floorplan("l-room").model_dump(mode="json", exclude_none=True)
    data["agent"]["epochs"] = 5
    data["tracing"]["engine"] = "images"
    data["agents"] = [
        {"name": "ann", "waypoints_m": [[70.0, 20.0], [70.0, 50.0]], "epochs": 4, "orientation": "travel"}
    ]
    return parse_floorplan(data)


def test_each_agent_has_a_dataset(
    pair: FloorPlan, tmp_path: Path, digests: Callable[[Path], dict[str, str]]
) -> None:
    """The first agent's has the bytes it has alone; the other's has its own track, and noise of its own."""
    made = generate_agents(pair, tmp_path / "both", seed=3)
    assert [path.name for path in made] == ["agent", "ann"]
    data = pair.model_dump(mode="json", exclude_none=True)
    del data["agents"]
    generate(parse_floorplan(data), tmp_path / "alone", seed=3)
    assert digests(made[0]) == digests(tmp_path / "alone")
    ann = open_dataset(made[1])
    truth = ann.truth()
    np.testing.assert_allclose(truth["track_m"][0], [70.0, 20.0, 1.5])
    assert truth.attrs["heading_rad"] == pytest.approx(np.pi / 2)
    assert ann.manifest["seed"] == seed_of(3, 1) != 3
    assert ann.manifest["statistics"]["passive"]["missing"] == 0
    before = digests(made[1])
    assert generate_agents(pair, tmp_path / "both", seed=3, resume=True) == made
    assert digests(made[1]) == before
    with pytest.raises(OutputExistsError):
        generate_agents(pair, tmp_path / "both", seed=3)


def test_one_dataset_is_of_one_agent(pair: FloorPlan, tmp_path: Path) -> None:
    """A plan of several agents is refused where one dataset is to be made, before anything is traced."""
    with pytest.raises(ConfigurationError, match="l-room: expected a plan of one agent, got 2"):
        generate(pair, tmp_path / "one", seed=1)
    assert not (tmp_path / "one").exists()
    assert floorplan_summary(pair)["agents"] == ["agent", "ann"]


def test_warnings_of_clocks_and_speeds(pair: FloorPlan) -> None:
    """What makes delays or Doppler shifts ambiguous is told; the shipped plan has nothing of it."""
    assert floorplan_summary(pair)["warnings"] == []
    wild = updated(pair, {"agent.clock.offset_s": 2e-6, "agent.speed_m_s": 40.0, "radio.snapshots": 2})
    text = " | ".join(floorplan_summary(wild)["warnings"])
    for part in (
        "clocks differ by 2e-06 s",
        "within the 12 symbols",
        "shifts up to 3.74e+03 Hz are ambiguous",
    ):
        assert part in text
