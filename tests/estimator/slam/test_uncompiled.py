"""Compiled functions do what their Python says: a short run with and without compilation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[3]
RUN = """
import sys
from dataclasses import replace
import numpy as np
from estimator.simulate import SimulationConfig, measure_scene
from estimator.slam import run_slam

corners = np.array([[0.0, 0.0], [0.0, 20.0], [30.0, 20.0], [30.0, 0.0]])
walls = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
anchors = np.array([[24.0, 4.0], [6.0, 17.0]])
track = np.stack([5.0 + 0.5 * np.arange(14), np.full(14, 6.0)], axis=1)
settings = SimulationConfig(sweep_every=6, azimuth_std_rad=0.02)
measured = measure_scene(
    walls[:, 0], walls[:, 1], anchors, track, (0.02,) * 4, 6e9, settings, np.random.default_rng(3)
)
result = run_slam(replace(measured, walls=measured.walls[:3]))
names = "agent_mean", "agent_covariance", "log_evidence", "anchor_mean_m", "wall_mean_m", "hypotheses"
np.savez(sys.argv[1], **{name: getattr(result, name) for name in names})
"""


def results(file: Path, **environment: str) -> dict[str, np.ndarray]:
    """What the run gives in a process with these variables."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(file)],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    with np.load(file) as archive:
        return {name: archive[name] for name in archive.files}


def test_compiled_and_uncompiled_runs_agree(tmp_path: Path) -> None:
    """A compiler's liberty, an index out of bounds or a wrong type would show as another estimate."""
    compiled = results(tmp_path / "compiled.npz")
    plain = results(tmp_path / "plain.npz", NUMBA_DISABLE_JIT="1")
    assert compiled["hypotheses"].max() > 1
    for name, found in compiled.items():
        np.testing.assert_allclose(plain[name], found, rtol=1e-6, atol=1e-8, err_msg=name)
