"""Short forms of all figures, and what they leave behind."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimator.errors import ConfigurationError, OutputExistsError
from estimator.experiments.catalogue import FIGURES, Request, reproduce, wanted
from estimator.experiments.report import Report, Row, as_text, figure_text, write_report
from estimator.experiments.room import Room
from estimator.waveform import SPEED_OF_LIGHT_M_S

Make = Callable[..., Report]


@pytest.fixture
def make(walk: Callable[..., Room]) -> Make:
    """Reproduces a figure in a short walk."""

    def run(name: str, steps: int = 8, **request: Any) -> Report:
        return reproduce(name, Request(walk(steps), **request))

    return run


def test_distances_are_gaussian_with_the_published_variance(make: Make) -> None:
    """Fig. 7: estimates that are no outliers have the deviation of (16), 0.54 m, and no bias."""
    report = make("fig7", runs=600)
    for numbers in report.summary.values():
        assert numbers["outliers"] < 30
        assert abs(numbers["bias_m"]) < 4.0 * numbers["bias_m_se"]
        # below the threshold side lobes widen the distribution by a few per cent
        assert numbers["std_m"] == pytest.approx(
            numbers["std_published_m"], rel=0.05 + 4.0 / np.sqrt(2 * 600)
        )


def test_distances_reach_the_bound_above_the_threshold(make: Make) -> None:
    """Fig. 8: from -6 dB up the RMSE is the bound within its Monte-Carlo error; at -14 dB it is not."""
    summary = make("fig8", runs=400).summary
    snr, rmse, bound = (np.array(summary[key]) for key in ("snr_db", "rmse_m", "bound_m"))
    good = snr >= -6.0
    np.testing.assert_allclose(rmse[good], bound[good], rtol=4.0 / np.sqrt(2 * 400))
    assert rmse[snr == -14.0] > 20.0 * bound[snr == -14.0]
    assert summary["efficient_from_db"] <= -4.0


def test_the_published_bound_leaves_out_the_amplitude(make: Make) -> None:
    """Fig. 9: at 10 m and 200 subcarriers (16) exceeds (15) by about 3 c^2 / (pi^2 d^2 B^2), +47 %."""
    excess = make("fig9").summary["published_over_exact"]
    for count, share in excess.items():
        n = float(count)
        bandwidth = n * 120e3
        term = 3.0 * SPEED_OF_LIGHT_M_S**2 / (np.pi**2 * 100.0 * bandwidth**2)
        assert share == pytest.approx(term + 2.0 / n**2, rel=1e-6)
    assert excess["200"] == pytest.approx(0.474, abs=0.002)


def test_walls_have_the_full_covariance_and_not_the_published_one(make: Make) -> None:
    """Fig. 10: averaged pairs spread as the full covariance says; (26) misses both axes by 30 %."""
    report = make("fig10", runs=2000)
    for key in ("50 m, d^-2", "1000 m, d^-2"):
        numbers = report.summary[key]
        actual = np.array(numbers["std_published_m"])
        error = 4.0 * np.array(numbers["std_published_m_se"]) + 0.02 * actual
        assert np.all(np.abs(actual - numbers["std_full_m"]) < error)
        assert np.all(np.abs(actual - numbers["std_claimed_m"]) > 0.2 * actual)
        likeliest = np.array(numbers["std_likeliest_m"])
        assert np.all(np.abs(likeliest - numbers["std_bound_m"]) < 0.1 * likeliest)


def test_paths_alone_turn_the_map_and_sensed_walls_hold_it(make: Make) -> None:
    """Fig. 11: over a few runs, passive tracks point anywhere, hybrid ones where they should."""
    report = make("fig11", steps=14, runs=4, particles=1500)
    passive, hybrid = (
        np.abs(report.summary[key]["rotation_rad"]) for key in ("passive/particle", "hybrid/gaussian")
    )
    assert passive.max() > 0.5
    assert hybrid.max() < 0.3
    assert report.summary["passive/particle"]["limit"] is None


def test_walls_are_refined(make: Make) -> None:
    """Fig. 12: after 30 m every wall sensed at the start is known better, as well as the limit allows."""
    report = make("fig12", steps=62, runs=2)
    walls = report.summary["hybrid/gaussian"]["walls"]
    assert len(walls) == 4
    for wall in walls:
        refined = wall["step_61"]
        assert refined["found"] == 2
        assert refined["std_claimed_m"] < 0.6 * wall["std_prior_m"]
        assert refined["limit_m"] == pytest.approx(refined["std_claimed_m"], rel=0.3)


def test_methods_are_compared_on_the_same_runs(make: Make) -> None:
    """Fig. 13: one entry for each method and engine, with all numbers, errors and limits."""
    report = make("fig13", steps=20, runs=2, methods=("hybrid", "hybrid+aoa", "mva"), particles=800)
    assert {"hybrid/gaussian", "hybrid/particle", "hybrid+aoa/gaussian", "mva/particle"} <= set(
        report.summary
    )
    numbers = report.summary["hybrid/gaussian"]
    named = [
        "mae_final_m",
        "rmse_final_m",
        "derotated_rmse_final_m",
        "nees_position_per_dim",
        "vrp_ospa_final_m",
        "new_wall_delay_median",
        "walls_false_per_run",
        "seconds_per_run",
    ]
    assert {"runs", "lost", "converged_step", "limit", *named, *(f"{name}_se" for name in named)} <= set(
        numbers
    )
    assert numbers["runs"] == 2
    assert len(report.data["curves"]["mva/particle"]["mae_m"]) == 20
    json.dumps(report.summary, allow_nan=False)


def test_a_single_run_is_drawn_for_each_method(make: Make) -> None:
    """Fig. 14: a map for each method, with the number of walls that it has."""
    report = make("fig14", particles=500)
    assert [key.split("/")[0] for key in report.summary] == ["va", "mva", "hybrid"]
    assert len(report.picture.axes) == 3
    assert len(report.data["hybrid/gaussian"]["vrps_m"]) == 4


def test_only_what_exists_can_be_asked_for(make: Make) -> None:
    """Unknown figures, no runs, and methods for a figure without SLAM are refused."""
    assert wanted("all") == list(FIGURES)
    with pytest.raises(ConfigurationError, match=r"expected one of fig7, .*, got 'fig6'"):
        wanted("fig6")
    with pytest.raises(ConfigurationError, match="runs: expected 1 or more, got 0"):
        make("fig13", runs=0)
    with pytest.raises(ConfigurationError, match="fig9"):
        make("fig9", methods=("hybrid",))


def test_a_report_is_four_files_that_nothing_overwrites(make: Make, tmp_path: Path) -> None:
    """PNG, SVG, JSON and text; equal requests give equal bytes; a second time is refused."""
    for folder in ("one", "two"):
        report = make("fig9")
        write_report(report, tmp_path / folder)
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert names == ["fig9.json", "fig9.png", "fig9.svg", "fig9.txt"]
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    numbers = json.loads((tmp_path / "one" / "fig9.json").read_text(encoding="utf-8"))
    assert {"figure", "summary", "data", "settings"} <= set(numbers)
    with pytest.raises(OutputExistsError):
        write_report(report, tmp_path / "one")


def test_reports_have_columns(make: Make) -> None:
    """The text has ours, the paper's value and the limit in aligned columns."""
    report = make("fig9")
    text = as_text(
        Report("figX", "Title", {}, {}, [Row("error, m", "0.381", "0.4", "0.380")], report.picture)
    )
    head, line = text.splitlines()[2:4]
    for word, value in (("here", "0.381"), ("paper", "0.4"), ("limit", "0.380")):
        assert head.index(word) == line.index(value)
    assert figure_text(0.12345, 0.01) == "0.123 +- 0.010"
    assert figure_text(None) == "-"
