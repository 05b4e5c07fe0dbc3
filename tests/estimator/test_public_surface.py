"""The names of `from estimator import ...`, and what they do with input that no measurement is."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import estimator
from estimator import (
    AnchorPaths,
    Epoch,
    GaussianVrp,
    HapslamError,
    InputError,
    MeasurementSet,
    OfdmGrid,
    estimate_delays,
    fit_wall,
    run_slam,
)
from estimator.slam import GaussianConfig, ParticleConfig, Prior, epoch_rng
from estimator.slam.run import engine_for

IMAGES = np.array([[13.0, -2.0], [-21.0, -2.0], [19.0, -2.0], [13.0, -8.0], [13.0, 16.0]])
WALLS = tuple(GaussianVrp(vrp, 0.01 * np.eye(2)) for vrp in ([-8, 0], [32, 0], [0, -10], [0, 14]))
LIGHT_M_S = 299_792_458.0


def heard(t: int, *more_m: float) -> AnchorPaths:
    ranges = np.append(np.linalg.norm(IMAGES - [0.3 * t, 0.1 * t], axis=1), more_m)
    return AnchorPaths(ranges / LIGHT_M_S, np.full(len(ranges), 0.05 / LIGHT_M_S))


def epoch(t: int, **changes: Any) -> Epoch:
    return replace(Epoch(t, 0.5 * t, (heard(t),)), **changes)


def measured(epochs: list[Epoch]) -> MeasurementSet:
    return MeasurementSet(("ap1",), WALLS, tuple(epochs), 28e9)


def test_public_names_are_those_of_their_modules_and_typed() -> None:
    """Every name of __all__ can be imported, is listed, and is what type checkers are told it is."""
    tree = ast.parse(Path(estimator.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    typed = {
        alias.name: f"estimator.{node.module}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert set(typed) == set(estimator.__all__)
    assert set(estimator.__all__) <= set(dir(estimator))
    for name, module in typed.items():
        value = getattr(estimator, name)
        assert value is getattr(__import__(str(module), fromlist=[name]), name)
        assert value.__doc__
    with pytest.raises(AttributeError, match="attribute nothing"):
        _ = estimator.nothing


def test_importing_the_package_is_free() -> None:
    """`import estimator` loads no NumPy: names come when they are used."""
    used = "assert 'numpy' not in sys.modules; estimator.OfdmGrid; assert 'numpy' in sys.modules"
    root = Path(estimator.__file__).parents[1]
    command = [sys.executable, "-c", f"import estimator, sys; {used}"]
    subprocess.run(command, check=True, timeout=60, cwd=root)


@pytest.mark.parametrize(
    ("module", "absent"),
    [
        ("service.cli.main", {"numpy", "rich.progress"}),
        ("estimator.executors", {"numpy"}),
        ("estimator.pipeline", {"numba", "xarray", "matplotlib", "scipy"}),
        ("estimator.slam", {"xarray", "matplotlib", "scipy.linalg", "scipy.optimize", "scipy.stats"}),
        ("estimator.experiments.runs", {"xarray", "matplotlib", "scipy.optimize", "scipy.stats"}),
    ],
)
def test_heavy_libraries_are_imported_where_they_are_used(module: str, absent: set[str]) -> None:
    """Help, workers and evaluation start fast: what one stage alone needs is loaded with that stage."""
    command = [sys.executable, "-c", f"import {module}, sys; print(*({absent} & set(sys.modules)))"]
    root = Path(estimator.__file__).parents[1]
    done = subprocess.run(command, check=True, timeout=60, cwd=root, capture_output=True, text=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AnchorPaths([1e-7], [-1e-10]), "delay_std_s: expected positive numbers, got -1e-10"),
        (lambda: AnchorPaths([np.nan], [1e-10]), "delay_s: expected finite numbers, got nan"),
        (lambda: AnchorPaths([1e-7, 2e-7], [1e-10]), r"delay_std_s: expected shape \(2,\), got \(1,\)"),
        (lambda: AnchorPaths([-1e-7], [1e-10]), "delay_s: expected positive times of flight"),
        (
            lambda: GaussianVrp([1.0, 2.0], -np.eye(2)),
            "covariance_m2: expected a symmetric",
        ),
        (lambda: GaussianVrp([1.0, np.inf], np.eye(2)), "mean_m: expected finite numbers, got inf"),
        (lambda: GaussianVrp([1.0, 2.0, 3.0], np.eye(3)), r"mean_m: expected shape \(2,\), got \(3,\)"),
        (lambda: measured([epoch(0), epoch(2), epoch(1)]), "epochs: "),
        (lambda: measured([epoch(0), epoch(1), epoch(1)]), "epochs: "),
        (lambda: measured([epoch(0, paths=(heard(0), heard(0)))]), "expected paths of 1 anchors"),
        (
            lambda: estimate_delays(np.full((1, 8), np.nan), 1.0, OfdmGrid(28e9, 1e5, 8)),
            "cfr: expected finite",
        ),
        (lambda: fit_wall([3.0, 4.0], [0.1, -0.1], [0.0, 0.5]), "range_std_m: expected positive"),
        (lambda: run_slam(measured([epoch(0)]), method="magic"), "method: expected one of hybrid"),
    ],
)
def test_what_no_measurement_is_gets_refused(make: Callable[[], object], message: str) -> None:
    """Negative variances, NaN, wrong shapes, epochs out of order or twice, anchors nobody declared."""
    with pytest.raises(InputError, match=message) as refusal:
        make()
    assert isinstance(refusal.value, HapslamError)


def engines() -> list[Any]:
    return [
        engine_for("hybrid", "gaussian", GaussianConfig()),
        engine_for("hybrid", "particle", ParticleConfig.of(particles=500)),
    ]


@pytest.mark.parametrize("engine", engines(), ids=lambda engine: engine.name)
def test_a_refused_epoch_leaves_the_state_untouched(engine: Any) -> None:
    """An epoch of the past, the same again, or of more anchors: refused, and not a bit of the state moves."""
    state = engine.start(Prior(("ap1",), WALLS, 28e9), epoch_rng(1, -1))
    for t in range(3):
        state = engine.step(state, epoch(t), epoch_rng(1, t))
    before = engine.save(state)
    for bad in (epoch(1), epoch(2), epoch(3, time_s=0.1), epoch(3, paths=(heard(3), heard(3)))):
        with pytest.raises(InputError, match="epoch"):
            engine.step(state, bad, epoch_rng(1, bad.index))
        assert engine.save(state) == before


@pytest.mark.parametrize("engine", engines(), ids=lambda engine: engine.name)
def test_an_epoch_without_paths_is_a_step_of_the_motion_model(engine: Any) -> None:
    """Nothing heard: the agent's covariance grows, anchors and walls stay, and the run goes on."""
    state = engine.start(Prior(("ap1",), WALLS, 28e9), epoch_rng(1, -1))
    for t in range(3):
        state = engine.step(state, epoch(t), epoch_rng(1, t))
    known = engine.estimate(state)
    deaf = engine.step(state, epoch(3, paths=(AnchorPaths([], []),)), epoch_rng(1, 3))
    after = engine.estimate(deaf)
    assert np.trace(after.agent_covariance[:2, :2]) > np.trace(known.agent_covariance[:2, :2])
    np.testing.assert_allclose(after.wall_mean_m, known.wall_mean_m, atol=0.1)
    again = engine.estimate(engine.step(deaf, epoch(4), epoch_rng(1, 4)))
    assert np.all(np.isfinite(again.agent_mean))


def test_ten_thousand_paths_in_one_epoch_are_survived() -> None:
    """Clutter by the thousand: the step ends in seconds, finite, and the run finds back."""
    engine = engines()[0]
    state = engine.start(Prior(("ap1",), WALLS, 28e9), epoch_rng(1, -1))
    rng = np.random.default_rng(2)
    for t in range(12):
        clutter = rng.uniform(1.0, 180.0, 9_995) if t == 6 else ()
        state = engine.step(state, epoch(t, paths=(heard(t, *clutter),)), epoch_rng(1, t))
    found = engine.estimate(state)
    assert np.linalg.norm(found.agent_mean[:2] - [3.3, 1.1]) < 0.5
