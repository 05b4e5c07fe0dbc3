"""Measured sets beside plain methods: made ones always, those of others where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimator.errors import FileFormatError
from estimator.experiments.measured.comparison import compare, measured_table
from estimator.experiments.measured.plain import kalman_track, least_squares_track
from estimator.readers.range_log import RangeLog, measurements_of

SHARED = Path("/work/shared/benchmarks/measured")
PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
NAMES = {
    "method",
    "mae_m",
    "rmse_m",
    "nees_per_dim",
    "lost",
    "flagged",
    "false_features",
    "ekf_mae_m",
    "least_squares_mae_m",
}


def track_at(time_s):
    """A robot that goes round."""
    return np.stack([5.0 + 3.0 * np.cos(0.15 * time_s), 4.0 + 2.0 * np.sin(0.15 * time_s)], axis=1)


def write_labyrinth(folder, bias_m=0.0, seed=3, count=600, wheels=False):
    """A set as the one of the labyrinth: four anchors asked in turn."""
    rng = np.random.default_rng(seed)
    time = 0.125 * np.arange(1, count + 1)
    true, lines = track_at(time), []
    for n, t in enumerate(time):
        k = n % 4
        length = np.linalg.norm(true[n] - PLACES[k]) + bias_m + 0.1 * rng.normal()
        lines.append(f"range2 {t} {length} 0.01 {PLACES[k, 0]} {PLACES[k, 1]} {100 + k} 0")
        if wheels and n + 1 < count:
            ahead, after = true[n + 1] - true[n], track_at(np.array([t + 0.25]))[0] - true[n + 1]
            speed = np.linalg.norm(ahead) / 0.125
            turn = (ahead[0] * after[1] - ahead[1] * after[0]) / (np.linalg.norm(ahead) ** 2 * 0.125)
            left, right = speed + np.array([-0.5, 0.5]) * 0.2 * turn + 0.01 * rng.normal(size=2)
            lines.append(f"odom2diff {t} {left} {right} 0 0.1 0.0001 0.0001 0.0001")
    folder.mkdir(parents=True)
    (folder / "Indoor_UWB_Input.txt").write_text("\n".join(lines) + "\n")
    rows = [f"point2 {t} {x} {y} 0 0 0 0" for t, (x, y) in zip(time, true, strict=True)]
    (folder / "Indoor_UWB_GT.txt").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize("bias_m", [0.0, 0.4])
def test_a_biased_set_is_tracked_honestly(tmp_path, bias_m):
    """With a bias the plain filter is off by it; SLAM is not, and knows how well it does."""
    write_labyrinth(tmp_path / "labyrinth-uwb", bias_m)
    found = compare(tmp_path)
    assert set(found) == {"labyrinth"}
    one = found["labyrinth"]
    assert set(one) == NAMES
    assert one["mae_m"] < 0.15
    assert 0.3 < one["nees_per_dim"] < 2.0
    assert not one["lost"]
    assert not one["flagged"]
    assert one["false_features"] == 0
    assert (one["ekf_mae_m"] > one["mae_m"]) == (bias_m > 0.0)
    table = measured_table(found)
    assert f"{one['mae_m']:.3f}" in table


def test_wheels_help(tmp_path):
    """With the odometry of its wheels a robot is tracked better, in axes that it did not know."""
    write_labyrinth(tmp_path / "labyrinth-uwb", 0.2, wheels=True)
    found = compare(tmp_path)
    assert list(found) == ["labyrinth", "labyrinth-odometry"]
    alone, moved = found.values()
    assert moved["mae_m"] < alone["mae_m"]
    assert moved["mae_m"] < moved["ekf_mae_m"] < alone["ekf_mae_m"]  # the plain filter has wheels too
    assert moved["least_squares_mae_m"] == pytest.approx(alone["least_squares_mae_m"])
    assert 0.1 < moved["nees_per_dim"] < 3.0


def test_plain_methods_are_right_where_nothing_is_biased():
    """All anchors at once, exact ranges: least squares and the filter are on the track."""
    time = 0.2 * np.arange(200)
    true = track_at(time)
    length = np.linalg.norm(true[:, None] - PLACES, axis=2)
    log = RangeLog(
        np.repeat(time, 4), np.tile(np.arange(4), 200), length.ravel(), ("a", "b", "c", "d"), anchors_m=PLACES
    )
    measured = measurements_of(log, start_m=true[0], range_std_m=0.05)
    np.testing.assert_allclose(least_squares_track(measured) + true[0], true, atol=1e-3)
    assert np.abs(kalman_track(measured)[20:] + true[0] - true[20:]).max() < 0.03


def test_a_folder_without_sets_is_refused(tmp_path):
    """The message says which folders there may be."""
    with pytest.raises(FileFormatError, match="expected folders among lias-planar-uwb, labyrinth-uwb"):
        compare(tmp_path)


@pytest.mark.skipif(not (SHARED / "labyrinth-uwb").is_dir(), reason="the measured sets are not here")
def test_the_labyrinth_of_others(tmp_path):
    """Ranges of a real robot: better than the plain filter, and honest."""
    (tmp_path / "labyrinth-uwb").symlink_to(SHARED / "labyrinth-uwb")
    one = compare(tmp_path)["labyrinth"]
    assert one["mae_m"] < 0.18 < one["ekf_mae_m"]
    assert 0.5 < one["nees_per_dim"] < 2.0
    assert one["false_features"] == 0


def write_responses(folder, **changes):
    """Two static tags and four anchors, responses of a pulse with a tail; ranges of the device with noise."""
    rng = np.random.default_rng(9)
    tags, taps = np.array([[4.0, 3.0], [6.0, 5.0]]), 300
    pairs = np.array([[i + 1, i % 4 + 1, i // 4 + 1] for i in range(8)])
    link = np.repeat(np.arange(1, 9), 10)
    first = 100.0 + rng.random(len(link))
    grid = np.arange(taps)
    cir = np.exp(-0.5 * ((grid - first[:, None] - 1.6) / 1.4) ** 2)
    cir = np.stack([cir, np.zeros_like(cir)], axis=-1) * 1e4 + 20.0 * rng.normal(size=(len(link), taps, 2))
    between = pairs[link - 1]
    true = np.linalg.norm(PLACES[between[:, 1] - 1] - tags[between[:, 2] - 1], axis=1)
    arrays = {
        "cir": cir.astype(np.int16),
        "first_path_tap": first,
        "range_m": true + 0.03 * rng.normal(size=len(link)),
        "link": link,
        "pairs": pairs,
        "anchors_m": PLACES,
        "tags_m": tags,
    } | changes
    folder.mkdir(parents=True)
    np.savez(folder / "cir.npz", **{name: value for name, value in arrays.items() if value is not None})


def test_responses_are_ranged_and_tags_located(tmp_path):
    """Two tags told together, by their medians."""
    write_responses(tmp_path / "uwb-cirs-2018")
    one = compare(tmp_path)["uwb-cirs"]
    assert set(one) == NAMES
    assert one["mae_m"] < 0.1
    assert one["least_squares_mae_m"] < 0.1
    assert not one["lost"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cir": None}, "could not read it"),
        ({"range_m": np.ones(3)}, "expected range_m as finite numbers of shape"),
        ({"range_m": np.full(80, np.nan)}, "expected range_m as finite numbers"),
        ({"link": np.full(80, 99)}, "expected numbers of 1 to 8, got 99 to 99"),
        ({"pairs": np.zeros((8, 3))}, "expected numbers of 1 to 4, got 0 to 0"),
        ({"tags_m": np.array([{}])}, "could not read it"),
    ],
)
def test_responses_that_are_none_are_refused(tmp_path, changes, words):
    """What does not fit is named; nothing is unpickled."""
    write_responses(tmp_path / "uwb-cirs-2018", **changes)
    with pytest.raises(FileFormatError, match=words):
        compare(tmp_path)
