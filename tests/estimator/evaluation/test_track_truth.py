"""A result against a true track: errors of tracks that are moved and turned by known amounts."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.evaluation.track_truth import evaluate_track
from estimator.geometry import rotation_matrix
from estimator.measurements import AnchorPaths, Epoch, MeasurementSet
from estimator.slam.run import run_slam
from estimator.waveform import SPEED_OF_LIGHT_M_S

PLACES = np.array([[9.0, -2.0], [3.0, 8.0], [-5.0, 1.0]])
START = np.array([100.0, 50.0])


@pytest.fixture(scope="module")
def tracked():
    """A result of exact ranges, and its true track in the estimator's frame."""
    time = 0.5 * np.arange(60)
    true = np.stack([0.2 * time, 1.5 * (1.0 - np.cos(0.2 * time))], axis=1)
    epochs = []
    for t, place in zip(time, true, strict=True):
        delay = np.linalg.norm(PLACES - place, axis=1) / SPEED_OF_LIGHT_M_S
        paths = tuple(AnchorPaths([d], [0.05 / SPEED_OF_LIGHT_M_S]) for d in delay)
        epochs.append(Epoch(len(epochs), float(t), paths))
    model = {"height2_mean_m2": 0.0, "height2_std_m2": 0.0, "range_std_m": 0.05, "clutter_mean": 0.1}
    settings = {"measurement_model": model, "start_m": START.tolist()}
    measured = MeasurementSet(("a", "b", "c"), (), tuple(epochs), 6e9, settings, known_anchors_m=PLACES)
    return run_slam(measured, "va"), true


def test_exact_tracks_have_no_error(tracked):
    """The truth lies in the frame of the plan; epochs without truth do not count."""
    result, true = tracked
    truth = true + START
    truth[40:] = np.nan
    numbers = evaluate_track(result, truth, START, anchors_m=PLACES + START)
    assert numbers["epochs"] == 40
    assert numbers["position_mae_m"] < 0.02
    assert numbers["relative_rmse_m"] < 0.02
    assert numbers["nees_position_per_dim"] < 0.5
    np.testing.assert_allclose(numbers["anchors_error_m"], 0.0, atol=1e-9)


def test_each_alignment_takes_off_its_own(tracked):
    """A track turned about the start, and one that is moved too."""
    result, true = tracked
    turn = rotation_matrix(0.3)
    turned, moved = true @ turn.T + START, (true + [2.0, -1.0]) @ turn.T + START
    plain, rotation, rigid = (
        evaluate_track(result, turned, START, how) for how in ("start", "rotation", "se2")
    )
    assert plain["position_rmse_m"] > 0.5
    assert rotation["position_rmse_m"] < 0.02
    assert rotation["rotation_rad"] == pytest.approx(-0.3, abs=0.01)
    assert plain["derotated_rmse_m"] == rotation["position_rmse_m"]
    assert rigid["position_rmse_m"] < 0.02
    assert evaluate_track(result, moved, START, "rotation")["position_rmse_m"] > 0.5
    number = evaluate_track(result, moved, START, "se2", (PLACES + [2.0, -1.0]) @ turn.T + START)
    assert number["position_rmse_m"] < 0.02
    assert max(number["anchors_error_m"]) < 0.1


def test_truths_that_do_not_fit_are_refused(tracked):
    """Another length, no epoch, an unknown alignment, other anchors."""
    result, true = tracked
    for truth, more, words in (
        (true[:5], {}, r"truth: expected shape \(60, 2\)"),
        (true * np.nan, {}, "truth: expected 2 epochs of the result or more, got 0"),
        (true, {"align": "scale"}, "align: expected one of start, rotation, se2, got 'scale'"),
        (true, {"anchors_m": PLACES[:1]}, r"anchors: expected shape \(3, 2\)"),
    ):
        with pytest.raises(InputError, match=words):
            evaluate_track(result, truth, **more)
