"""Raw beam sweeps and reflection points posted to a session become its walls."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from fastapi.testclient import TestClient

from estimator.arrays import BeamSet
from estimator.sensing.flash import find_flashes, flash_walls
from estimator.sensing.ranges import sweep_response
from estimator.waveform import OfdmGrid
from service.session.verify import verify
from service.settings import load_settings
from service.storage.database import opened
from service.storage.store import Store

GRID = OfdmGrid(28e9, 480e3, 400)
BEAMS = BeamSet(panels=4, elements=16, beams=64)
AZIMUTH, DISTANCE = np.deg2rad([180.0, -90.0, 90.0, 0.0]), np.array([10.0, 15.0, 25.0, 30.0])
NOISE = 1e-14
SILENT = {"epochs": [{"epoch": 0, "time_s": 0.0, "anchors": {}}]}


@pytest.fixture(scope="module")
def sweep() -> dict[str, Any]:
    """One sweep in a rectangular room, flashes in noise."""
    rng = np.random.default_rng(3)
    amplitude = 0.4 * GRID.wavelength_m / (8.0 * np.pi * DISTANCE)
    echo = sweep_response(GRID, BEAMS, AZIMUTH, DISTANCE, amplitude)
    echo = echo + np.sqrt(NOISE / 2) * (rng.normal(size=echo.shape) + 1j * rng.normal(size=echo.shape))
    return {
        "echo_re": echo.real[None],
        "echo_im": echo.imag[None],
        "sweep_epoch": np.array([0]),
        "tone_offset_hz": GRID.offsets_hz(),
    }


def _npz(arrays: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _shard(arrays: dict[str, Any], folder: Path) -> bytes:
    dims = ("sweep", "beam", "tone")
    coordinates = {"sweep_epoch": ("sweep", arrays["sweep_epoch"])}
    data = xr.Dataset(
        {name: (dims, arrays[name]) for name in ("echo_re", "echo_im")},
        coords=coordinates | {"tone_offset_hz": ("tone", arrays["tone_offset_hz"])},
    )
    data.to_netcdf(folder / "echo.nc", engine="h5netcdf")
    return (folder / "echo.nc").read_bytes()


def _post(client: TestClient, url: str, body: bytes, **params: Any) -> Any:
    given = {"noise_variance": NOISE, **params}
    headers = {"Content-Type": "application/octet-stream"}
    return client.post(f"{url}/sweeps", content=body, params=given, headers=headers)


def test_a_raw_sweep_gives_the_walls_that_flash(
    client: TestClient, make_session: Callable[..., str], sweep: dict[str, Any], database: str, tmp_path: Path
) -> None:
    """As npz and as a shard: the walls of the estimator's own search, known again, and kept in the log."""
    echo = sweep["echo_re"][0] + 1j * sweep["echo_im"][0]
    expected = flash_walls(find_flashes(echo, NOISE, GRID, BEAMS))
    assert len(expected) == 4
    for body in (_npz(sweep), _shard(sweep, tmp_path)):
        url = make_session(sweep=False)
        taken = _post(client, url, body)
        assert taken.json() == {"sweep": 0, "walls": 4}, taken.text
        assert taken.headers["X-New-Entries"] == "1"
        assert _post(client, url, body).headers["X-New-Entries"] == "0"
        walls = client.post(f"{url}/epochs", json=SILENT).json()["state"]["walls"]
        found = np.array([wall["vrp_m"] for wall in walls])
        order = np.argsort(np.linalg.norm(found, axis=1))
        assert np.allclose(found[order], [wall.mean_m for wall in expected], rtol=1e-4, atol=0.02)
    with opened(load_settings(database_url=database).url, 5.0) as engine:
        assert [text for finding in verify(Store(engine)) for text in finding.differences] == []


def test_raw_sweeps_that_do_not_fit_are_refused(
    client: TestClient, make_session: Callable[..., str], sweep: dict[str, Any]
) -> None:
    """Rubbish, missing and misshapen arrays, NaN, other beams, a later epoch: 4xx with the reason."""
    url = make_session(sweep=False)
    nan = np.full_like(sweep["echo_re"], np.nan)
    for body, params, status, text in (
        (b"rubbish", {}, 422, "netCDF-4 or npz"),
        (_npz({"echo_re": nan}), {}, 422, "missing"),
        (_npz({**sweep, "echo_re": nan}), {}, 422, "finite"),
        (_npz({**sweep, "echo_im": nan[:, :3]}), {}, 422, "expected shape"),
        (_npz(sweep), {"beams": 32}, 422, "expected shape"),
        (_npz(sweep), {"beams": 30}, 422, "beams"),
        (_npz(sweep), {"noise_variance": -1.0}, 422, "noise_variance"),
        (_npz({**sweep, "sweep_epoch": np.array([7])}), {}, 409, "epoch 0"),
    ):
        answer = _post(client, url, body, **params)
        assert answer.status_code == status, answer.text
        assert text in answer.json()["detail"], answer.text
    assert client.get(url).json()["next_sweep"] == 0
    assert _post(client, url.replace(url[-32:], "0" * 32), _npz(sweep)).status_code == 404


def test_reflection_points_become_walls(client: TestClient, make_session: Callable[..., str]) -> None:
    """Ranges of 64 beams in a rectangular room: its four walls, each within its own uncertainty."""
    rng = np.random.default_rng(5)
    azimuth = 2.0 * np.pi * np.arange(64) / 64 + 0.01
    slant = np.cos(azimuth[:, None] - AZIMUTH)
    distance = np.min(np.where(slant > 1e-3, DISTANCE / np.maximum(slant, 1e-3), np.inf), axis=1)
    std = 0.05
    measured = distance + std * rng.normal(size=64)
    points = [
        {"range_m": r, "range_std_m": std, "azimuth_rad": a}
        for r, a in zip(measured.tolist(), azimuth.tolist(), strict=True)
    ]
    url = make_session(sweep=False)
    answer = client.post(f"{url}/sweeps", json={"points": points})
    assert answer.json() == {"sweep": 0, "walls": 4}, answer.text
    walls = client.post(f"{url}/epochs", json=SILENT).json()["state"]["walls"]
    true = 2.0 * DISTANCE[:, None] * np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH)], axis=1)
    for wall in walls:
        gap = np.array(wall["vrp_m"]) - true
        distance2 = np.einsum("wi,ij,wj->w", gap, np.linalg.inv(wall["covariance_m2"]), gap)
        assert distance2.min() < 20.0  # chi-squared of 2: exceeded by 1 of 20,000
        assert wall["existence"] == 1.0
    few = client.post(f"{make_session(sweep=False)}/sweeps", json={"points": points[:2]})
    assert few.status_code == 422
