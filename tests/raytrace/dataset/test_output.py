"""Shards: which epochs, how large, and what they hold."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from estimator.dataset import Dataset
from estimator.errors import ConfigurationError
from estimator.waveform import frequency_response
from raytrace.dataset.output import Output
from raytrace.dataset.shard_task import ShardTask
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan


@pytest.mark.parametrize(("epochs", "joints"), [(40, ()), (41, ()), (1, ()), (40, (25,)), (50, (25, 41))])
def test_ranges_cover_every_epoch_once(epochs: int, joints: tuple[int, ...]) -> None:
    """Shards follow each other without gaps, none is larger than asked, and one begins at every joint."""
    ranges = Output(shard_epochs=10, joints=joints).ranges(epochs)
    assert ranges[0][0] == 0
    assert ranges[-1][1] == epochs
    assert all(before[1] == after[0] for before, after in pairwise(ranges))
    assert all(0 < stop - first <= 10 for first, stop in ranges)
    assert set(joints) <= {first for first, _ in ranges}


def test_shards_are_chosen_to_fit_in_memory() -> None:
    """1024 epochs, or as many as fit 64 MiB of complex channels."""
    plan = load_floorplan("l-room")
    assert Output().chosen(plan).shard_epochs == 1024
    large = updated(plan, {"radio.agent_array.elements": 64})
    chosen = Output().chosen(large).shard_epochs
    assert 0.95 < chosen * 2 * 64 * 819 * 16 / 2**26 <= 1
    assert Output(shard_epochs=7).chosen(large).shard_epochs == 7


@pytest.mark.parametrize(
    ("changes", "words"), [({"shard_epochs": -1}, "shard_epochs: expected"), ({"content": "cif"}, "cfr, cir")]
)
def test_nonsense_is_refused(changes: dict[str, object], words: str) -> None:
    """A negative size or an unknown content is told."""
    with pytest.raises(ConfigurationError, match=words):
        Output(**changes)  # type: ignore[arg-type]


def test_the_first_shard_draws_what_a_whole_dataset_draws(short_plan: FloorPlan) -> None:
    """Streams are the seed's children; shards take stretches of them that do not meet."""
    whole = [np.random.default_rng(child) for child in np.random.SeedSequence(3).spawn(4)]
    tasks = [ShardTask(short_plan, 3, Output(), index, 0, 40) for index in range(3)]
    draws = np.stack([task.stream("passive").standard_normal(1000) for task in tasks])
    np.testing.assert_array_equal(draws[0], whole[0].standard_normal(1000))
    correlation = np.corrcoef(draws)[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < 5 / np.sqrt(1000)
    shared = [task.stream("calibration", shared=True).standard_normal() for task in tasks]
    assert len(set(shared)) == 1


def test_every_shard_says_its_epochs_and_how_complete_it_is(sharded: Dataset) -> None:
    """Entries come by epoch, passive, echo, paths; those of paths count what was found."""
    shards = sharded.manifest["shards"]
    kinds = [(entry["kind"], *entry.get("epochs", ())) for entry in shards]
    assert kinds == [
        *[("passive", 0, 10), ("echo", 0, 10), ("paths", 0, 10)],
        *[("passive", 10, 20), ("echo", 10, 20), ("paths", 10, 20)],
        *[("passive", 20, 30), ("paths", 20, 30)],
        *[("passive", 30, 40), ("echo", 30, 40), ("paths", 30, 40)],
        ("truth",),
    ]
    checks = [entry["check"] for entry in shards if entry["kind"] == "paths"]
    valid = [int(shard["path_valid"].sum()) for shard in sharded.shards("paths")]
    assert [check["found"] for check in checks] == valid
    assert sharded.manifest["statistics"]["passive"]["found"] == sum(valid)
    assert sum(check["missing"] + check["extra"] for check in checks) == 0
    assert [int(shard["sweep_epoch"][0]) for shard in sharded.shards("echo")] == [0, 12, 39]


def test_impulse_and_frequency_responses_are_the_same_channels(sharded: Dataset) -> None:
    """The DFT of the taps is the CFR, to single precision; taps are one resolution apart."""
    for shard in sharded.shards("passive"):
        cfr, cir = (
            shard[f"{name}_re"].values + 1j * shard[f"{name}_im"].values.astype(float)
            for name in ("cfr", "cir")
        )
        grid = load_floorplan("l-room").radio.grid()
        error = np.abs(frequency_response(cir, grid) - cfr)
        assert error.max() < 1e-6 * np.abs(cfr).max()
        np.testing.assert_allclose(np.diff(shard["tap_delay_s"]), grid.resolution_s)
        assert shard["tap_delay_s"].attrs["units"] == "s"
