"""What the other tests of files do with the image method's paths, once with those of the ray tracer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from estimator.dataset import Dataset
from raytrace.dataset.append import append
from raytrace.dataset.campaign import run_campaign
from raytrace.dataset.generate import generate, generate_part
from raytrace.dataset.merge import merge
from raytrace.dataset.output import Output
from raytrace.dataset.verify import verify
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan

Digests = Callable[[Path], dict[str, str]]
CUT = Output(shard_epochs=3)
CAMPAIGN = """
format = "hapslam-campaign"
version = 1
scenes = ["l-room"]
shard_epochs = 3
setups = [{ name = "short", set = { "agent.epochs" = 6 } }]
"""


@pytest.fixture
def plan() -> FloorPlan:
    return updated(load_floorplan("l-room"), {"agent.epochs": 6})


@pytest.fixture
def whole(plan: FloorPlan, tmp_path: Path) -> Dataset:
    """Six epochs in two shards, made at once."""
    return generate(plan, tmp_path / "whole", 1, output=CUT).dataset


def test_traced_paths_are_complete(whole: Dataset) -> None:
    """Nothing is missing, extra or wrong beside the image method; the manifest says who traced."""
    result = verify(whole)
    assert result.ok
    assert result.found == result.expected > 100
    assert {"sionna-rt", "mitsuba", "drjit", "numpy", "llvm"} <= set(whole.manifest["versions"])


def test_traced_parts_make_the_whole(
    plan: FloorPlan, whole: Dataset, tmp_path: Path, digests: Digests
) -> None:
    """Two parts, merged, have the bytes of a dataset made at once."""
    for number in (1, 2):
        generate_part(plan, tmp_path / str(number), 1, (number, 2), output=CUT)
    merged = merge(plan, [tmp_path / "2", tmp_path / "1"], tmp_path / "merged")
    assert digests(merged.path) == digests(whole.path)


def test_traced_walks_grow(plan: FloorPlan, whole: Dataset, tmp_path: Path, digests: Digests) -> None:
    """Three epochs appended to six have the shards of six made at once."""
    generate(updated(plan, {"agent.epochs": 3}), tmp_path / "grown", 1, output=CUT)
    append(tmp_path / "grown", 6)
    grown, once = digests(tmp_path / "grown"), digests(whole.path)
    shards = [entry["file"] for entry in whole.manifest["shards"]]
    assert len(shards) > 4
    assert [grown[name] for name in shards] == [once[name] for name in shards]


def test_a_traced_campaign_is_its_datasets(whole: Dataset, tmp_path: Path, digests: Digests) -> None:
    """A campaign's dataset has the channels and paths that the same plan has alone."""
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    (made,) = run_campaign(tmp_path / "campaign.toml", tmp_path / "out")
    ours, alone = digests(made), digests(whole.path)
    assert {name: ours[name] for name in alone if name.endswith(".nc")} == {
        name: digest for name, digest in alone.items() if name.endswith(".nc")
    }
