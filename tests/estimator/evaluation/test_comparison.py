"""Evaluation of results whose errors are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.errors import ConfigurationError, InputError
from estimator.evaluation.comparison import EvaluationConfig, evaluate, read_truth
from estimator.result import SlamResult

Make = Callable[..., SlamResult]


def with_walls(result: SlamResult, vrps: np.ndarray, make: Make, **more: Any) -> SlamResult:
    """A result whose walls, at all epochs, are those of the given VRPs."""
    count, epochs = len(vrps), len(result.epoch)
    return make(
        wall_id=np.arange(count),
        wall_valid=np.ones((epochs, count), dtype=bool),
        wall_mean_m=np.tile(vrps, (epochs, 1, 1)),
        wall_covariance_m2=np.tile(0.01 * np.eye(2), (epochs, count, 1, 1)),
        wall_existence=np.ones((epochs, count)),
        **more,
    )


def test_the_truth_itself_has_no_error(make_result: Make, truth: xr.Dataset) -> None:
    """With start and heading of the plan undone, the truth evaluates to zeros."""
    numbers = evaluate(make_result(), truth)
    for name in ("position_mae_m", "position_rmse_m", "position_final_m", "rotation_rad", "derotated_rmse_m"):
        assert numbers[name] == pytest.approx(0.0, abs=1e-9), name
    assert numbers["anchors_error_m"] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert numbers["vrp_ospa_m"] == pytest.approx(0.0, abs=1e-9)
    assert numbers["nees_position_per_dim"] == pytest.approx(0.0, abs=1e-9)
    assert (numbers["epochs"], numbers["lost"], numbers["walls_false"]) == (40, False, 0)


def test_walls_in_one_line_are_one_wall(make_result: Make, truth: xr.Dataset) -> None:
    """The south wall with a door in it is found once, and is due if its parts together reflect enough."""
    numbers = evaluate(make_result(), truth)
    walls = {wall["name"]: wall for wall in numbers["walls"]}
    assert set(walls) == {"west", "south-left+south-right", "east", "north"}
    parts = truth["reflects"].sel(wall=["south-left", "south-right"]).any(["wall", "anchor"])
    assert walls["south-left+south-right"]["reflecting_epochs"] == int(parts.sum()) >= 20
    assert numbers["walls_true"] == numbers["walls_found"] == 4


def test_a_rotation_is_found_and_removed(make_result: Make, truth: xr.Dataset) -> None:
    """A map turned by 20 mrad has that rotation, errors of 20 mrad times the distance, and no others."""
    numbers = evaluate(make_result(0.02), truth)
    distance = np.hypot(*(truth["track_m"].values[:, :2] - truth.attrs["start_m"][:2]).T)
    chord = 2.0 * np.sin(0.01)
    assert numbers["rotation_rad"] == pytest.approx(0.02)
    assert numbers["derotated_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert numbers["position_mae_m"] == pytest.approx(chord * distance.mean())
    assert numbers["position_rmse_m"] == pytest.approx(chord * np.sqrt(np.mean(distance**2)))
    assert numbers["position_final_m"] == pytest.approx(chord * distance[-1])
    anchors = np.hypot(*(truth["anchor_position_m"].values[:, :2] - truth.attrs["start_m"][:2]).T)
    assert numbers["anchors_error_m"] == pytest.approx(list(chord * anchors))
    vrps = np.hypot(*(truth["vrp_m"].values[[0, 1, 3, 4]] - truth.attrs["start_m"][:2]).T)
    assert numbers["vrp_ospa_m"] == pytest.approx(chord * vrps.mean())


def test_nees_of_a_known_shift(make_result: Make, truth: xr.Dataset) -> None:
    """A shift of (0.3, 0.1) m with 0.2 m claimed per axis is (0.09 + 0.01) / 0.04 / 2 = 1.25."""
    numbers = evaluate(make_result(shift=(0.3, 0.1)), truth)
    assert numbers["nees_position_per_dim"] == pytest.approx(1.25)
    assert numbers["position_mae_m"] == pytest.approx(np.hypot(0.3, 0.1))
    assert numbers["nees_band"] == pytest.approx([0.0253, 3.6889], abs=1e-4)


def test_nees_where_all_is_known_by_definition(make_result: Make, truth: xr.Dataset) -> None:
    """Epochs without uncertainty have no NEES; if all are so, there is none."""
    result = make_result()
    assert (
        evaluate(make_result(agent_covariance=0.0 * result.agent_covariance), truth)["nees_position_per_dim"]
        is None
    )


def test_a_lost_run_is_called_lost(make_result: Make, truth: xr.Dataset) -> None:
    """A track that stays at the start is more than a metre off, however it is turned."""
    stuck = make_result(agent_mean=np.zeros((40, 4)))
    assert evaluate(stuck, truth)["lost"] is True


def test_false_missing_and_double_walls(make_result: Make, truth: xr.Dataset) -> None:
    """Invented walls and second copies are false, missing ones not found; OSPA charges the cut-off."""
    result = make_result()
    right = result.wall_mean_m[-1]
    estimates = np.concatenate([right[:3], right[:1] + 0.5, [[300.0, 10.0]]])
    numbers = evaluate(with_walls(result, estimates, make_result), truth)
    assert (numbers["walls_true"], numbers["walls_found"], numbers["walls_false"]) == (4, 3, 2)
    assert numbers["vrp_ospa_m"] == pytest.approx(
        (10.0 + min(10.0, np.hypot(*(right[3] - right[0] - 0.5)))) / 5
    )
    assert [wall["vrp_error_m"] is None for wall in numbers["walls"]] == [False, False, False, True]


def test_walls_that_hardly_reflect_are_neither_due_nor_false(make_result: Make, truth: xr.Dataset) -> None:
    """A wall of the plan that was not due counts as no false one when it is found."""
    faint = truth.assign(reflects=truth["reflects"] * (truth["wall"] != "east") * 1)
    numbers = evaluate(make_result(), faint)
    assert (numbers["walls_true"], numbers["walls_found"], numbers["walls_false"]) == (3, 3, 0)
    some = truth["reflects"] * ((truth["wall"] != "east") | (truth["epoch"] < 5)) * 1
    numbers = evaluate(make_result(), truth.assign(reflects=some), EvaluationConfig(reflecting_epochs=5))
    assert numbers["walls_true"] == 4


def test_walls_are_matched_with_the_rotation_removed(make_result: Make, truth: xr.Dataset) -> None:
    """A map turned by 0.2 rad moves far VRPs by metres; its walls are found all the same."""
    numbers = evaluate(make_result(0.2), truth)
    assert max(wall["vrp_error_m"] for wall in numbers["walls"]) > 2.0
    assert (numbers["walls_found"], numbers["walls_false"]) == (4, 0)


def test_walls_dropped_before_the_end_do_not_count(make_result: Make, truth: xr.Dataset) -> None:
    """Only walls confirmed at the last epoch are the run's answer."""
    valid = make_result().wall_valid.copy()
    valid[-1, 0] = False
    numbers = evaluate(make_result(wall_valid=valid), truth)
    assert (numbers["walls_found"], numbers["walls_false"]) == (3, 0)


def test_an_anchor_that_was_not_located(make_result: Make, truth: xr.Dataset) -> None:
    """Its error is null, and JSON can say all of it."""
    result = make_result()
    valid, mean = result.anchor_valid.copy(), result.anchor_mean_m.copy()
    valid[:, 0], mean[:, 0] = False, np.nan
    numbers = evaluate(make_result(anchor_valid=valid, anchor_mean_m=mean), truth, seconds_per_epoch=0.002)
    assert numbers["anchors_error_m"][0] is None
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert numbers["seconds_per_epoch"] == 0.002


def test_anchors_are_matched_by_name(make_result: Make, truth: xr.Dataset) -> None:
    """The order of the anchors in the truth does not matter."""
    swapped = truth.isel(anchor=[1, 0])
    assert evaluate(make_result(), swapped)["anchors_error_m"] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_result_of_some_epochs(make_result: Make, truth: xr.Dataset) -> None:
    """Epochs are matched by number: a result of the last ten is compared with these."""
    result = make_result()
    names = [
        name for name, value in vars(result).items() if isinstance(value, np.ndarray) and name != "wall_id"
    ]
    late = make_result(**{name: getattr(result, name)[30:] for name in names})
    numbers = evaluate(late, truth)
    assert numbers["epochs"] == 10
    assert numbers["position_mae_m"] == pytest.approx(0.0, abs=1e-9)


def test_frames_go_back_and_forth(make_result: Make, truth: xr.Dataset) -> None:
    """The truth in the estimator's frame, back in the plan's, is the truth."""
    known = read_truth(truth, make_result())
    np.testing.assert_allclose(known.track_m[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(known.to_plan(known.track_m), truth["track_m"].values[:, :2], atol=1e-12)
    np.testing.assert_allclose(known.to_plan(known.surfaces[0].vrp_m), truth["vrp_m"].values[0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda d: d.isel(epoch=slice(10)),
            "every epoch of the result, 10 is missing; is it the truth of another",
        ),
        (lambda d: d.assign_coords(anchor=["pa1", "x"]), "every anchor of the result, 'pa2' is missing"),
        (lambda d: d.drop_vars("reflects"), "truth: expected reflects, not there"),
        (lambda d: d.drop_attrs(), "truth: expected start_m, heading_rad, not there"),
    ],
)
def test_the_truth_of_another_dataset_is_refused(
    make_result: Make, truth: xr.Dataset, change: Callable[[xr.Dataset], xr.Dataset], message: str
) -> None:
    """A truth that lacks what the result has is named."""
    with pytest.raises(InputError, match=message):
        evaluate(make_result(), change(truth))


def test_an_empty_result_is_refused(make_result: Make, truth: xr.Dataset) -> None:
    """Nothing can be said of no epoch."""
    with pytest.raises(InputError, match="expected at least one epoch, got none"):
        evaluate(make_result(epoch=np.arange(0)), truth)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wall_gate_m": 0.0}, "wall_gate_m: expected a positive number, got 0"),
        ({"lost_m": float("nan")}, "lost_m: expected a positive number, got nan"),
        ({"band_probability": 1.0}, "band_probability: expected a number between 0 and 1, got 1"),
    ],
)
def test_bad_configurations_are_refused(change: dict[str, float], message: str) -> None:
    """The field, what was expected and what came are named."""
    with pytest.raises(ConfigurationError, match=message):
        EvaluationConfig(**change)
