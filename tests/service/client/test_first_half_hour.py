"""The page for a new user, pasted as it stands: a key, a session, a CSV as LPP, the map, files."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from estimator.result import load_result
from tests.service.harness import ROOT, free_port

_RMSE_M = 1.0  # of the shipped walk by time differences alone; usually a third of a metre
_LOST_M = 3.0


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_first_half_hour(tmp_path: Path) -> None:
    """All commands succeed; the walk is followed; the command line finds the same again."""
    text = (ROOT / "docs" / "first-half-hour.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```bash\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) == 6
    tools = tmp_path / "bin"
    tools.mkdir()
    for name, code in (("hapslam", ["-c", "from service.cli.main import main; main()"]), ("python3", [])):
        quoted = " ".join(f"'{part}'" for part in (sys.executable, *code))
        (tools / name).write_text(f'#!/bin/sh\nexec {quoted} "$@"\n')
        (tools / name).chmod(0o755)
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "\n".join(["trap 'kill $(jobs -p)' EXIT", *blocks])],
        cwd=tmp_path,
        env={
            "PATH": f"{tools}:/usr/bin:/bin",
            "HOME": str(tmp_path),
            "PYTHONPATH": str(ROOT),
            "HAPSLAM_PORT": str(free_port()),
            "HAPSLAM_WORKERS": "1",
            **{name: value for name, value in os.environ.items() if name.startswith("NUMBA_")},
        },
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    walk = json.loads((tmp_path / "example.json").read_text())
    assert f'{{"epoch":{len(walk["epochs"]) - 1},"new":true}}' in done.stdout
    assert "the live map: http://127.0.0.1:" in done.stdout
    found, again = (load_result(tmp_path / name) for name in ("result.nc", "again.nc"))
    assert np.array_equal(found.agent_mean, again.agent_mean)
    track = np.array(walk["truth"]["track_m"])
    errors = np.linalg.norm(found.agent_mean[:, :2] - (track - track[0]), axis=1)
    assert errors[-1] < _LOST_M
    assert np.sqrt(np.mean(errors**2)) < _RMSE_M
    assert len((tmp_path / "track.txt").read_text().splitlines()) == len(track) + 1
    assert json.loads((tmp_path / "state.json").read_text())["integrity"]["state"] in ("ok", "doubtful")
