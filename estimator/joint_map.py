"""What a smoothed run knows of the map as a whole, and which path was which feature.

A result tells each anchor and wall for itself. Whoever builds on the map (a floor plan that is traced
again) needs what they have in common, the heights and clocks that path lengths depend on, and the evidence:
every path that was given to a feature, with its gain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError

__all__ = ["JOINT_SHAPES", "JointMap", "joint_map_of"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
NO_WALL = -1

JOINT_SHAPES: Mapping[str, tuple[tuple[str, ...], str]] = {
    "carrier_hz": ((), "Hz"),
    "anchor_height2_m2": (("anchor",), "m2"),
    "anchor_height2_variance_m4": (("anchor",), "m4"),
    "anchor_bias_m": (("anchor",), "m"),
    "anchor_bias_variance_m2": (("anchor",), "m2"),
    "map_covariance_m2": (("map", "map2"), "m2"),
    "wall_extent_m": (("wall", "end"), "m"),
    "path_epoch": (("path",), "1"),
    "path_anchor": (("path",), "1"),
    "path_number": (("path",), "1"),
    "path_walls": (("path", "bounce"), "1"),
    "path_length_m": (("path",), "m"),
    "path_std_m": (("path",), "m"),
    "path_gain_db": (("path",), "dB"),
    "path_residual_m": (("path",), "m"),
}
"""Axes and units of each field in a result file; ``wall`` and ``anchor`` are the result's axes."""


@dataclass(frozen=True, eq=False)
class JointMap:
    """The map of a smoothed run, its evidence included.

    Parameters
    ----------
    carrier_hz : float
        Carrier frequency, hertz.
    anchor_height2_m2, anchor_height2_variance_m4 : ndarray, shape (K,)
        Squared height difference of anchor and agent, and its variance.
    anchor_bias_m, anchor_bias_variance_m2 : ndarray, shape (K,)
        Clock biases as path lengths, and their variances.
    map_covariance_m2 : ndarray, shape (2 (K + L), 2 (K + L))
        Covariance of all anchors (x, y), then all walls (VRPs), with one another; estimator's frame, rotation
        about RP included.
    wall_extent_m : ndarray, shape (L, 2)
        Where along its line reflections off each wall were detected: signed distances from the foot of RP's
        perpendicular, the direction from RP to the VRP turned by +90 degrees counting positive; NaN where
        none was.
    path_epoch, path_anchor, path_number : ndarray of int64, shape (N,)
        Of each path that was given to a feature: row of the result's epochs, anchor, and its place among the
        measured paths of that anchor and epoch.
    path_walls : ndarray of int64, shape (N, 2)
        The walls that it bounced off, from the anchor to the agent, as columns of the result; -1 beyond
        the last.
    path_length_m, path_std_m : ndarray, shape (N,)
        Measured length, and the standard deviation believed of it.
    path_gain_db : ndarray, shape (N,)
        Measured gain (received power over EIRP), dB; NaN where it is unknown.
    path_residual_m : ndarray, shape (N,)
        Measured less smoothed length.
    """

    carrier_hz: float
    anchor_height2_m2: Array
    anchor_height2_variance_m4: Array
    anchor_bias_m: Array
    anchor_bias_variance_m2: Array
    map_covariance_m2: Array
    wall_extent_m: Array
    path_epoch: Index
    path_anchor: Index
    path_number: Index
    path_walls: Index
    path_length_m: Array
    path_std_m: Array
    path_gain_db: Array
    path_residual_m: Array

    @property
    def bounces(self) -> Index:
        """Number of bounces of each path, shape (N,)."""
        return np.asarray(np.sum(self.path_walls != NO_WALL, axis=1))

    def variables(self) -> dict[str, Any]:
        """The fields by name, as a file holds them."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}


def joint_map_of(value: Callable[[str], NDArray[Any]], epochs: int, anchors: int, walls: int) -> JointMap:
    """A joint map from the variables of a file.

    Parameters
    ----------
    value : callable
        Gives the variable of a name of :data:`JOINT_SHAPES`, its axes already checked.
    epochs, anchors, walls : int
        Sizes of the result.

    Raises
    ------
    InputError
        If a path names an epoch, an anchor or a wall that is not there.
    """
    columns = {name: value(name) for name in JOINT_SHAPES}
    carrier_hz = float(columns.pop("carrier_hz"))
    if not 0.0 < carrier_hz < np.inf:
        raise InputError(f"carrier_hz: expected a positive number, got {carrier_hz}")
    size = 2 * (anchors + walls)
    if columns["map_covariance_m2"].shape != (size, size):
        got = columns["map_covariance_m2"].shape
        raise InputError(f"map_covariance_m2: expected shape {(size, size)}, got {got}")
    limits = {"path_epoch": (0, epochs), "path_anchor": (0, anchors), "path_walls": (NO_WALL, walls)}
    for name, (low, high) in limits.items():
        numbers = columns[name]
        if numbers.size and not (low <= numbers.min() and numbers.max() < high):
            raise InputError(
                f"{name}: expected numbers from {low} to {high - 1}, got {numbers.min()} to {numbers.max()}"
            )
    whole = ("path_epoch", "path_anchor", "path_number", "path_walls")
    typed: dict[str, Any] = {
        name: v.astype(np.int64 if name in whole else np.float64) for name, v in columns.items()
    }
    return JointMap(carrier_hz, **typed)
