"""Files of strangers: what they are made of is checked before they are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from estimator.errors import FileFormatError, FileTooLargeError
from estimator.hdf5_guard import Hdf5Limits, check_hdf5
from estimator.measurement_files import load_measurements
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from tests.hostile_files import CANARY, REACHING, measurement_file, with_attribute, with_variable


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """A good measurement file."""
    paths = AnchorPaths(np.full(3, 1e-7), np.full(3, 1e-9), np.full(3, -90.0))
    epochs = tuple(Epoch(i, float(i), (paths, paths)) for i in range(40))
    walls = (GaussianVrp(np.array([8.0, 0.0]), 0.01 * np.eye(2)),)
    return measurement_file(MeasurementSet(("one", "two"), walls, epochs, 28e9), tmp_path)


def test_our_own_files_pass(good: Path) -> None:
    """A measurement file passes, and what it unpacks to is at least its arrays."""
    assert check_hdf5(good) > 40 * 2 * 3 * 8 * 3
    assert len(load_measurements(good).epochs) == 40


@pytest.mark.parametrize("kind", sorted(REACHING))
def test_what_reaches_for_other_files_is_refused(good: Path, tmp_path: Path, kind: str) -> None:
    """External storage, links, virtual layouts, groups and types of its own: one line, nothing is read."""
    (tmp_path / "canary.bin").write_bytes(CANARY * 1000)
    good.write_bytes(REACHING[kind](good, tmp_path / "canary.bin"))
    with pytest.raises(FileFormatError, match=r"walk\.nc, .*: expected .*, got"):
        load_measurements(good)


@pytest.mark.parametrize(
    ("limits", "change", "message"),
    [
        ({"variables": 3}, lambda d: None, "at most 3 variables"),
        ({"bytes": 1000}, lambda d: None, "unpack to at most 1000 bytes"),
        ({"attributes": 2}, lambda d: None, "at most 2 attributes"),
        ({"strings": 1}, lambda d: None, "at most 1 strings"),
        ({"string_bytes": 5}, lambda d: None, "strings of at most 5 bytes"),
        ({}, lambda d: d.create_dataset("x", (10**7,), "i1", chunks=(1,)), "at most 1000000 chunks"),
        ({}, lambda d: d.create_dataset("x", (1,), "f8", maxshape=(None,), chunks=(2**28,)), None),
        ({}, lambda d: d.create_dataset("x", (10**9,), "S100", chunks=(10**6,)), "unpack to at most"),
        ({"attribute_bytes": 99}, lambda d: d.attrs.create("x", np.zeros(100, "i1")), "at most 99 bytes"),
    ],
)
def test_sizes_are_added_up_before_anything_is_read(
    good: Path, limits: dict[str, int], change: Callable[[Any], Any], message: str | None
) -> None:
    """Variables, bytes with the element's size, attributes, strings, chunks: each has its limit."""
    with h5py.File(good, "r+") as data:
        change(data)
    if message is None:  # a chunk is not larger than what is allowed in all
        assert check_hdf5(good, Hdf5Limits(**limits)) >= 8 * 2**28
        message, limits = "unpack to at most 1000000 bytes", {"bytes": 1_000_000}
    with pytest.raises(FileTooLargeError, match=message):
        check_hdf5(good, Hdf5Limits(**limits))


def test_one_string_kept_a_thousand_times_counts_a_thousand_times(good: Path) -> None:
    """Names share their bytes in the file; what counts is what they unpack to."""
    with_variable(good, "anchor", shape=(2,), dtype=h5py.string_dtype())
    with h5py.File(good, "r+") as data:
        data["anchor"][:] = ["a" * 600_000] * 2
    with pytest.raises(FileTooLargeError, match="strings of at most 1048576 bytes"):
        check_hdf5(good)


@pytest.mark.parametrize(
    ("attribute", "message"),
    [
        ({"settings": "[" * 30_000}, "settings: expected JSON, could not read it: nested too deeply"),
        ({"settings": "[1]"}, "settings: expected a JSON object, got list"),
        ({"settings": 7}, "settings: expected a text of JSON, got int64"),
        ({"carrier_hz": np.ones(3)}, "expected the values of a measurement file"),
    ],
)
def test_attributes_of_strangers_are_one_line(good: Path, attribute: dict[str, Any], message: str) -> None:
    """Settings nested without end, of another type, a carrier of three numbers: no traceback."""
    good.write_bytes(with_attribute(good, **attribute))
    with pytest.raises(FileFormatError, match=message):
        load_measurements(good)
