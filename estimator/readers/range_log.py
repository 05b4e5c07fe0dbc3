"""Logs of ranges: what receivers write, range by range, and the measurement set that it makes.

All readers of ranges give a :class:`RangeLog`. Ranges of one time stamp are an epoch; the anchors that it
has no row of were not asked. Where a log claims no standard deviation, it is that of the ranges' scatter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.measurements import AnchorPaths, Epoch, MeasurementSet
from estimator.readers.range_scatter import range_scatter
from estimator.readers.start import Start, start_of
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = ["RANGING", "RangeLog", "measurements_of"]

Array = NDArray[np.float64]
_FARTHEST_M = 1e6
_SHORTEST_M = 1e-3  # noise can make a range negative, which no path is
# What is believed of ranges that are not known to be calibrated, whoever measured them: settings of
# :class:`estimator.slam.gaussian.config.GaussianConfig`.
RANGING: Mapping[str, float] = {
    "clock_bias_std_m": 0.2,  # antenna delays of UWB modules differ by decimetres
    "range_scale_std": 0.05,  # ranging radios are out of scale by some percent, devices of one make alike
    "alike_s": 0.5,  # multipath and interference last while the agent moves by a wavelength or a few
    "level_memory": 100.0,  # the noise of a place lasts for as many ranges
    "acceleration_density": 0.5,  # robots, vehicles, pedestrians change speed by 0.7 m/s in a second
    "velocity_memory_s": 9.0,  # with it, a speed of 1.5 m/s per axis
    "velocity_std_m_s": 1.5,
    "clutter_mean": 0.1,  # ranging tells one path; it is wrong now and then
    "height2_mean_m2": 0.0,
    "height2_std_m2": 0.0,  # in the plane; a constant height is a bias
}


@dataclass(frozen=True, eq=False)
class RangeLog:
    """Ranges in the order of time.

    Parameters
    ----------
    time_s : ndarray, shape (N,)
        Time stamps, seconds, in any order and from any origin.
    anchor : ndarray of int64, shape (N,)
        Which anchor.
    range_m : ndarray, shape (N,)
        Ranges; NaN where the anchor was asked and not heard.
    names : tuple of str
        The K anchors.
    range_std_m, gain_db, azimuth_rad, azimuth_std_rad : ndarray, shape (N,), optional
        Standard deviations, gains, and directions of arrival; NaN where there is none.
    anchors_m : ndarray, shape (K, 2), optional
        Where the anchors stand, if the log tells.

    Raises
    ------
    InputError
        If there is no range, or numbers are out of range.
    """

    time_s: Array
    anchor: NDArray[np.int64]
    range_m: Array
    names: tuple[str, ...]
    range_std_m: Array | None = None
    gain_db: Array | None = None
    azimuth_rad: Array | None = None
    azimuth_std_rad: Array | None = None
    anchors_m: Array | None = None

    def __post_init__(self) -> None:
        if not np.isfinite(self.range_m).any():
            raise InputError("ranges: expected at least one, got none")
        if not np.isfinite(self.time_s).all():
            raise InputError("time: expected finite numbers, got others")
        if np.abs(self.range_m[np.isfinite(self.range_m)]).max() > _FARTHEST_M:
            raise InputError(
                f"ranges: expected metres, none beyond {_FARTHEST_M:g}, got {np.nanmax(self.range_m):g}"
            )
        for name in ("range_std_m", "azimuth_std_rad"):
            column = getattr(self, name)
            if column is not None and np.any(column[np.isfinite(column)] <= 0.0):
                raise InputError(f"{name}: expected positive numbers, got {np.nanmin(column):g}")

    def std_m(self, claimed_m: float | None = None) -> Array:
        """Standard deviations (N,) of the ranges: claimed, as logged, or of their scatter."""
        if claimed_m is not None:
            return np.full(self.range_m.shape, claimed_m)
        std = np.full(self.range_m.shape, np.nan) if self.range_std_m is None else self.range_std_m.copy()
        lacking = ~np.isfinite(std)
        if lacking.any():
            scatter = range_scatter(self.time_s, self.anchor, self.range_m, len(self.names))
            std[lacking] = scatter[self.anchor[lacking]]
        return std


def measurements_of(
    log: RangeLog,
    anchors_m: ArrayLike | None = None,
    range_std_m: float | None = None,
    start_m: ArrayLike | None = None,
    carrier_hz: float = 6e9,
    calibrated: bool = False,
    model: Mapping[str, Any] | None = None,
) -> MeasurementSet:
    """The measurement set of a log whose anchors are known.

    Parameters
    ----------
    log : RangeLog
        The ranges.
    anchors_m : array_like, shape (K, 2), optional
        The anchors, in any frame, metres; by default those of the log.
    range_std_m : float, optional
        Standard deviation of all ranges, metres; by default as logged, or that of their scatter.
    start_m : array_like, shape (2,), optional
        Where the agent starts, in the same frame; by default where the first ranges meet. It is the origin of
        the estimator's frame.
    carrier_hz : float
        Carrier frequency, hertz; only gains need it.
    calibrated : bool
        Whether ranges are known to be free of bias and to scale.
    model : mapping, optional
        What else is known of the measurements: fields of
        :class:`estimator.slam.gaussian.config.GaussianConfig`.

    Raises
    ------
    InputError
        If places or deviations are not usable numbers, or the first ranges do not tell the start.
    """
    places = log.anchors_m if anchors_m is None else np.array(anchors_m, dtype=np.float64)
    if places is None or places.shape != (len(log.names), 2) or not np.isfinite(places).all():
        got = "none" if places is None else f"shape {places.shape}"
        raise InputError(f"anchors_m: expected a place (x, y) of each of {', '.join(log.names)}, got {got}")
    if range_std_m is not None and not 0.0 < range_std_m < np.inf:
        raise InputError(f"range_std_m: expected a positive number, got {range_std_m}")
    std = log.std_m(range_std_m)
    believed: dict[str, Any] = dict(RANGING)
    if calibrated:
        believed |= {"clock_bias_std_m": 0.0, "range_scale_std": 0.0}
    believed |= {
        "range_std_m": 0.5 * float(np.median(std)),
        "region_m": 2.0 * float(np.nanmax(log.range_m)),
    }
    believed |= dict(model or {})
    if start_m is None:
        start = start_of(log.time_s, log.anchor, log.range_m, std, places, believed)
    else:
        start = Start(np.array(start_m, dtype=np.float64), believed.get("start_std_m", 0.0))
        if start.place_m.shape != (2,) or not np.isfinite(start.place_m).all():
            raise InputError(f"start_m: expected two finite numbers, got {start_m}")
    believed["start_std_m"] = start.std_m
    return MeasurementSet(
        anchors=log.names,
        walls=(),
        epochs=_epochs(log, std),
        carrier_hz=carrier_hz,
        settings={
            "measurement_model": believed,
            "start_m": start.place_m.tolist(),
            "first_time_s": float(log.time_s.min()),
        },
        known_anchors_m=places - start.place_m,
    )


def _epochs(log: RangeLog, std: Array) -> tuple[Epoch, ...]:
    """Ranges of one time stamp each; the others were not asked."""
    order = np.argsort(log.time_s, kind="stable")
    times, begin = np.unique(log.time_s[order], return_index=True)
    ends = [*begin[1:].tolist(), len(order)]
    silent = AnchorPaths.none()
    epochs = []
    for t, (a, b) in enumerate(zip(begin.tolist(), ends, strict=True)):
        rows = order[a:b]
        asked, paths = [False] * len(log.names), [silent] * len(log.names)
        for k in np.unique(log.anchor[rows]).tolist():
            asked[k] = True
            own = rows[(log.anchor[rows] == k) & np.isfinite(log.range_m[rows])]
            if own.size:
                paths[k] = _paths(log, own, std)
        told = None if all(asked) else tuple(asked)
        epochs.append(Epoch(t, float(times[t] - times[0]), tuple(paths), asked=told))
    return tuple(epochs)


def _paths(log: RangeLog, rows: NDArray[np.int64], std: Array) -> AnchorPaths:
    """An anchor's paths in one epoch; gains and directions where all of them have one."""

    def column(values: Array | None) -> Array | None:
        return values[rows] if values is not None and np.isfinite(values[rows]).all() else None

    azimuth, spread = column(log.azimuth_rad), column(log.azimuth_std_rad)
    if azimuth is None or spread is None:
        azimuth = spread = None
    length = np.maximum(log.range_m[rows], _SHORTEST_M)
    light = SPEED_OF_LIGHT_M_S
    return AnchorPaths(length / light, std[rows] / light, column(log.gain_db), azimuth, spread)
