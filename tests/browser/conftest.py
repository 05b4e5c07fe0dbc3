"""A browser, a server and a short walk to be shown."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from estimator.measurements import MeasurementSet
from estimator.simulate import SimulationConfig, measure_scene
from tests.browser.chromium import Browser
from tests.service.harness import Server


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    """A browser with a profile of its own."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        if os.environ.get("CI"):
            pytest.fail("expected Chromium to be installed in CI (apt-get install chromium)")
        pytest.skip("Chromium is not installed")
    running = Browser(program, tmp_path / "profile")
    yield running
    running.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server in its own process."""
    with Server(f"sqlite:///{tmp_path_factory.mktemp('server') / 'hapslam.db'}") as running:
        yield running


@pytest.fixture(scope="module")
def stroll() -> MeasurementSet:
    """Thirty epochs in a rectangular room."""
    corners = np.array([(0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (0.0, 20.0)])
    track = np.stack([np.linspace(6.0, 20.0, 30), np.linspace(5.0, 12.0, 30)], axis=1)
    return measure_scene(
        corners,
        np.roll(corners, -1, axis=0),
        np.array([(25.0, 15.0), (4.0, 17.0)]),
        track,
        (0.1, 0.1, 0.1),
        28e9,
        SimulationConfig(range_std_m=0.05, region_m=60.0),
        np.random.default_rng(2),
    )
