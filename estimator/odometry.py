"""Odometry: how far the agent went and how far its body turned from one epoch to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError, InputError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ODOMETRY", "Odometry", "odometry_of", "odometry_variables"]

Array = NDArray[np.float64]
ODOMETRY: Mapping[str, tuple[str, ...]] = {
    "odometry_displacement_m": ("epoch", "xy"),
    "odometry_turn_rad": ("epoch",),
    "odometry_covariance": ("epoch", "degree", "degree2"),
}
"""Variables of files, and their axes; NaN at epochs without odometry."""
_SYMMETRIC, _NEGATIVE = 1e-8, 1e-10  # rounding, as shares of the largest variance


@dataclass(frozen=True, eq=False)
class Odometry:
    """How the agent's body moved from the epoch before to this one.

    Parameters
    ----------
    displacement_m : array_like, shape (2,)
        The way from the place before to this one, in the axes that the body had at the epoch before (x
        ahead), metres.
    turn_rad : float
        By how much the body turned meanwhile, counter-clockwise, radians.
    covariance : array_like, shape (3, 3)
        Covariance of displacement and turn: square metres, metre radians, square radians; symmetric, no
        eigenvalue negative.
    """

    displacement_m: Array
    turn_rad: float
    covariance: Array

    def __post_init__(self) -> None:
        given = {"displacement_m": (2,), "turn_rad": (), "covariance": (3, 3)}
        for name, shape in given.items():
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != shape:
                raise InputError(f"odometry {name}: expected shape {shape}, got {value.shape}")
            if not np.isfinite(value).all():
                raise InputError(f"odometry {name}: expected finite numbers, got {value.tolist()}")
            value.flags.writeable = False
            object.__setattr__(self, name, value if shape else float(value))
        spread, largest = self.covariance, float(np.abs(self.covariance).max())
        skew = float(np.abs(spread - spread.T).max())
        if skew > _SYMMETRIC * largest or np.linalg.eigvalsh(spread)[0] < -_NEGATIVE * largest:
            raise InputError(
                "odometry covariance: expected a symmetric matrix without a negative eigenvalue, "
                f"got {spread.tolist()}"
            )


def odometry_variables(found: Sequence[Odometry | None]) -> dict[str, Any]:
    """Odometry of successive epochs as variables of a netCDF file; none if no epoch has any."""
    if not any(one is not None for one in found):
        return {}
    displacement, turn = np.full((len(found), 2), np.nan), np.full(len(found), np.nan)
    covariance = np.full((len(found), 3, 3), np.nan)
    for i, one in enumerate(found):
        if one is not None:
            displacement[i], turn[i], covariance[i] = one.displacement_m, one.turn_rad, one.covariance
    facts = (
        {"units": "m", "long_name": "way since the epoch before, in the body's axes there"},
        {"units": "rad", "long_name": "turn of the body since the epoch before, counter-clockwise"},
        {"units": "1", "long_name": "covariance of displacement (m, m) and turn (rad)"},
    )
    values = (displacement, turn, covariance)
    return {
        name: (ODOMETRY[name], *column)
        for name, column in zip(ODOMETRY, zip(values, facts, strict=True), strict=True)
    }


def odometry_of(data: xr.Dataset) -> list[Odometry | None]:
    """Odometry of each epoch of a netCDF file; None where it has none.

    Raises
    ------
    FileFormatError
        If only some of the variables are there, or they have other axes.
    InputError
        If values are out of range.
    """
    there = [name for name in ODOMETRY if name in data]
    if not there:
        return [None] * data.sizes["epoch"]
    for name, dims in ODOMETRY.items():
        if name not in data or data[name].dims != dims:
            raise FileFormatError(
                f"odometry: expected {name} with axes {dims}, "
                f"got {data[name].dims if name in data else 'none'}"
            )
    columns = [data[name].values for name in ODOMETRY]
    found: list[Odometry | None] = []
    for i in range(data.sizes["epoch"]):
        row = [column[i] for column in columns]
        nothing = all(np.isnan(value).all() for value in row)
        found.append(None if nothing else Odometry(row[0], float(row[1]), row[2]))
    return found
