"""Predictions held against themselves, against others, and against what was measured nearby."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from estimator.errors import InputError
from raytrace.plan.files import load_floorplan, updated
from raytrace.prediction.channels import channels_of, predict, predict_grid
from raytrace.prediction.interpolation import INTERPOLATIONS, interpolated_db
from raytrace.prediction.matching import match_paths
from raytrace.prediction.score import score_channels
from raytrace.prediction.tables import channel_rows, path_lists
from raytrace.propagation.images import image_paths


@pytest.fixture(scope="module")
def plan():
    return load_floorplan("l-room")


@pytest.fixture(scope="module")
def places(plan):
    return plan.track()[::20, :2]


@pytest.fixture(scope="module")
def channels(plan, places):
    return predict(plan, places)


def test_powers_are_sums_over_paths(plan, places, channels):
    """Power, wideband power and delay spread against a sum written out, tone by tone."""
    paths = image_paths(plan, plan.track()[::20])
    grid = plan.radio.grid()
    for t, k in ((0, 0), (5, 1)):
        valid = paths.valid[t, k]
        gain, delay = paths.amplitude[t, k][valid], paths.delay_s[t, k][valid]
        tones = np.exp(-2j * np.pi * np.outer(grid.offsets_hz(), delay)) @ gain
        assert channels.power[t, k] == pytest.approx(np.sum(np.abs(gain) ** 2))
        assert channels.wideband_power[t, k] == pytest.approx(np.mean(np.abs(tones) ** 2))
        weight = np.abs(gain) ** 2 / np.sum(np.abs(gain) ** 2)
        spread = np.sqrt(np.sum(weight * (delay - np.sum(weight * delay)) ** 2))
        assert channels.delay_spread_s[t, k] == pytest.approx(spread)


def test_a_true_prediction_is_perfect(places, channels):
    """No error, everything explained, nothing invented."""
    score = score_channels(channels, channels, np.ones(len(places), dtype=bool))
    assert score["power_db"] == [0.0, 0.0]
    assert score["path_delay_ns"] == [0.0, 0.0]
    assert (score["explained"], score["line_of_sight_right"]) == (1.0, 1.0)
    assert score["invented"] == pytest.approx(0.0)
    json.dumps(score, allow_nan=False)


def test_what_is_missing_and_what_is_invented_is_counted(channels):
    """Without double bounces less is explained; the other way round power is invented."""
    flat = channels.paths.flat()
    fewer = type(channels.paths).build(flat.select(flat.order < 2), *channels.paths.valid.shape[:2])
    less = match_paths(fewer, channels.paths)
    more = match_paths(channels.paths, fewer)
    power = np.where(channels.paths.valid, np.abs(channels.paths.amplitude) ** 2, 0.0)
    single = np.where(channels.paths.order < 2, power, 0.0).sum(axis=-1)
    np.testing.assert_allclose(less.explained, single / power.sum(axis=-1))
    np.testing.assert_allclose(more.invented, power.sum(axis=-1) / single - 1.0, atol=1e-12)
    assert np.all(less.invented < 1e-12)


def test_offsets_of_an_estimated_plan_are_applied(plan, places, channels):
    """An anchor that is known to send 2 dB more is predicted so."""
    known = {
        "anchors": [{"anchor": "pa1", "position_std_m": 0.1, "height_std_m": 0.1, "gain_offset_db": 2.0}]
    }
    louder = predict(updated(plan, {"uncertainty": known}), places)
    gain = 10.0 * np.log10(louder.power / channels.power)
    np.testing.assert_allclose(gain, np.tile([2.0, 0.0], (len(places), 1)), atol=1e-9)


def test_a_grid_covers_the_plan(plan):
    """Points lie in the bounding box of the walls, and are those of a prediction."""
    x, y, channels = predict_grid(plan, step_m=10.0, depth=0)
    assert (len(x), len(y)) == (8, 6)
    assert channels.power.shape == (48, 2)
    with pytest.raises(InputError, match="at most"):
        predict_grid(plan, step_m=0.01)


@pytest.mark.parametrize("places_m", [np.zeros((0, 2)), np.zeros(3), np.full((1, 2), np.nan)])
def test_no_place_is_refused(plan, places_m):
    """Positions have to be some, in two or three coordinates, and finite."""
    with pytest.raises(InputError, match="positions_m: expected"):
        predict(plan, places_m)


def test_interpolations_meet_what_was_measured():
    """At a measured place the measured power; on a line over log distance that line."""
    rng = np.random.default_rng(1)
    anchors, at = np.array([[0.0, 0.0]]), rng.uniform(2, 30, (60, 2))
    trend = -60.0 - 22.0 * np.log10(np.linalg.norm(at, axis=1))
    for method in INTERPOLATIONS[1:3]:
        found = interpolated_db(method, at[:5], anchors, at, trend[:, None], 28e9)
        np.testing.assert_allclose(found[:, 0], trend[:5], atol=0.5)
    far = np.array([[60.0, 80.0]])
    found = interpolated_db("log-distance", far, anchors, at, trend[:, None], 28e9)
    assert found[0, 0] == pytest.approx(-104.0)
    assert interpolated_db("free space", far, anchors, at, trend[:, None], 28e9)[0, 0] == pytest.approx(
        -20.0 * np.log10(4.0 * np.pi * 100.0 * 28e9 / 299_792_458.0)
    )
    with pytest.raises(InputError, match="method: expected one of free space"):
        interpolated_db("kriging", far, anchors, at, trend[:, None], 28e9)


def test_rows_are_json(plan, places, channels):
    """Channels and paths as JSON types; a channel without a path has no power."""
    nothing = replace(channels.paths, valid=np.zeros_like(channels.paths.valid))
    empty = channels_of(nothing, plan.radio.grid())
    rows = channel_rows(empty, ["pa1", "pa2"], np.arange(len(places)) * 1.0, places)
    assert rows[0]["power_db"] is None
    assert rows[0]["delay_spread_s"] is None
    json.dumps([rows, path_lists(channels, ["pa1", "pa2"])], allow_nan=False)
    assert len(path_lists(channels, ["pa1", "pa2"])) == channels.paths.valid.sum()
