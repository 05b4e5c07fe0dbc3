"""Files that are none: every reader says what was expected and where, and nothing else happens."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from estimator.errors import FileFormatError
from estimator.experiments.measured.responses import response_runs
from estimator.readers.csv_ranges import read_anchors, read_csv
from estimator.readers.mat_ranges import read_mat, read_mat_track
from estimator.readers.range_sets import read_range_set
from estimator.readers.response_files import read_responses
from estimator.readers.sensor_lines import read_sensor_lines
from estimator.readers.trajectories import read_track

BINARY = bytes(range(256))
CSV = {
    "empty": (b"", "a header and rows, got 0 lines"),
    "header alone": (b"time,anchor,range_m\n", "a header and rows, got 1 lines"),
    "binary": (BINARY, "text in UTF-8, got byte"),
    "nul": (b"time,anchor,range_m\n0,a,\x00\n", "got a binary file"),
    "no time": (b"when,anchor,range_m\n0,a,1\n", "expected a column time or time_s or timestamp"),
    "no range": (b"time,anchor,gain_db\n0,a,1\n", "expected one of range_m, delay_s, delay_ns"),
    "two ranges": (b"time,anchor,range_m,delay_ns\n0,a,1,3\n", "each quantity once"),
    "strange column": (b"time,anchor,range_m,colour\n0,a,1,red\n", "got 'colour'"),
    "same columns": (b"time,a,a\n0,1,2\n", "columns with names that differ"),
    "nameless column": (b"time,a,\n0,1,2\n", "columns with names that differ"),
    "short row": (b"time,anchor,range_m\n0,a,1\n1,a\n", "line 3: expected 3 columns, got 2"),
    "long row": (b"time,a\n0,1\n\n1,2,3\n", "line 4: expected 2 columns, got 3"),
    "a word": (b"time,anchor,range_m\n0,a,far\n", "line 2, column range_m: expected a number, got 'far'"),
    "an infinity": (b"time,a\n0,inf\n", "line 2, column a: expected a number, got 'inf'"),
    "no time stamp": (b"time,a\n,1\n", "line 2, column time: expected seconds or a date"),
    "no date": (b"time,a\n2022-13-45 9:00,1\n", "line 2, column time: expected seconds or a date"),
    "a flag": (b"time,anchor,range_m,asked\n0,a,1,maybe\n", "column asked: expected 0 or 1, got 'maybe'"),
    "not asked": (b"time,anchor,range_m,asked\n0,a,1,0\n", "no range of an anchor that was not asked"),
    "no spread": (b"time,anchor,range_m,range_std_m\n0,a,1,0\n", "range_std_m: expected positive numbers"),
    "nothing heard": (b"time,a,b\n0,,\n1,,\n", "ranges: expected at least one, got none"),
    "kilometres": (b"time,a\n0,1e9\n", "expected metres, none beyond"),
    "open quote": (b'time,a\n0,"1\n', "could not read it"),
    "long line": (b"time,a\n0," + b"1" * 70_000 + b"\n", "line 2: expected at most 65536 characters"),
}
SENSORS = {
    "empty": (b"", "of 1 to 1000 modules"),
    "no ranges": (b"odom2 0 1 2 3\n", "of 1 to 1000 modules"),
    "binary": (BINARY, "text in UTF-8"),
    "nul": (b"range2 0 1 0.01 0 0 7\x00\n", "got a binary file"),
    "one column": (b"range2\n", "line 1: expected 7 columns or more, got 1"),
    "short": (b"range2 0 1 0.01 0 0\n", "line 1: expected 7 columns or more, got 6"),
    "a word in time": (b"range2 now 1 0.01 0 0 7 0\n", "line 1, column time: expected a number, got 'now'"),
    "a word in range": (b"range2 0 far 0.01 0 0 7 0\n", "column range: expected a number"),
    "a word in variance": (b"range2 0 1 small 0 0 7 0\n", "column variance: expected a number"),
    "a word in x": (b"range2 0 1 0.01 west 0 7 0\n", "column x: expected a number"),
    "a word in y": (b"range2 0 1 0.01 0 north 7 0\n", "column y: expected a number"),
    "nan time": (b"range2 nan 1 0.01 0 0 7 0\n", "column time: expected a number"),
    "nan range": (b"range2 0 nan 0.01 0 0 7 0\n", "column range: expected a number"),
    "infinite range": (b"range2 0 inf 0.01 0 0 7 0\n", "column range: expected a number"),
    "no variance": (b"range2 0 1 0 0 0 7 0\n", "column variance: expected a positive number, got 0"),
    "negative variance": (b"range2 0 1 -1 0 0 7 0\n", "column variance: expected a positive number, got -1"),
    "moved": (b"range2 0 1 0.01 0 0 7 0\nrange2 1 1 0.01 1 0 7 0\n", "line 2: expected module 7 at"),
    "kilometres": (b"range2 0 1e9 0.01 0 0 7 0\n", "none beyond"),
    "commas": (b"range2,0,1,0.01,0,0,7\n", "of 1 to 1000 modules"),
    "long line": (b"range2 " + b"1" * 70_000 + b"\n", "line 1: expected at most 65536 characters"),
}
TRACKS = {
    "empty": (b"", "got no line"),
    "comments": (b"# timestamp tx ty tz qx qy qz qw\n", "got no line"),
    "header alone": (b"time,x,y\n", "got a header alone"),
    "no time": (b"x,y\n1,2\n", "expected a column time"),
    "binary": (BINARY, "text in UTF-8"),
    "nul": (b"0 1 2\x00\n", "got a binary file"),
    "short": (b"0 1\n", "line 1: expected 3 columns or more, got 2"),
    "short later": (b"0 1 2\n1 2\n", "line 2: expected 3 columns or more, got 2"),
    "a word in x": (b"0 here 2\n", "line 1, column x: expected a number, got 'here'"),
    "a word in y": (b"0 1 there\n", "line 1, column y: expected a number"),
    "a word in time": (b"now 1 2\n", "line 1, column time: expected seconds"),
    "nan x": (b"0 nan 2\n", "column x: expected a number"),
    "nan time": (b"nan 1 2\n", "column time: expected seconds"),
    "infinite y": (b"0 1 inf\n", "column y: expected a number"),
    "twice": (b"0 1 2\n0 1 2\n", "line 2, column time: expected a later one than 0.0"),
    "backwards": (b"5 1 2\n4 1 2\n", "line 2, column time: expected a later one than 5.0"),
    "empty cell": (b"time,x,y\n0,,2\n", "line 2, column x: expected a number, got ''"),
    "short row": (b"time,x,y\n0,1\n", "line 2: expected 3 columns or more, got 2"),
    "no date": (b"time,x,y\nyesterday,1,2\n", "column time: expected seconds or a date"),
    "long line": (b"0 1 " + b"2" * 70_000 + b"\n", "line 1: expected at most 65536 characters"),
}
GOOD_TD, GOOD_TL = np.array([[0.0, 2.0, 1.0, 5.0]]), np.array([[1.0, 0.0, 0.0], [2.0, 9.0, 0.0]])
MATLAB = {
    "nothing": ({"other": 1.0}, "TD as rows of 4 real numbers, it is missing"),
    "no beacons": ({"TD": GOOD_TD}, "TL as rows of 3 real numbers, it is missing"),
    "no ranges": ({"TL": GOOD_TL}, "TD as rows of 4 real numbers, it is missing"),
    "a word": ({"TD": "ranges", "TL": GOOD_TL}, "TD as rows of 4 real numbers"),
    "three columns": ({"TD": GOOD_TD[:, :3], "TL": GOOD_TL}, "expected TD as rows of 4 numbers, got shape"),
    "five columns": ({"TD": np.ones((2, 5)), "TL": GOOD_TL}, r"got shape \(2, 5\)"),
    "no rows": ({"TD": np.ones((0, 4)), "TL": GOOD_TL}, "expected TD as rows of 4 numbers"),
    "cube": ({"TD": np.ones((2, 4, 2)), "TL": GOOD_TL}, "TD as rows of 4 real numbers"),
    "complex": ({"TD": 1j * GOOD_TD, "TL": GOOD_TL}, "TD as rows of 4 real numbers"),
    "cells": ({"TD": np.array([[1, "a"]], dtype=object), "TL": GOOD_TL}, "TD as rows of 4 real numbers"),
    "a structure": ({"TD": {"a": 1.0}, "TL": GOOD_TL}, "TD as rows of 4 real numbers"),
    "nan range": (
        {"TD": np.array([[0.0, 2.0, 1.0, np.nan]]), "TL": GOOD_TL},
        "numbers in TD, got others in row 1",
    ),
    "infinite time": ({"TD": np.array([[np.inf, 2.0, 1.0, 5.0]]), "TL": GOOD_TL}, "others in row 1"),
    "unknown beacon": ({"TD": np.array([[0.0, 2.0, 7.0, 5.0]]), "TL": GOOD_TL}, "got 7 in row 1"),
    "beacon twice": ({"TD": GOOD_TD, "TL": np.ones((2, 3))}, "beacons in TL whose numbers differ"),
    "nowhere": ({"TD": GOOD_TD, "TL": np.array([[1.0, np.nan, 0.0]])}, "numbers in TL, got others in row 1"),
    "flat beacons": ({"TD": GOOD_TD, "TL": GOOD_TL[:, :2]}, "expected TL as rows of 3 numbers"),
    "kilometres": ({"TD": np.array([[0.0, 2.0, 1.0, 1e9]]), "TL": GOOD_TL}, "none beyond"),
    "flags": ({"TD": GOOD_TD > 1.0, "TL": np.array([["a"]], dtype=object)}, "TL as rows of 3 real numbers"),
    "infinite beacon": ({"TD": GOOD_TD, "TL": np.array([[1.0, 0.0, -np.inf]])}, "TL, got others in row 1"),
}
RANGES, OFFSETS = np.array([5.0, 6.0, 7.0]), np.array([0, 1, 3, 3, 3])
ARCHIVES = {
    "nothing": ({}, "arrays range_m and offsets"),
    "no offsets": ({"range_m": RANGES}, "arrays range_m and offsets"),
    "no ranges": ({"offsets": OFFSETS}, "arrays range_m and offsets"),
    "nan": ({"range_m": RANGES * np.nan, "offsets": OFFSETS}, "expected finite ranges"),
    "infinite": ({"range_m": np.array([1.0, np.inf, 2.0]), "offsets": OFFSETS}, "expected finite ranges"),
    "column": ({"range_m": RANGES[:, None], "offsets": OFFSETS}, "in one axis"),
    "scalar": ({"range_m": 5.0, "offsets": OFFSETS}, "in one axis"),
    "words": (
        {"range_m": np.array(["a", "b", "c"]), "offsets": OFFSETS},
        "expected finite ranges|could not read",
    ),
    "complex": ({"range_m": RANGES * 1j, "offsets": OFFSETS}, "expected finite ranges"),
    "objects": ({"range_m": np.array([object()]), "offsets": OFFSETS}, "could not read it"),
    "object offsets": ({"range_m": RANGES, "offsets": np.array([None, 1])}, "could not read it"),
    "backwards": ({"range_m": RANGES, "offsets": OFFSETS[::-1]}, "rise from 0"),
    "not from 0": ({"range_m": RANGES, "offsets": OFFSETS + 1}, "rise from 0"),
    "short": ({"range_m": RANGES, "offsets": OFFSETS[:2]}, "rise from 0 to the number of ranges, 3"),
    "too far": ({"range_m": RANGES, "offsets": np.array([0, 1, 3, 3, 9])}, "rise from 0"),
    "fractions": ({"range_m": RANGES, "offsets": OFFSETS.astype(float)}, "rise from 0"),
    "table": ({"range_m": RANGES, "offsets": OFFSETS[None]}, "rise from 0"),
    "one offset": ({"range_m": np.zeros(0), "offsets": np.array([0])}, "rise from 0"),
    "odd": ({"range_m": RANGES, "offsets": np.array([0, 1, 2, 3])}, "each of 2 anchors, got 3 cells"),
    "silence": (
        {"range_m": np.zeros(0), "offsets": np.zeros(5, int)},
        "ranges: expected at least one, got none",
    ),
}

HEAD = b"anchor,x,y\n"
ANCHORS = {
    "empty": (b"", "a header and rows, got 0 lines"),
    "header alone": (HEAD, "a header and rows, got 1 lines"),
    "comments": (b"# anchor,x,y\n# a,1,2\n", "got 0 lines"),
    "binary": (BINARY, "text in UTF-8, got byte"),
    "nul": (HEAD + b"a,1,\x00\n", "got a binary file"),
    "no name": (b"x,y\n1,2\n", "anchor is missing"),
    "no x": (b"anchor,y\na,2\n", "x is missing"),
    "no y": (b"anchor,x\na,1\n", "y is missing"),
    "nothing known": (b"id,east,north\na,1,2\n", "anchor, x, y is missing"),
    "a word in x": (HEAD + b"a,west,2\n", "line 2, column x: expected a number, got 'west'"),
    "a word in y": (HEAD + b"a,1,north\n", "line 2, column y: expected a number, got 'north'"),
    "empty x": (HEAD + b"a,,2\n", "line 2, column x: expected a number, got ''"),
    "nan": (HEAD + b"a,nan,2\n", "line 2, column x: expected a number, got 'nan'"),
    "infinite": (HEAD + b"a,1,2\nb,1,inf\n", "line 3, column y: expected a number, got 'inf'"),
    "twice": (HEAD + b"a,1,2\na,3,4\n", "names that differ"),
    "short row": (HEAD + b"a,1\n", "line 2: expected 3 columns, got 2"),
    "long row": (HEAD + b"a,1,2,3\n", "line 2: expected 3 columns, got 4"),
    "same columns": (b"anchor,x,x,y\na,1,1,2\n", "columns with names that differ"),
    "nameless column": (b"anchor,x,y,\na,1,2,3\n", "columns with names that differ"),
    "blanks": (b"anchor x y\na 1 2\n", "anchor, x, y is missing"),
    "open quote": (HEAD + b'"a,1,2\n', "could not read it"),
    "long line": (HEAD + b"a,1," + b"2" * 70_000 + b"\n", "line 2: expected at most 65536 characters"),
}
GT = np.array([[0.0, 1.0, 2.0, 0.0], [1.0, 1.5, 2.0, 0.0]])
GT_TRACKS = {
    "nothing": {"other": 1.0},
    "ranges alone": {"TD": GOOD_TD, "TL": GOOD_TL},
    "another name": {"gt": GT},
    "a word": {"GT": "track"},
    "a number": {"GT": 1.0},
    "a row vector": {"GT": np.ones(9)},
    "three columns": {"GT": GT[:, :3]},
    "five columns": {"GT": np.ones((2, 5))},
    "turned": {"GT": np.ones((4, 2))},
    "no rows": {"GT": np.ones((0, 4))},
    "no columns": {"GT": np.ones((4, 0))},
    "cube": {"GT": np.ones((2, 4, 2))},
    "complex": {"GT": 1j * GT},
    "cells": {"GT": np.array([[1, "a", 2, 3]], dtype=object)},
    "a structure": {"GT": {"a": 1.0}},
    "nan": {"GT": GT * np.nan},
    "one nan": {"GT": np.array([[0.0, 1.0, 2.0, 0.0], [1.0, np.nan, 2.0, 0.0]])},
    "infinite time": {"GT": np.array([[np.inf, 1.0, 2.0, 0.0]])},
    "infinite place": {"GT": np.array([[0.0, 1.0, -np.inf, 0.0]])},
    "words": {"GT": np.array(["north", "south"])},
}
CIRS = {
    "cir": np.ones((2, 100, 2)),
    "first_path_tap": np.full(2, 40.0),
    "range_m": np.full(2, 5.0),
    "link": np.ones(2),
    "pairs": np.array([[1.0, 1.0, 1.0]]),
    "anchors_m": np.ones((1, 2)),
    "tags_m": np.ones((1, 2)),
}
RESPONSES = {
    "no file": None,
    **{f"no {name}": {name: None} for name in CIRS},
    "real responses": {"cir": np.ones((2, 100))},
    "three components": {"cir": np.ones((2, 100, 3))},
    "nan": {"cir": np.full((2, 100, 2), np.nan)},
    "fewer taps told": {"first_path_tap": np.ones(1)},
    "more ranges": {"range_m": np.ones(3)},
    "infinite range": {"range_m": np.array([1.0, np.inf])},
    "words": {"link": np.array(["one", "two"])},
    "objects": {"link": np.array([object(), None])},
    "link 0": {"link": np.zeros(2)},
    "link beyond": {"link": np.full(2, 2.0)},
    "anchor beyond": {"pairs": np.array([[1.0, 2.0, 1.0]])},
    "tag 0": {"pairs": np.array([[1.0, 1.0, 0.0]])},
    "flat anchors": {"anchors_m": np.ones(2)},
    "high tags": {"tags_m": np.ones((1, 3))},
}

LOG = {
    "cir": np.ones((2, 64), dtype=complex),
    "tap_s": 1e-9,
    "time_s": np.arange(2.0),
    "anchor": np.array([1, 2]),
}
RESPONSE_LOGS = {
    "nothing": ({"cir": None}, "expected the array cir or cfr, got neither"),
    "both": ({"cfr": LOG["cir"]}, "got cir and cfr"),
    "no spacing": ({"tap_s": None}, "expected the array tap_s beside cir"),
    "no times": ({"time_s": None}, "expected the array time_s, it is missing"),
    "no anchors": ({"anchor": None}, "expected the array anchor, it is missing"),
    "real": ({"cir": np.ones((2, 64))}, "expected cir as complex numbers"),
    "words": ({"cir": np.array([["a", "b"]])}, "expected cir as complex numbers"),
    "objects": ({"cir": np.array([[object(), None]])}, "could not read it"),
    "three parts": ({"cir": np.ones((2, 64, 3))}, "expected cir as complex numbers"),
    "half": ({"cir": None, "cir_re": np.ones((2, 64))}, "expected cir_re and cir_im"),
    "parts that differ": (
        {"cir": None, "cir_re": np.ones((2, 64)), "cir_im": np.ones((2, 63))},
        "expected cir_re and cir_im",
    ),
    "flat": ({"cir": np.ones(64, dtype=complex)}, "expected cir of 2 axes"),
    "nan": ({"cir": np.full((2, 64), np.nan + 0j)}, "finite numbers in cir, got others in row 1"),
    "no rows": ({"cir": np.ones((0, 64), dtype=complex)}, "expected responses in cir"),
    "one tap": ({"cir": np.ones((2, 1), dtype=complex)}, "expected responses in cir"),
    "fewer times": ({"time_s": np.ones(1)}, "expected 2 real numbers in time_s"),
    "infinite time": ({"time_s": np.array([0.0, np.inf])}, "finite numbers in time_s"),
    "anchor 0": ({"anchor": np.array([0, 1])}, "expected anchor as numbers of 1 to 1"),
    "half an anchor": ({"anchor": np.array([1.0, 1.5])}, "expected anchor as numbers of"),
    "no step": ({"tap_s": 0.0}, "expected tap_s as one positive number"),
    "two steps": ({"tap_s": np.ones(2)}, "expected tap_s as one positive number"),
    "range alone": ({"range_m": np.ones(2)}, "expected first_path_tap and range_m together"),
    "tap alone": ({"first_path_tap": np.ones(2)}, "expected first_path_tap and range_m together"),
    "no band": ({"bandwidth_hz": -1.0}, "expected bandwidth_hz as one positive number"),
    "calibrated taps": ({"calibration": np.ones(64, dtype=complex)}, "expected pulse beside cir"),
    "no pulse": ({"pulse": np.zeros(4, dtype=complex)}, "that fits cir and is not 0"),
    "noise of taps": ({"noise_variance": 1.0}, "noise_variance as positive numbers, beside cfr"),
}


@pytest.mark.parametrize("kind", CSV)
def test_csv(tmp_path: Path, kind: str) -> None:
    """Ranges as text with named columns."""
    data, words = CSV[kind]
    (tmp_path / "bad.csv").write_bytes(data)
    with pytest.raises(FileFormatError, match=words):
        read_csv(tmp_path / "bad.csv")


@pytest.mark.parametrize("kind", SENSORS)
def test_sensor_lines(tmp_path: Path, kind: str) -> None:
    """Ranges as lines of sensors."""
    data, words = SENSORS[kind]
    (tmp_path / "bad.txt").write_bytes(data)
    with pytest.raises(FileFormatError, match=words):
        read_sensor_lines(tmp_path / "bad.txt")


@pytest.mark.parametrize("kind", TRACKS)
def test_trajectories(tmp_path: Path, kind: str) -> None:
    """Trajectories as text."""
    data, words = TRACKS[kind]
    (tmp_path / "bad.txt").write_bytes(data)
    with pytest.raises(FileFormatError, match=words):
        read_track(tmp_path / "bad.txt")


@pytest.mark.parametrize("kind", MATLAB)
def test_matlab(tmp_path: Path, kind: str) -> None:
    """Ranges in MATLAB files."""
    variables, words = MATLAB[kind]
    savemat(tmp_path / "bad.mat", variables)
    with pytest.raises(FileFormatError, match=words):
        read_mat(tmp_path / "bad.mat")


@pytest.mark.parametrize("kind", ARCHIVES)
def test_archives(tmp_path: Path, kind: str) -> None:
    """Range sets in NumPy archives."""
    arrays, words = ARCHIVES[kind]
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(FileFormatError, match=words):
        read_range_set(tmp_path / "bad.npz", ("a", "b"))


@pytest.mark.parametrize(
    "read", [read_csv, read_mat, read_sensor_lines, read_track, read_anchors, read_mat_track]
)
def test_missing_damaged_and_folders(tmp_path: Path, read) -> None:
    """No file, a folder, half a packed file, half a MATLAB file, noise: one kind of error."""
    savemat(
        tmp_path / "whole.mat",
        {"TD": np.ones((50, 4)), "TL": GOOD_TL, "GT": np.ones((9, 4))},
        do_compression=True,
    )
    whole = (tmp_path / "whole.mat").read_bytes()
    (tmp_path / "half.mat").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "noise.mat").write_bytes(np.random.default_rng(1).bytes(5000))
    (tmp_path / "half.gz").write_bytes(gzip.compress(b"time,a\n0,1\n" * 100)[:40])
    for name in ("none", ".", "half.mat", "noise.mat", "half.gz"):
        with pytest.raises(FileFormatError, match=r"expected"):
            read(tmp_path / name)


@pytest.mark.parametrize("packed", [False, True])
def test_damage_anywhere_is_told_or_harmless(tmp_path: Path, packed: bool) -> None:
    """A MATLAB file with any one byte changed is read, or refused as others are."""
    savemat(tmp_path / "m.mat", {"TD": GOOD_TD, "TL": GOOD_TL}, do_compression=packed)
    whole, rng = (tmp_path / "m.mat").read_bytes(), np.random.default_rng(2)
    for _ in range(500):
        changed = bytearray(whole)
        changed[rng.integers(len(whole))] = rng.integers(256)
        (tmp_path / "bad.mat").write_bytes(changed)
        try:
            read_mat(tmp_path / "bad.mat")
        except FileFormatError:
            continue


@pytest.mark.parametrize("kind", ANCHORS)
def test_anchors(tmp_path: Path, kind: str) -> None:
    """Places of anchors as text."""
    data, words = ANCHORS[kind]
    (tmp_path / "bad.csv").write_bytes(data)
    with pytest.raises(FileFormatError, match=words):
        read_anchors(tmp_path / "bad.csv")


@pytest.mark.parametrize("kind", GT_TRACKS)
def test_matlab_tracks(tmp_path: Path, kind: str) -> None:
    """True tracks in MATLAB files: rows of four numbers were expected, or a row has none."""
    savemat(tmp_path / "bad.mat", GT_TRACKS[kind])
    with pytest.raises(
        FileFormatError, match=r"GT as rows of 4 (real )?numbers|numbers in GT, got others in row"
    ):
        read_mat_track(tmp_path / "bad.mat")


@pytest.mark.parametrize("kind", RESPONSES)
def test_responses(tmp_path: Path, kind: str) -> None:
    """Impulse responses in NumPy archives."""
    changed = RESPONSES[kind]
    if changed is not None:
        kept = {name: array for name, array in (CIRS | changed).items() if array is not None}
        np.savez(tmp_path / "cir.npz", **kept)
    with pytest.raises(FileFormatError, match=r"cir.npz: expected"):
        list(response_runs(tmp_path))


@pytest.mark.parametrize("kind", RESPONSE_LOGS)
def test_response_logs(tmp_path: Path, kind: str) -> None:
    """Channel responses in NumPy archives."""
    changed, words = RESPONSE_LOGS[kind]
    arrays = {name: array for name, array in (LOG | changed).items() if array is not None}
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(FileFormatError, match=words):
        read_responses(tmp_path / "bad.npz")


@pytest.mark.parametrize("suffix", ["npz", "mat", "h5", "hdf5"])
def test_damaged_response_logs(tmp_path: Path, suffix: str) -> None:
    """No file, a folder, half a file, noise: one kind of error."""
    np.savez(tmp_path / "whole.npz", **LOG)
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / f"half.{suffix}").write_bytes(whole[: len(whole) // 2])
    (tmp_path / f"noise.{suffix}").write_bytes(np.random.default_rng(1).bytes(5000))
    (tmp_path / f"folder.{suffix}").mkdir()
    with (tmp_path / f"bare.{suffix}").open("wb") as file:
        np.save(file, LOG["cir"])
    for name in ("none", "half", "noise", "folder", "bare"):
        with pytest.raises(FileFormatError, match=r"expected"):
            read_responses(tmp_path / f"{name}.{suffix}")
