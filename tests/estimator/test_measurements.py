"""Measurements: what is refused, and files that come back as they were."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from estimator.errors import FileFormatError, InputError, OutputExistsError
from estimator.measurement_files import load_measurements, save_measurements
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.waveform import SPEED_OF_LIGHT_M_S


def paths(*delays_ns: float) -> AnchorPaths:
    """Paths of given delays."""
    delays = np.array(delays_ns) * 1e-9
    return AnchorPaths(delays, np.full(delays.shape, 1e-10), np.linspace(-90.0, -110.0, delays.size))


def measured(dataset: str | None = "../room") -> MeasurementSet:
    """A small set: two anchors, three epochs, one of them empty for one anchor."""
    epochs = (
        Epoch(0, 0.0, (paths(50.0, 60.0), paths(70.0))),
        Epoch(1, 1.0, (paths(), paths(71.0, 90.0, 95.0))),
        Epoch(4, 2.5, (paths(52.0), paths(72.0))),
    )
    walls = (GaussianVrp([-20.0, 0.0], 0.1 * np.eye(2)), GaussianVrp([0.0, 50.0], [[0.2, 0.1], [0.1, 0.3]]))
    return MeasurementSet(("pa1", "pa2"), walls, epochs, 28e9, {"nomp": {"oversampling": 4}}, dataset)


def assert_equal(a: MeasurementSet, b: MeasurementSet) -> None:
    """Compare every number bit by bit."""
    assert (a.anchors, a.carrier_hz, dict(a.settings), a.dataset) == (
        b.anchors,
        b.carrier_hz,
        dict(b.settings),
        b.dataset,
    )
    for x, y in zip(a.walls, b.walls, strict=True):
        np.testing.assert_array_equal(x.mean_m, y.mean_m)
        np.testing.assert_array_equal(x.covariance_m2, y.covariance_m2)
    for e, f in zip(a.epochs, b.epochs, strict=True):
        assert (e.index, e.time_s) == (f.index, f.time_s)
        for p, q in zip(e.paths, f.paths, strict=True):
            for name in ("delay_s", "delay_std_s", "gain_db"):
                np.testing.assert_array_equal(getattr(p, name), getattr(q, name))


@pytest.mark.parametrize("dataset", [None, "../room"])
def test_a_file_comes_back_bit_by_bit(tmp_path: Path, dataset: str | None) -> None:
    """Every number, name and setting survives, empty epochs and gaps in the numbering too."""
    save_measurements(measured(dataset), tmp_path / "m.nc")
    assert_equal(load_measurements(tmp_path / "m.nc"), measured(dataset))


def test_sets_without_walls_or_paths_come_back(tmp_path: Path) -> None:
    """Nothing sensed and nothing heard is a measurement too."""
    nothing = MeasurementSet(("a",), (), (Epoch(0, 0.0, (paths(),)),), 1e9)
    save_measurements(nothing, tmp_path / "m.nc")
    loaded = load_measurements(tmp_path / "m.nc")
    assert loaded.walls == ()
    assert len(loaded.epochs[0].paths[0]) == 0


def test_paths_without_powers_come_back(tmp_path: Path) -> None:
    """Paths of which only the delays are known stay so."""
    bare = AnchorPaths(np.array([5e-8]), np.array([1e-10]))
    save_measurements(MeasurementSet(("a",), (), (Epoch(0, 0.0, (bare,)),), 1e9), tmp_path / "m.nc")
    assert load_measurements(tmp_path / "m.nc").epochs[0].paths[0].gain_db is None


def test_equal_sets_give_equal_bytes(tmp_path: Path) -> None:
    """Files hold no time stamp and no path."""
    save_measurements(measured(), tmp_path / "a.nc")
    save_measurements(measured(), tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_ranges_are_delays_times_the_speed_of_light() -> None:
    """Metres and seconds of the same thing; arrays cannot be changed afterwards."""
    heard = paths(100.0)
    assert heard.range_m[0] == pytest.approx(29.9792458)
    assert heard.range_std_m[0] == pytest.approx(1e-10 * SPEED_OF_LIGHT_M_S)
    with pytest.raises(ValueError, match="read-only"):
        heard.delay_s[0] = 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: AnchorPaths([1e-8, np.nan], [1e-10] * 2, [-90.0] * 2),
            "delay_s: expected finite numbers, got nan",
        ),
        (lambda: AnchorPaths([np.inf], [1e-10], [-90.0]), "delay_s: expected finite numbers, got inf"),
        (lambda: AnchorPaths([0.0], [1e-10], [-90.0]), "delay_s: expected positive times of flight, got 0"),
        (lambda: AnchorPaths([1e-8], [0.0], [-90.0]), "delay_std_s: expected positive numbers, got 0"),
        (
            lambda: AnchorPaths([1e-8], [1e-10] * 2, [-90.0]),
            r"delay_std_s: expected shape \(1,\), got \(2,\)",
        ),
        (lambda: AnchorPaths([[1e-8]], [1e-10], [-90.0]), r"delay_s: expected shape \('n',\), got \(1, 1\)"),
        (lambda: GaussianVrp([1.0], np.eye(2)), r"mean_m: expected shape \(2,\), got \(1,\)"),
        (
            lambda: GaussianVrp([1.0, 2.0], -np.eye(2)),
            "covariance_m2: expected a symmetric positive definite",
        ),
        (lambda: GaussianVrp([1.0, 2.0], [[1.0, 0.5], [0.0, 1.0]]), "covariance_m2: expected a symmetric"),
        (lambda: replace(measured(), anchors=("pa1",)), "epoch 0: expected paths of 1 anchors, got 2"),
        (
            lambda: replace(measured(), epochs=measured().epochs[::-1]),
            "expected ascending index and time, got 1 at 1.0 s after 4 at 2.5 s",
        ),
    ],
)
def test_bad_values_are_refused(make: Callable[[], object], message: str) -> None:
    """The field, what was expected and what came are named."""
    with pytest.raises(InputError, match=message):
        make()


def rewritten(path: Path, change: Callable[[xr.Dataset], xr.Dataset]) -> Path:
    """A measurement file with changed contents."""
    save_measurements(measured(), path / "m.nc")
    with xr.open_dataset(path / "m.nc", engine="h5netcdf") as data:
        changed = change(data.load())
    changed.to_netcdf(path / "changed.nc", engine="h5netcdf")
    return path / "changed.nc"


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            lambda d: d.assign(delay_s=d["delay_s"] * np.nan),
            InputError,
            "changed.nc: delay_s: expected finite",
        ),
        (
            lambda d: d.assign(delay_s=-d["delay_s"]),
            InputError,
            "changed.nc: delay_s: expected positive times",
        ),
        (lambda d: d.assign(time_s=-d["time_s"]), InputError, "changed.nc: epochs: expected ascending"),
        (
            lambda d: d.drop_vars("vrp_mean_m"),
            FileFormatError,
            "expected the variable vrp_mean_m, it is missing",
        ),
        (
            lambda d: d.drop_attrs().assign_attrs(format="hapslam-measurements", version=1),
            FileFormatError,
            "expected the attribute 'carrier_hz', it is missing",
        ),
        (
            lambda d: d.assign_attrs(settings="{"),
            FileFormatError,
            "settings: expected JSON, could not read it",
        ),
        (
            lambda d: d.assign_attrs(version=9),
            FileFormatError,
            "version 1, got 'hapslam-measurements' version 9",
        ),
        (lambda d: d.isel(path=0), FileFormatError, r"path_valid to have axes .* got \('epoch', 'anchor'\)"),
    ],
)
def test_bad_files_are_refused(
    tmp_path: Path, change: Callable[[xr.Dataset], xr.Dataset], error: type[Exception], message: str
) -> None:
    """A file whose values are bad is named with what is bad in it."""
    with pytest.raises(error, match=message):
        load_measurements(rewritten(tmp_path, change))


def test_an_existing_file_is_kept(tmp_path: Path) -> None:
    """Measurements are never overwritten."""
    save_measurements(measured(), tmp_path / "m.nc")
    before = (tmp_path / "m.nc").read_bytes()
    with pytest.raises(OutputExistsError):
        save_measurements(measured(None), tmp_path / "m.nc")
    assert (tmp_path / "m.nc").read_bytes() == before


def test_known_anchors_travel_with_the_measurements(tmp_path: Path) -> None:
    """Where the anchors are comes back, is absent where nobody knows it, and must fit the names."""
    places = np.array([[58.0, -9.0], [32.0, 21.0]])
    save_measurements(replace(measured(), known_anchors_m=places), tmp_path / "known.nc")
    np.testing.assert_array_equal(load_measurements(tmp_path / "known.nc").known_anchors_m, places)
    save_measurements(measured(), tmp_path / "unknown.nc")
    assert load_measurements(tmp_path / "unknown.nc").known_anchors_m is None
    with pytest.raises(InputError, match="known_anchors_m: expected shape"):
        replace(measured(), known_anchors_m=places[:1])


def test_directions_sweeps_and_headings_come_back(tmp_path):
    """Azimuths, walls seen on the way and the heading survive the file bit for bit."""
    rng = np.random.default_rng(21)
    paths = [
        AnchorPaths(
            rng.uniform(1e-8, 1e-7, n),
            np.full(n, 1e-10),
            azimuth_rad=rng.normal(size=n),
            azimuth_std_rad=np.full(n, 0.01),
        )
        for n in (3, 0, 2)
    ]
    flash = GaussianVrp(rng.normal(size=2), np.diag([0.1, 0.2]))
    epochs = (
        Epoch(0, 0.0, (paths[0],)),
        Epoch(1, 1.0, (paths[1],), (flash,), False),
        Epoch(2, 2.0, (paths[2],)),
    )
    save_measurements(MeasurementSet(("a",), (), epochs, 28e9), tmp_path / "m.nc")
    back = load_measurements(tmp_path / "m.nc").epochs
    assert [epoch.heading_held for epoch in back] == [True, False, True]
    assert [len(epoch.sweep) for epoch in back] == [0, 1, 0]
    assert np.array_equal(back[1].sweep[0].mean_m, flash.mean_m)
    for i in (0, 2):
        assert np.array_equal(back[i].paths[0].azimuth_rad, paths[i].azimuth_rad)
        assert np.array_equal(back[i].paths[0].azimuth_std_rad, paths[i].azimuth_std_rad)
    assert len(back[1].paths[0]) == 0


def test_which_anchors_were_asked_comes_back(tmp_path):
    """Also where all were; a set that never says so has no such variable, as files before."""
    heard, silent = AnchorPaths([1e-8], [1e-10]), AnchorPaths.none()
    epochs = (
        Epoch(0, 0.0, (heard, silent), asked=(True, False)),
        Epoch(1, 1.0, (silent, silent), asked=(False, True)),
        Epoch(2, 2.0, (heard, silent)),
    )
    save_measurements(MeasurementSet(("a", "b"), (), epochs, 28e9), tmp_path / "m.nc")
    back = load_measurements(tmp_path / "m.nc").epochs
    assert [epoch.asked for epoch in back] == [(True, False), (False, True), None]
    assert back[2].was_asked.tolist() == [True, True]
    with pytest.raises(InputError, match="epoch 0: expected asked of 2 anchors, got 1"):
        Epoch(0, 0.0, (heard, silent), asked=(True,))
    with pytest.raises(InputError, match="no paths of anchor 0, which was not asked, got 1"):
        Epoch(0, 0.0, (heard, silent), asked=(False, True))


def test_one_of_azimuth_and_its_deviation_is_not_enough():
    """Directions without deviations, and deviations of zero, are refused."""
    with pytest.raises(InputError, match="expected both or neither"):
        AnchorPaths([1e-8], [1e-10], azimuth_rad=[0.1])
    with pytest.raises(InputError, match="azimuth_std_rad: expected positive numbers"):
        AnchorPaths([1e-8], [1e-10], azimuth_rad=[0.1], azimuth_std_rad=[0.0])
