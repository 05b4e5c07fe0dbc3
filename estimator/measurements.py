"""What the SLAM engines take in: epochs of path delays and Gaussian walls.

The estimator's frame has the agent's start (the reference point, RP) as origin and
the axes of the agent's arrays at the start as axes; nothing else is known.
``hapslam extract`` writes these types to one netCDF file (:mod:`estimator.measurement_files`), which
``hapslam slam`` reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.odometry import Odometry
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = [
    "AnchorPaths",
    "Epoch",
    "GaussianVrp",
    "MeasurementSet",
    "Odometry",
]

Array = NDArray[np.float64]


def _finite(name: str, value: object, shape: tuple[int | None, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True))
    ):
        wanted = tuple("n" if want is None else want for want in shape)
        raise InputError(f"{name}: expected shape {wanted}, got {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers, got {array[~np.isfinite(array)][0]}")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class AnchorPaths:
    """The paths that one anchor was heard on in one epoch.

    Parameters
    ----------
    delay_s : array_like, shape (n,)
        Absolute times of flight, seconds.
    delay_std_s : array_like, shape (n,)
        Their standard deviations, seconds, positive.
    gain_db : array_like, shape (n,), optional
        Channel gain ``|a|^2`` (received power over EIRP), dB; free space gives
        minus the free-space loss. Without it (None) powers inform nothing.
    azimuth_rad, azimuth_std_rad : array_like, shape (n,), optional
        Directions of arrival in the agent's axes, radians, and their standard
        deviations; both or neither.
    """

    delay_s: Array
    delay_std_s: Array
    gain_db: Array | None = None
    azimuth_rad: Array | None = None
    azimuth_std_rad: Array | None = None

    def __post_init__(self) -> None:
        delay = _finite("delay_s", self.delay_s, (None,))
        object.__setattr__(self, "delay_std_s", _finite("delay_std_s", self.delay_std_s, delay.shape))
        for name in ("gain_db", "azimuth_rad", "azimuth_std_rad"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _finite(name, getattr(self, name), delay.shape))
        object.__setattr__(self, "delay_s", delay)
        if (delay <= 0.0).any():
            raise InputError(f"delay_s: expected positive times of flight, got {delay.min()} s")
        if (self.delay_std_s <= 0.0).any():
            raise InputError(f"delay_std_s: expected positive numbers, got {self.delay_std_s.min()} s")
        if (self.azimuth_rad is None) != (self.azimuth_std_rad is None):
            raise InputError("azimuth_rad, azimuth_std_rad: expected both or neither, got one of them")
        if self.azimuth_std_rad is not None and np.any(self.azimuth_std_rad <= 0.0):
            raise InputError(
                f"azimuth_std_rad: expected positive numbers, got {self.azimuth_std_rad.min()} rad"
            )

    @classmethod
    def none(cls) -> AnchorPaths:
        """Those of an anchor that was not heard."""
        return cls(np.empty(0), np.empty(0))

    @property
    def range_m(self) -> Array:
        """Path lengths ``c * delay_s``, shape (n,), metres."""
        return self.delay_s * SPEED_OF_LIGHT_M_S

    @property
    def range_std_m(self) -> Array:
        """Standard deviations of the path lengths, shape (n,), metres."""
        return self.delay_std_s * SPEED_OF_LIGHT_M_S

    def __len__(self) -> int:
        return int(self.delay_s.size)


@dataclass(frozen=True, eq=False)
class Epoch:
    """All anchors' paths at one instant.

    Parameters
    ----------
    index : int
        Number of the epoch, 0 for the first.
    time_s : float
        Time since the first epoch, seconds.
    paths : tuple of AnchorPaths
        One entry per anchor, always in the same order.
    sweep : tuple of GaussianVrp
        Walls that a beam sweep at this epoch saw: the agent's own mirror images relative
        to the agent, in its axes.
    heading_held : bool
        Whether the agent's axes are still those of the start. If not, directions and
        sweeps tell angles between things, but nothing of the map's rotation.
    asked : tuple of bool, optional
        Which anchors were measured to at this epoch; None says all of them. Of one that was not asked,
        that nothing was heard means nothing.
    odometry : Odometry, optional
        How the agent's body moved from the epoch before to this one; at the first epoch, which has none
        before, it says nothing. The body's x axis at the start is that of the estimator's frame.
    """

    index: int
    time_s: float
    paths: tuple[AnchorPaths, ...]
    sweep: tuple[GaussianVrp, ...] = ()
    heading_held: bool = True
    asked: tuple[bool, ...] | None = None
    odometry: Odometry | None = None

    def __post_init__(self) -> None:
        if self.asked is None:
            return
        if len(self.asked) != len(self.paths):
            raise InputError(
                f"epoch {self.index}: expected asked of {len(self.paths)} anchors, got {len(self.asked)}"
            )
        for k, (asked, paths) in enumerate(zip(self.asked, self.paths, strict=True)):
            if len(paths) and not asked:
                raise InputError(
                    f"epoch {self.index}: expected no paths of anchor {k}, which was not asked, "
                    f"got {len(paths)}"
                )

    @property
    def was_asked(self) -> NDArray[np.bool_]:
        """Whether each anchor was asked, shape (K,)."""
        return (
            np.ones(len(self.paths), dtype=bool) if self.asked is None else np.array(self.asked, dtype=bool)
        )


@dataclass(frozen=True, eq=False)
class GaussianVrp:
    """A wall as a Gaussian virtual reference point, in the estimator's frame.

    Parameters
    ----------
    mean_m : array_like, shape (2,)
        VRP relative to RP, metres.
    covariance_m2 : array_like, shape (2, 2)
        Covariance, square metres, symmetric positive definite.
    """

    mean_m: Array
    covariance_m2: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean_m", _finite("mean_m", self.mean_m, (2,)))
        covariance = _finite("covariance_m2", self.covariance_m2, (2, 2))
        if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise InputError(
                f"covariance_m2: expected a symmetric positive definite matrix, got {covariance.tolist()}"
            )
        object.__setattr__(self, "covariance_m2", covariance)


@dataclass(frozen=True, eq=False)
class MeasurementSet:
    """A run's measurements: the walls sensed at the start and the epochs that follow.

    Parameters
    ----------
    anchors : tuple of str
        Names of the anchors, in the order of ``Epoch.paths``.
    walls : tuple of GaussianVrp
        Walls from active sensing at the start, in any order.
    epochs : tuple of Epoch
        Ascending in index and time.
    carrier_hz : float
        Carrier frequency, hertz: gives the free-space loss of a path length.
    settings : mapping
        The configuration that produced these data (JSON types only).
    dataset : str or None
        Where the dataset lies that these measurements came from: a path relative to
        the folder of the measurement file. ``evaluate`` and ``plot`` look for the truth
        there; nothing else follows it.
    known_anchors_m : array_like, shape (K, 2), optional
        Where the anchors are, estimator's frame, metres: for the methods that know
        them. None says that nobody does.
    max_speed_m_s : float, optional
        The agent never moves faster, metres per second; None says that nothing is known.
    echo_bias_std_m : float, optional
        Of what the covariances of walls and sweeps say of range, the part that all of them have in common: a
        standard deviation, metres. None says that their errors are independent.
    """

    anchors: tuple[str, ...]
    walls: tuple[GaussianVrp, ...]
    epochs: tuple[Epoch, ...]
    carrier_hz: float
    settings: Mapping[str, Any] = field(default_factory=dict)
    dataset: str | None = None
    known_anchors_m: Array | None = None
    max_speed_m_s: float | None = None
    echo_bias_std_m: float | None = None

    def __post_init__(self) -> None:
        if self.max_speed_m_s is not None and not 0.0 < self.max_speed_m_s < np.inf:
            raise InputError(f"max_speed_m_s: expected a positive number, got {self.max_speed_m_s}")
        if self.echo_bias_std_m is not None and not 0.0 <= self.echo_bias_std_m < np.inf:
            raise InputError(f"echo_bias_std_m: expected 0 or a positive number, got {self.echo_bias_std_m}")
        if self.known_anchors_m is not None:
            places = _finite("known_anchors_m", self.known_anchors_m, (len(self.anchors), 2))
            object.__setattr__(self, "known_anchors_m", places)
        for epoch in self.epochs:
            if len(epoch.paths) != len(self.anchors):
                raise InputError(
                    f"epoch {epoch.index}: expected paths of {len(self.anchors)} anchors, "
                    f"got {len(epoch.paths)}"
                )
        for before, after in zip(self.epochs, self.epochs[1:], strict=False):
            if after.index <= before.index or after.time_s <= before.time_s:
                raise InputError(
                    f"epochs: expected ascending index and time, got {after.index} at {after.time_s} s "
                    f"after {before.index} at {before.time_s} s"
                )
