"""Range sets of others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimator.errors import FileFormatError, InputError
from estimator.readers.range_sets import load_ranges
from estimator.slam.run import config_for

RANGES = np.array([5.0, 6.0, 7.0, -0.01, 9.0])
OFFSETS = np.array([0, 2, 3, 3, 5])  # two epochs of two anchors; the first of epoch 1 is silent
ANCHORS = [(1.0, 2.0), (3.0, 4.0)]


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """A small range set."""
    np.savez(tmp_path / "ranges.npz", range_m=RANGES, offsets=OFFSETS)
    return tmp_path / "ranges.npz"


def test_ranges_are_cut_into_epochs_and_anchors(archive: Path) -> None:
    """Every range lands where the offsets put it; places are relative to the start."""
    measured = load_ranges(archive, ANCHORS, 0.1, (1.0, 1.0), 0.5, model={"region_m": 30.0})
    lengths = [[paths.range_m.round(6).tolist() for paths in epoch.paths] for epoch in measured.epochs]
    assert lengths == [[[5.0, 6.0], [7.0]], [[], [0.001, 9.0]]]  # noise made one range negative
    np.testing.assert_allclose(measured.epochs[0].paths[0].range_std_m, 0.1)
    assert [epoch.time_s for epoch in measured.epochs] == [0.0, 0.5]
    np.testing.assert_allclose(measured.known_anchors_m, [[0.0, 1.0], [2.0, 3.0]])
    model = config_for(measured).noise
    assert (model.range_std_m, model.region_m, model.height2_std_m2) == (0.1, 30.0, 0.0)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"range_m": RANGES}, "arrays range_m and offsets"),
        ({"range_m": RANGES * np.nan, "offsets": OFFSETS}, "expected finite ranges"),
        ({"range_m": RANGES[:, None], "offsets": OFFSETS}, "in one axis"),
        ({"range_m": RANGES, "offsets": OFFSETS[::-1]}, "rise from 0 to the number of ranges, 5"),
        ({"range_m": RANGES, "offsets": OFFSETS[:-1]}, "rise from 0 to the number of ranges, 5"),
        ({"range_m": RANGES, "offsets": OFFSETS.astype(float)}, "rise from 0"),
        ({"range_m": RANGES, "offsets": np.array([0, 2, 3, 5])}, "each of 2 anchors, got 3 cells"),
        ({"range_m": np.array([object()]), "offsets": OFFSETS}, "could not read it"),
    ],
)
def test_other_layouts_are_refused(tmp_path: Path, columns: dict[str, object], words: str) -> None:
    """What is missing or does not fit is named; nothing is unpickled."""
    np.savez(tmp_path / "bad.npz", **columns)
    with pytest.raises(FileFormatError, match=words):
        load_ranges(tmp_path / "bad.npz", ANCHORS, 0.1)


def test_files_that_are_none(tmp_path: Path, archive: Path) -> None:
    """A missing file and a truncated one."""
    with pytest.raises(FileFormatError, match="found nothing there"):
        load_ranges(tmp_path / "no.npz", ANCHORS, 0.1)
    archive.write_bytes(archive.read_bytes()[:100])
    with pytest.raises(FileFormatError, match="could not read it"):
        load_ranges(archive, ANCHORS, 0.1)


@pytest.mark.parametrize(
    ("anchors", "std", "start", "words"),
    [
        ([(1.0, 2.0, 3.0)], 0.1, (0.0, 0.0), "expected shapes"),
        ([(1.0, np.nan)], 0.1, (0.0, 0.0), "finite"),
        (ANCHORS, -0.1, (0.0, 0.0), "positive numbers, got -0.1"),
    ],
)
def test_unusable_numbers(archive: Path, anchors: object, std: float, start: object, words: str) -> None:
    """Shapes, NaN and signs are checked."""
    with pytest.raises(InputError, match=words):
        load_ranges(archive, anchors, std, start)
