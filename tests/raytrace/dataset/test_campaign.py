"""Many datasets from one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import tomli_w

from estimator.dataset import open_dataset
from estimator.errors import FileFormatError
from raytrace.dataset.campaign import load_campaign, run_campaign
from raytrace.dataset.generate import generate
from raytrace.plan.files import FloorPlanError, load_floorplan, updated

Digests = Callable[[Path], dict[str, str]]

CAMPAIGN = """
format = "hapslam-campaign"
version = 1
scenes = ["l-room", "mine.toml"]
seeds = [3, 4]
licence = "CC0-1.0"

[[setups]]
name = "short"
set = {"agent.epochs" = 4, "radio.subcarriers" = 400, "tracing.engine" = "images"}

[[setups]]
name = "quiet"
set = {"agent.epochs" = 4, "radio.subcarriers" = 400, "tracing.engine" = "images", "radio.eirp_dbm" = 0.0}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A campaign, with a plan of its own beside it."""
    plan = updated(load_floorplan("l-room"), {"name": "mine", "agent.height_m": 1.2})
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(plan.model_dump(mode="json", exclude_none=True)))
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    return tmp_path / "campaign.toml"


def test_every_combination_is_a_dataset(file: Path, tmp_path: Path, digests: Digests) -> None:
    """Two scenes, set-ups and seeds make eight; each is what `generate` makes; again, nothing is done."""
    told: list[tuple[int, int]] = []
    made = run_campaign(file, tmp_path / "out", lambda done, total, _: told.append((done, total)))
    assert sorted(path.name for path in made) == sorted(
        f"{scene}-{setup}-seed{seed}"
        for scene in ("l-room", "mine")
        for setup in ("short", "quiet")
        for seed in (3, 4)
    )
    assert told == [(done, 8) for done in range(9)]
    manifest = open_dataset(tmp_path / "out" / "mine-quiet-seed4").manifest
    assert (manifest["name"], manifest["seed"], manifest["radio"]["eirp_dbm"]) == ("mine", 4, 0.0)
    assert manifest["output"]["licence"] == "CC0-1.0"
    plan = updated(
        load_floorplan("l-room"), {"agent.epochs": 4, "radio.subcarriers": 400, "tracing.engine": "images"}
    )
    alone = generate(plan, tmp_path / "alone", 3)
    both = (digests(alone.dataset.path), digests(tmp_path / "out" / "l-room-short-seed3"))
    assert both[0]["passive-00000.nc"] == both[1]["passive-00000.nc"]
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.nc")}
    run_campaign(file, tmp_path / "out")
    assert {path: path.stat().st_mtime_ns for path in before} == before


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"l-room", ', '"nowhere", ', "nowhere: expected a floor plan file"),
        (
            '"agent.epochs" = 4, "radio.subcarriers" = 400, "tracing.engine" = "images"}',
            '"agent.legs" = 2}',
            "agent.legs",
        ),
        ("version = 1", "version = 2", "version"),
        ("seeds = [3, 4]", "seeds = [3, 3]", "l-room-short-seed3 twice"),
        ("seeds = [3, 4]", "seeds = [-1]", "seeds.0"),
        ("seeds", "seed", "seed"),
        ('name = "quiet"', 'name = "../quiet"', r"setups\[1\]\.name"),
        ("scenes =", "scenes", "expected a campaign in TOML"),
    ],
)
def test_what_is_wrong_is_told_before_anything_is_traced(
    file: Path, tmp_path: Path, old: str, new: str, words: str
) -> None:
    """Bad files, unknown scenes and values, runs of one name: an error that names it, and no folder."""
    file.write_text(CAMPAIGN.replace(old, new))
    with pytest.raises((FileFormatError, FloorPlanError), match=words):
        run_campaign(file, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_campaign_that_is_not_there(tmp_path: Path) -> None:
    """A missing file is named."""
    with pytest.raises(FileFormatError, match="nothing.toml: expected a campaign"):
        load_campaign(tmp_path / "nothing.toml")
