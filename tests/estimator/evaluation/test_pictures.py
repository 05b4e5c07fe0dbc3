"""The picture: what is in it, that it repeats, and what is refused."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread
from matplotlib.patches import Ellipse

from estimator.errors import InputError, OutputExistsError
from estimator.evaluation.comparison import read_truth
from estimator.evaluation.pictures import draw_map, save_figure
from estimator.result import SlamResult

Make = Callable[..., SlamResult]


def labels(axes: object) -> list[str]:
    """The texts of a legend."""
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_the_picture_shows_estimates_and_truth(make_result: Make, truth: xr.Dataset) -> None:
    """True and estimated walls, tracks and anchors are there, in the frame of the plan."""
    upper, lower = draw_map(make_result(), truth, "a room").axes
    assert upper.get_title(loc="left") == "a room"
    for what in ("wall", "track", "anchor"):
        assert f"{what}, true" in labels(upper)
        assert f"{what}, estimated" in labels(upper)
    assert any("standard deviations" in label for label in labels(upper))
    lines = {line.get_label(): line.get_xydata() for line in upper.get_lines()}
    np.testing.assert_allclose(lines["track, true"], truth["track_m"].values[:, :2])
    np.testing.assert_allclose(lines["track, estimated"], truth["track_m"].values[:, :2], atol=1e-9)
    assert any("error (mean 0.000 m)" in label for label in labels(lower))


def test_estimated_walls_lie_on_the_true_ones(make_result: Make, truth: xr.Dataset) -> None:
    """Of a result without error every line drawn as a wall lies on the line of a true wall."""
    upper, _ = draw_map(make_result(), truth).axes
    colour = next(line.get_color() for line in upper.get_lines() if line.get_label() == "wall, estimated")
    drawn = [line.get_xydata() for line in upper.get_lines() if line.get_color() == colour]
    starts, ends = truth["wall_start_m"].values, truth["wall_end_m"].values
    tangents = (ends - starts) / np.linalg.norm(ends - starts, axis=1, keepdims=True)
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    assert len(drawn) == 2 * 4  # in full and beyond
    for line in drawn:
        heights = np.abs(np.sum((line[:, None] - starts) * normals, axis=-1)).max(axis=0)
        assert heights.min() < 1e-9


def test_ellipses_have_the_size_of_the_covariance(make_result: Make, truth: xr.Dataset) -> None:
    """The axes of an anchor's ellipse are twice two standard deviations, times the enlargement."""
    covariance = np.tile(np.diag([0.09, 0.01]), (40, 2, 1, 1))
    result = make_result(anchor_covariance_m2=covariance)
    upper, _ = draw_map(result, truth).axes
    named = next(label for label in labels(upper) if "standard deviations" in label)
    enlarged = float(named.split("x ")[1]) if "x " in named else 1.0
    place = read_truth(truth, result).to_plan(result.anchor_mean_m[-1, 0])
    ellipse = next(
        patch
        for patch in upper.patches
        if isinstance(patch, Ellipse) and np.allclose(patch.get_center(), place, atol=1e-9)
    )
    assert sorted([ellipse.width, ellipse.height]) == pytest.approx([0.4 * enlarged, 1.2 * enlarged])
    turned = np.degrees(truth.attrs["heading_rad"]) + (0.0 if ellipse.width > ellipse.height else 90.0)
    assert np.cos(2.0 * np.radians(ellipse.angle - turned)) == pytest.approx(1.0)


def test_a_picture_without_truth(make_result: Make) -> None:
    """Without truth the estimates are drawn in their own frame, with no error line."""
    upper, lower = draw_map(make_result()).axes
    assert not any("true" in label for label in labels(upper))
    start = next(line.get_xydata() for line in upper.get_lines() if line.get_label() == "track, estimated")[0]
    np.testing.assert_allclose(start, 0.0, atol=1e-12)
    assert labels(lower) == ["claimed standard deviation"]


def test_walls_born_on_the_way_are_named(make_result: Make, truth: xr.Dataset) -> None:
    """A wall that was confirmed later is marked with its number and time, on the map and over time."""
    valid = make_result().wall_valid.copy()
    valid[:17, 2] = False
    upper, lower = draw_map(make_result(wall_valid=valid), truth).axes
    assert "wall 2, from 17 s" in [text.get_text() for text in upper.texts]
    assert [text.get_text().strip() for text in lower.texts] == ["wall 2"]


@pytest.mark.parametrize("epochs", [1, 2])
def test_short_and_empty_maps_are_drawn(make_result: Make, epochs: int) -> None:
    """A result of an epoch or two, without walls or located anchors, is drawn without a warning."""
    full = make_result()
    names = [
        name for name, value in vars(full).items() if isinstance(value, np.ndarray) and name != "wall_id"
    ]
    short = {name: getattr(full, name)[:epochs] for name in names}
    short["wall_valid"] = np.zeros_like(short["wall_valid"])
    short["anchor_valid"] = np.zeros_like(short["anchor_valid"])
    short["anchor_mean_m"] = np.full_like(short["anchor_mean_m"], np.nan)
    assert len(draw_map(make_result(**short)).axes) == 2


def test_an_empty_result_is_refused(make_result: Make) -> None:
    """There is no map of no epoch."""
    with pytest.raises(InputError, match="expected at least one epoch, got none"):
        draw_map(make_result(epoch=np.arange(0)))


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_equal_results_give_equal_files(
    tmp_path: Path, make_result: Make, truth: xr.Dataset, suffix: str
) -> None:
    """Files hold no date and no random identifiers."""
    for name in ("a", "b"):
        save_figure(draw_map(make_result(), truth), tmp_path / f"{name}.{suffix}")
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"a.{suffix}", f"b.{suffix}"]


def test_files_are_what_their_suffix_says(tmp_path: Path, make_result: Make, truth: xr.Dataset) -> None:
    """The PNG has colours and a good size, the SVG is well-formed."""
    figure = draw_map(make_result(), truth)
    save_figure(figure, tmp_path / "map.png")
    save_figure(figure, tmp_path / "map.SVG")
    pixels = imread(tmp_path / "map.png")
    assert pixels.shape[1] > 1000
    assert pixels.std() > 0.01
    assert ET.parse(tmp_path / "map.SVG").getroot().tag.endswith("svg")


def test_drawing_leaves_no_trace(make_result: Make, truth: xr.Dataset) -> None:
    """Matplotlib's global settings are as before."""
    before = dict(mpl.rcParams)
    draw_map(make_result(), truth)
    assert dict(mpl.rcParams) == before


def test_bad_names_are_refused(tmp_path: Path, make_result: Make) -> None:
    """An unknown suffix and a name that is taken raise, and the file is kept."""
    figure = draw_map(make_result())
    for name, suffix in (("map.txt", r"'\.txt'"), ("map", "'no suffix'")):
        with pytest.raises(
            InputError, match=rf"expected a name that ends in \.png, \.svg, \.pdf, got {suffix}"
        ):
            save_figure(figure, tmp_path / name)
    (tmp_path / "map.png").write_text("mine")
    with pytest.raises(OutputExistsError):
        save_figure(figure, tmp_path / "map.png")
    assert (tmp_path / "map.png").read_text() == "mine"
