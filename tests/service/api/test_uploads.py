"""Files in: channels, datasets, measurement files, the example; and epochs in 3GPP vocabulary."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from fastapi.testclient import TestClient

from estimator.arrays import AntennaArray, UniformLinearArray, UniformPlanarArray
from estimator.channel.nomp import estimate_delays
from estimator.measurement_files import load_measurements, save_measurements
from estimator.measurements import AnchorPaths, MeasurementSet
from estimator.result import SlamResult
from estimator.waveform import OfdmGrid

GRID = OfdmGrid(28e9, 480e3, 200)
NOISE = 1e-12


def _channels(walk: MeasurementSet, epochs: int) -> dict[str, Any]:
    """Channels of the walk's paths as arrays."""
    rng = np.random.default_rng(1)
    cfr = np.zeros((epochs, len(walk.anchors), 1, GRID.tones), dtype=np.complex128)
    for t, epoch in enumerate(walk.epochs[:epochs]):
        for k, paths in enumerate(epoch.paths):
            tones = np.exp(-2j * np.pi * np.outer(paths.delay_s, GRID.offsets_hz()))
            cfr[t, k, 0] = (1e-4 * np.exp(1j * rng.uniform(0, 6, len(paths)))) @ tones
    cfr += np.sqrt(NOISE / 2) * (rng.normal(size=cfr.shape) + 1j * rng.normal(size=cfr.shape))
    return {
        "cfr_re": cfr.real,
        "cfr_im": cfr.imag,
        "time_s": np.array([epoch.time_s for epoch in walk.epochs[:epochs]]),
        "epoch": np.arange(epochs),
        "anchor": np.array(walk.anchors),
        "tone_offset_hz": GRID.offsets_hz(),
    }


def _npz(arrays: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _netcdf(arrays: dict[str, Any], folder: Path) -> bytes:
    dims = ("epoch", "anchor", "antenna", "tone")
    data = xr.Dataset(
        {name: (dims, arrays[name]) for name in ("cfr_re", "cfr_im")}
        | {"time_s": ("epoch", arrays["time_s"])},
        coords={
            "epoch": arrays["epoch"],
            "anchor": list(arrays["anchor"]),
            "tone_offset_hz": ("tone", arrays["tone_offset_hz"]),
        },
    )
    data.to_netcdf(folder / "channels.nc", engine="h5netcdf")
    return (folder / "channels.nc").read_bytes()


def _put(client: TestClient, url: str, body: bytes, **params: Any) -> Any:
    return client.post(url, content=body, params=params, headers={"Content-Type": "application/octet-stream"})


def test_channels_become_the_delays_that_the_estimator_finds(
    client: TestClient, walk: MeasurementSet, make_session: Callable[..., str], tmp_path: Path
) -> None:
    """netCDF and npz give the same epochs, and these are NOMP's own, not merely similar."""
    arrays = _channels(walk, 3)
    logs = []
    for body in (_npz(arrays), _netcdf(arrays, tmp_path)):
        url = make_session()
        taken = _put(client, f"{url}/channels", body, noise_variance=NOISE)
        assert taken.status_code == 200, taken.text
        assert _put(client, f"{url}/channels", body, noise_variance=NOISE).headers["X-New-Entries"] == "0"
        file = tmp_path / "log.nc"
        file.write_bytes(client.get(f"{url}/measurements").content)
        with xr.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
            logs.append(data["delay_s"].values)
    assert np.array_equal(*logs, equal_nan=True)
    cfr = (arrays["cfr_re"] + 1j * arrays["cfr_im"]).reshape(-1, GRID.tones)
    expected = estimate_delays(cfr, NOISE, GRID)[0].delay_s
    found = logs[0][0, 0]
    assert found[np.isfinite(found)] == pytest.approx(expected, rel=1e-9)


_AZIMUTHS = np.array([0.4, 2.9])  # radians; the second comes from behind a row that faces the x axis


def _of_an_array(shape: tuple[int, ...], array: AntennaArray, rng: np.random.Generator) -> dict[str, Any]:
    """Channels of one anchor over two paths, faint at a single antenna; looks of random phases."""
    delays = np.array([1.0e-7, 1.6e-7])
    gains = 2e-6 * np.exp(2j * np.pi * rng.uniform(size=(*shape, 2)))
    tones = np.exp(-2j * np.pi * np.outer(delays, GRID.offsets_hz()))
    cfr = np.einsum("...p,pm,pn->...mn", gains, array.steering(_AZIMUTHS), tones)
    cfr += np.sqrt(NOISE / 2) * (rng.normal(size=cfr.shape) + 1j * rng.normal(size=cfr.shape))
    return {
        "cfr_re": cfr.real,
        "cfr_im": cfr.imag,
        "time_s": np.arange(float(shape[0])),
        "epoch": np.arange(shape[0]),
        "anchor": np.array(["a"]),
        "tone_offset_hz": GRID.offsets_hz(),
    }


def _strongest(paths: AnchorPaths, count: int) -> AnchorPaths:
    """The strongest paths in order of delay: noise adds a false one now and then."""
    assert paths.gain_db is not None
    kept = np.sort(np.argsort(-paths.gain_db)[:count])
    columns = (getattr(paths, entry.name) for entry in fields(paths))
    return AnchorPaths(*(None if column is None else column[kept] for column in columns))


def test_antennas_and_snapshots_are_used_together(
    client: TestClient, make_session: Callable[..., str], tmp_path: Path
) -> None:
    """Of 16 antennas, a described array gives directions and delays; as mere looks, delays as good.

    Each beats one antenna by about 16 in variance; snapshots add to that; errors stay within the claims.
    """
    array = UniformPlanarArray(4, 4, lying=True)
    arrays = _of_an_array((12, 1), array, np.random.default_rng(8))
    single = {**arrays, **{name: arrays[name][:, :, :1] for name in ("cfr_re", "cfr_im")}}
    more = _of_an_array((12, 1, 2, 2), array, np.random.default_rng(9))
    row = _of_an_array((12, 1), UniformLinearArray(16), np.random.default_rng(10))
    lying = {"elements": 4, "rows": 4, "lying": True}

    def measured(content: dict[str, Any], **described: Any) -> list[AnchorPaths]:
        url = make_session(anchors=["a"])
        answer = _put(client, f"{url}/channels", _npz(content), noise_variance=NOISE, **described)
        assert answer.status_code == 200, answer.text
        file = tmp_path / f"{url[-32:]}.nc"
        file.write_bytes(client.get(f"{url}/measurements").content)
        epochs = load_measurements(file).epochs
        assert all(epoch.heading_held is (described.get("orientation") != "travel") for epoch in epochs)
        return [_strongest(epoch.paths[0], 2) for epoch in epochs]

    variance = {}
    for name, content, described in (
        ("one antenna", single, {}),
        ("looks", arrays, {}),
        ("array", arrays, {**lying, "orientation": "travel"}),
        ("row", row, {"elements": 16}),
        ("array and snapshots", more, lying),
    ):
        heard = measured(content, **described)
        variance[name] = np.mean([paths.delay_std_s[0] ** 2 for paths in heard])
        if "array" in name:
            azimuth = np.stack([paths.azimuth_rad for paths in heard])
            error = np.angle(np.exp(1j * (azimuth - _AZIMUTHS)))
            claimed = np.stack([paths.azimuth_std_rad for paths in heard])
            assert np.mean((error / claimed) ** 2) < 2.0  # 24 squares of mean 1: above 1.8 once in 100
            assert np.max(np.abs(error)) < 0.1
        else:
            assert all(paths.azimuth_rad is None for paths in heard)
        normalised = [(paths.delay_s - [1.0e-7, 1.6e-7]) / paths.delay_std_s for paths in heard]
        assert np.mean(np.square(normalised)) < 2.0
    for name in ("looks", "array", "row"):
        assert variance[name] == pytest.approx(variance["one antenna"] / 16.0, rel=0.5), name
    assert variance["array and snapshots"] == pytest.approx(variance["array"] / 4.0, rel=0.5)
    url = make_session(anchors=["a"])
    for described, text in (
        ({"elements": 8}, "8, 200), got (12, 1, 16, 200)"),
        ({"elements": 1}, "elements"),
        ({"orientation": "up"}, "orientation"),
        ({"antennas": 4}, "antennas"),
    ):
        answer = _put(client, f"{url}/channels", _npz(arrays), noise_variance=NOISE, **described)
        assert answer.status_code == 422
        assert text in answer.json()["detail"]


def test_bad_files_are_refused(
    client: TestClient, walk: MeasurementSet, session_url: str, tmp_path: Path
) -> None:
    """Truncated, mislabelled, pickled, wrong shapes, NaN, not a file at all: 4xx, nothing taken in."""
    arrays = _channels(walk, 2)
    whole, hdf5 = _npz(arrays), _netcdf(arrays, tmp_path)
    objects = {**arrays, "time_s": np.array([{}, {}], dtype=object)}
    bad = [
        b"",
        b"PK\x03\x04",
        whole[: len(whole) // 2],
        hdf5[: len(hdf5) // 2],
        hdf5[:100],
        b"\x89HDF\r\n\x1a\n" + bytes(2000),
        _npz({**arrays, "cfr_re": arrays["cfr_re"][:1]}),
        _npz({**arrays, "cfr_re": np.full_like(arrays["cfr_re"], np.nan)}),
        _npz({**arrays, "tone_offset_hz": np.zeros(GRID.tones)}),
        _npz({**arrays, "epoch": np.array([5, 6])}),
        _npz({**arrays, "anchor": np.array(["x", "y"])}),
        _npz({name: value for name, value in arrays.items() if name != "time_s"}),
        _npz(objects),
    ]
    for number, body in enumerate(bad):
        for route in ("channels", "datasets"):
            answer = _put(client, f"{session_url}/{route}", body, noise_variance=NOISE)
            assert 400 <= answer.status_code < 500, (number, answer.text)
            assert "/tmp" not in answer.text
    assert client.get(session_url).json()["next_epoch"] == 0


def test_bombs_are_not_unpacked(client: TestClient, session_url: str, tmp_path: Path) -> None:
    """A small file that would unpack to gigabytes is refused by its declared size."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(6):
            archive.writestr(f"cfr_{i}.npy", bytes(100 * 2**20))
    bomb = stream.getvalue()
    assert len(bomb) < 2**20
    assert _put(client, f"{session_url}/channels", bomb, noise_variance=1.0).status_code == 413
    assert _put(client, f"{session_url}/datasets", bomb).status_code == 413
    data = xr.Dataset({"cfr_re": (("a", "b"), np.zeros((1, 1)))})
    data.to_netcdf(tmp_path / "x.nc", engine="h5netcdf")
    huge = tmp_path / "huge.nc"
    import h5py

    with h5py.File(huge, "w") as file:
        file.create_dataset("cfr_re", (20_000, 20_000), dtype="f8", chunks=(1000, 1000), compression="gzip")
    assert _put(client, f"{session_url}/channels", huge.read_bytes(), noise_variance=1.0).status_code in (
        413,
        422,
    )


def test_a_measurement_file_becomes_a_session(
    client: TestClient, walk: MeasurementSet, reference: SlamResult, tmp_path: Path
) -> None:
    """An uploaded file gives the batch command's estimates; twice into a session changes nothing."""
    file = tmp_path / "walk.nc"
    save_measurements(walk, file)
    made = _put(client, "/v1/uploads", file.read_bytes(), name="walk", seed=reference.seed)
    assert made.status_code == 201, made.text
    url = made.headers["Location"]
    state = client.get(f"{url}/state").json()
    assert state["agent"]["position_m"] == reference.agent_mean[-1, :2].tolist()
    again = _put(client, f"{url}/datasets", file.read_bytes())
    assert (again.status_code, again.headers["X-New-Entries"]) == (200, "0")


def test_the_example_is_requests_that_this_service_takes(client: TestClient) -> None:
    """What the page's example button sends is taken in, and the map is near the truth."""
    shipped = client.get("/v1/example", params={"seed": 2}).json()
    url = client.post("/v1/sessions", json=shipped["session"]).headers["Location"]
    assert client.post(f"{url}/sweeps", json=shipped["sweep"]).status_code == 200
    assert client.put(f"{url}/truth", json=shipped["truth"]).status_code == 204
    assert client.post(f"{url}/epochs", json={"epochs": shipped["epochs"][:60]}).status_code == 200
    track = np.array(client.get(f"{url}/map").json()["track_m"])
    error = np.linalg.norm(track - np.array(shipped["truth"]["track_m"])[:60], axis=1)
    assert error[-1] < 3.0  # metres; the rotation of the map alone may cost about a metre here
