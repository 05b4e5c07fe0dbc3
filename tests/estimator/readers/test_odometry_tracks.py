"""Odometry from trajectories: against the way it was made of, and what it does for a run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimator.errors import ConfigurationError, FileFormatError, InputError
from estimator.geometry import rotation_matrix
from estimator.measurements import MeasurementSet
from estimator.readers.odometry_tracks import OdometryNoise, Poses, find_heading, read_poses, with_odometry
from estimator.readers.range_log import RangeLog, measurements_of
from estimator.slam import run_slam

PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
TIME = 0.25 * np.arange(240)


def way(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 2) and directions (N,) of a robot on an ellipse."""
    place = np.stack([5.0 + 3.0 * np.cos(0.15 * time), 4.0 + 2.0 * np.sin(0.15 * time)], axis=1)
    return place, np.unwrap(np.arctan2(2.0 * np.cos(0.15 * time), -3.0 * np.sin(0.15 * time)))


def ranges(seed: int = 1, bias_m: float = 0.3) -> MeasurementSet:
    """Four anchors asked in turn, with a bias, from a clock that began long ago."""
    rng = np.random.default_rng(seed)
    anchor = np.arange(len(TIME)) % 4
    length = np.linalg.norm(way(TIME)[0] - PLACES[anchor], axis=1) + bias_m + 0.1 * rng.normal(size=len(TIME))
    log = RangeLog(1000.0 + TIME, anchor, length, ("a", "b", "c", "d"), anchors_m=PLACES)
    return measurements_of(log, start_m=way(TIME[:1])[0][0], model={"start_std_m": 0.1})


def tum(file: Path, turn: float = 0.7, seed: int = 2) -> Path:
    """The odometry at 10 Hz in a frame of its own, drifting, as TUM has trajectories."""
    rng, time = np.random.default_rng(seed), np.arange(-1.0, TIME[-1] + 1.0, 0.1)
    place, heading = way(time)
    heading = heading + np.cumsum(0.002 * rng.normal(size=len(time)))
    steps = np.diff(place, axis=0)
    drifted = np.concatenate([np.zeros((1, 2)), np.cumsum(steps * 1.01, axis=0)])
    drifted, heading = drifted @ rotation_matrix(turn).T, heading + turn
    rows = zip(time + 1000.0, drifted, heading, strict=True)
    text = [f"{t:.2f} {x} {y} 0 0 0 {np.sin(0.5 * h)} {np.cos(0.5 * h)}" for t, (x, y), h in rows]
    file.write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(text) + "\n")
    return file


def test_steps_are_those_of_the_way(tmp_path: Path) -> None:
    """Without drift: chained from the start, in axes of the anchors, the steps are the way."""
    time = np.arange(-1.0, TIME[-1] + 1.0, 0.05)
    place, heading = way(time)
    rows = [
        f"{t + 1000.0},{x},{y},{np.degrees(h)}" for t, (x, y), h in zip(time, place, heading, strict=True)
    ]
    (tmp_path / "own.csv").write_text("time,x,y,heading_deg\n" + "\n".join(rows) + "\n")
    measured = with_odometry(ranges(), read_poses(tmp_path / "own.csv"), way(TIME[:1])[1][0])
    at, looks = np.zeros(2), 0.0
    for epoch, true in zip(measured.epochs[1:], way(TIME)[0][1:] - way(TIME[:1])[0][0], strict=True):
        assert epoch.odometry is not None
        at = at + rotation_matrix(looks) @ epoch.odometry.displacement_m
        looks += epoch.odometry.turn_rad
        np.testing.assert_allclose(at, true, atol=0.01)
    assert measured.epochs[0].odometry is None


def test_ranges_tell_the_heading(tmp_path: Path) -> None:
    """A trajectory in a frame of its own, ranges with a bias: found, and the track is better."""
    alone = ranges()
    poses = read_poses(tum(tmp_path / "odometry.tum"))
    place = np.stack([np.interp(1000.0 + TIME, poses.time_s, c) for c in poses.position_m.T], axis=1)
    first = np.interp(1000.0, poses.time_s, poses.heading_rad)
    found = find_heading(alone, (place - place[0]) @ rotation_matrix(-first).T, OdometryNoise())
    off = np.angle(np.exp(1j * (found - way(TIME[:1])[1][0])))
    assert abs(off) < np.radians(6.0)
    true = way(TIME)[0] - way(TIME[:1])[0][0]
    error = [
        np.mean(np.linalg.norm(run_slam(one, "va").agent_mean[:, :2] - true, axis=1))
        for one in (alone, with_odometry(alone, poses))
    ]
    assert error[1] < error[0]
    assert error[1] < 0.2


def test_epochs_beyond_the_trajectory_have_none(tmp_path: Path) -> None:
    """Odometry that ends early; and one of another time is refused."""
    poses = read_poses(tum(tmp_path / "odometry.tum"))
    short = poses._replace(**{name: getattr(poses, name)[:200] for name in poses._fields})
    told = [epoch.odometry is not None for epoch in with_odometry(ranges(), short, 0.0).epochs]
    assert told == [False] + [bool(t + 1000.0 <= short.time_s[-1]) for t in TIME[1:]]
    with pytest.raises(InputError, match="expected times about those of the ranges, 1000.000 to"):
        with_odometry(ranges(), poses._replace(time_s=poses.time_s - 900.0))


def test_a_heading_that_nothing_tells_is_asked_for(tmp_path: Path) -> None:
    """A robot that hardly moves; a straight way past a single anchor, left of it or right."""
    poses = read_poses(tum(tmp_path / "odometry.tum"))
    with pytest.raises(InputError, match="expected a way of 2 m among known anchors"):
        with_odometry(ranges(), poses._replace(position_m=0.01 * poses.position_m))
    straight = 0.1 * TIME[:, None] * [0.5, np.sqrt(0.75)]
    length = np.linalg.norm(straight - [20.0, 0.0], axis=1)
    log = RangeLog(
        TIME, np.zeros(len(TIME), dtype=np.int64), length, ("a",), anchors_m=np.array([[20.0, 0.0]])
    )
    alone = measurements_of(log, start_m=(0.0, 0.0), range_std_m=0.05)
    ahead = Poses(TIME, 0.1 * TIME[:, None] * [1.0, 0.0], np.zeros(len(TIME)))
    with pytest.raises(InputError, match=r"one direction that fits .*, got (60 and 300|300 and 60)"):
        with_odometry(alone, ahead)


TUM = "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n"
BAD = {
    "empty": ("", "odometry"),
    "comments": ("# timestamp tx ty tz qx qy qz qw\n", "of two lines or more, got 0"),
    "one line": ("0 0 0 0 0 0 0 1\n", "of two lines or more, got 1"),
    "no directions": ("0 0 0\n1 1 0\n", "line 1: expected 8 columns or more, got 3"),
    "short later": (TUM + "2 2 0\n", "line 3: expected 8 columns or more, got 3"),
    "a word in time": ("now 0 0 0 0 0 0 1\n", "line 1, column time: expected seconds"),
    "a word in tx": ("0 far 0 0 0 0 0 1\n", "line 1, column tx: expected a number, got 'far'"),
    "a word in ty": ("0 0 far 0 0 0 0 1\n", "line 1, column ty: expected a number"),
    "a word in qx": ("0 0 0 0 a 0 0 1\n", "line 1, column qx: expected a number"),
    "a word in qw": ("0 0 0 0 0 0 0 a\n", "line 1, column qw: expected a number"),
    "nan": ("0 nan 0 0 0 0 0 1\n", "column tx: expected a number"),
    "infinite": (TUM + "2 0 inf 0 0 0 0 1\n", "line 3, column ty: expected a number"),
    "no rotation": ("0 0 0 0 0 0 0 0\n", "line 1: expected a unit quaternion"),
    "long quaternion": (TUM + "2 0 0 0 0 0 1 1\n", "line 3: expected a unit quaternion"),
    "twice": (TUM + "1 1 0 0 0 0 0 1\n", "line 3, column time: expected a later one than 1.0"),
    "backwards": (TUM + "0.5 1 0 0 0 0 0 1\n", "line 3, column time: expected a later one"),
    "no heading": ("time,x,y\n0,1,2\n", "expected columns time, x, y, heading_deg, got time, x, y"),
    "no time": ("x,y,heading_deg\n1,2,3\n", "expected columns time"),
    "header alone": ("time,x,y,heading_deg\n", "of two lines or more, got 0"),
    "empty cell": ("time,x,y,heading_deg\n0,1,2,\n", "line 2, column heading_deg: expected a number"),
    "short row": ("time,x,y,heading_deg\n0,1\n", "line 2: expected 4 columns or more, got 2"),
    "nul": ("0 0 0 0 0 0 0 1\x00\n", "got a binary file"),
}


@pytest.mark.parametrize("kind", BAD)
def test_files_that_are_none(tmp_path: Path, kind: str) -> None:
    """Damaged odometry is told by line and column."""
    text, words = BAD[kind]
    (tmp_path / "bad.tum").write_text(text)
    with pytest.raises(FileFormatError, match=words):
        read_poses(tmp_path / "bad.tum")


def test_settings_and_directions_that_do_not_fit(tmp_path: Path) -> None:
    """No deviation is 0; measured directions are not mixed with odometry."""
    with pytest.raises(ConfigurationError, match="turn_std_rad: expected a positive number"):
        OdometryNoise(turn_std_rad=0.0)
    measured = ranges()
    paths = measured.epochs[0].paths
    looked = replace(
        paths[0], azimuth_rad=np.zeros(len(paths[0])), azimuth_std_rad=np.full(len(paths[0]), 0.1)
    )
    first = replace(measured.epochs[0], paths=(looked, *paths[1:]))
    with pytest.raises(InputError, match="expected ranges beside it, got directions"):
        with_odometry(
            replace(measured, epochs=(first, *measured.epochs[1:])), read_poses(tum(tmp_path / "o.tum"))
        )
