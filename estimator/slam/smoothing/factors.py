"""What a smoother works on: which measurement came from which feature, in the gauge of the layout.

A :class:`Problem` lists the factors of a whole run: path lengths (and directions) given to features of
anchors, walls sensed at the start, walls seen by sweeps on the way. A :class:`Trajectory` says where
everything is: the agent at every epoch, and what stands still, as a state vector of
:mod:`estimator.slam.models.state_vector`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.measurements import GaussianVrp
from estimator.slam.association.gating import Gating
from estimator.slam.models.clocks import Clocks
from estimator.slam.models.motion import Motion
from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.models.state_vector import AGENT, ECHO_BIAS, THETA, Layout
from estimator.slam.models.visibility import Visibility

__all__ = ["Models", "PathFactors", "Problem", "SweepFactor", "Trajectory", "column_of"]

Array = NDArray[np.float64]

_VAGUE = 1e-8  # 1 / m^2: keeps a feature without measurements where it is


@dataclass(frozen=True, eq=False)
class PathFactors:
    """Measured paths with the features they come from.

    Parameters
    ----------
    epoch, anchor, feature : ndarray of int64, shape (N,)
        Row of the problem's epochs, anchor, and feature as in :mod:`estimator.slam.models.features`.
    length_m, std_m : ndarray, shape (N,)
        Path lengths and standard deviations, metres.
    azimuth_rad, azimuth_std_rad : ndarray, shape (N,), optional
        Directions of arrival in the estimator's frame; an infinite standard deviation where
        there is none, as by default everywhere.
    number : ndarray of int64, shape (N,), optional
        Place of each path among those of its anchor and epoch; -1, as by default, where nobody asks.

    The factors are kept in the order of their epochs.
    """

    epoch: NDArray[np.int64]
    anchor: NDArray[np.int64]
    feature: NDArray[np.int64]
    length_m: Array
    std_m: Array
    azimuth_rad: Array = None  # type: ignore[assignment]  # by default: none are measured
    azimuth_std_rad: Array = None  # type: ignore[assignment]
    number: NDArray[np.int64] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        shape = np.shape(self.epoch)
        if self.number is None:
            object.__setattr__(self, "number", np.full(shape, -1))
        if self.azimuth_rad is None or self.azimuth_std_rad is None:
            object.__setattr__(self, "azimuth_rad", np.zeros(shape))
            object.__setattr__(self, "azimuth_std_rad", np.full(shape, np.inf))
        for name in (entry.name for entry in fields(self)):
            if np.shape(getattr(self, name)) != shape or len(shape) != 1:
                got = np.shape(getattr(self, name))
                raise InputError(f"PathFactors.{name}: expected shape (N,) like epoch {shape}, got {got}")
        if not np.all(self.std_m > 0.0) or not np.all(np.isfinite(self.length_m)):
            raise InputError("PathFactors: expected finite lengths and positive standard deviations")
        order = np.argsort(self.epoch, kind="stable")
        for entry in fields(self):
            dtype = np.int64 if entry.name in ("epoch", "anchor", "feature", "number") else np.float64
            object.__setattr__(
                self, entry.name, np.ascontiguousarray(getattr(self, entry.name)[order], dtype=dtype)
            )

    def within(self, first: int, last: int) -> PathFactors:
        """The factors of epochs ``first .. last``, both included, counted from ``first``."""
        begin, end = np.searchsorted(self.epoch, [first, last + 1])
        parts = {entry.name: getattr(self, entry.name)[begin:end] for entry in fields(self)}
        return PathFactors(**{**parts, "epoch": parts["epoch"] - first})


@dataclass(frozen=True, eq=False)
class SweepFactor:
    """A wall seen on the way: the agent's mirror image relative to the agent.

    Parameters
    ----------
    epoch, slot : int
        Row of the problem's epochs, and the wall.
    flash : GaussianVrp
        The image, in the estimator's axes.
    """

    epoch: int
    slot: int
    flash: GaussianVrp


class Echoes(Protocol):
    """What a smoother needs to know of sweeps."""

    @property
    def echo_bias_std_m(self) -> float:
        """Standard deviation of the error in range that all sweeps have in common, metres."""


class Models(Protocol):
    """The groups of settings that a smoother uses; those of any engine's configuration."""

    @property
    def noise(self) -> MeasurementNoise:
        """Noise of path lengths, and heights."""

    @property
    def clocks(self) -> Clocks:
        """Biases of path lengths."""

    @property
    def motion(self) -> Motion:
        """How the agent moves."""

    @property
    def visibility(self) -> Visibility:
        """How features appear and vanish."""

    @property
    def gating(self) -> Gating:
        """Gates."""

    @property
    def sweeps(self) -> Echoes:
        """Flashes of sweeps."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A run to be smoothed.

    Parameters
    ----------
    layout : Layout
        Anchors and wall slots; the wall in slot 0 defines the gauge.
    time_s : ndarray, shape (T,)
        Times of the epochs, ascending.
    paths : PathFactors
        Measured paths.
    sensed : tuple of (GaussianVrp or None), length L
        What active sensing at the start gave for each slot, estimator's frame; slot 0 must have it.
    config : Models
        Models: motion, priors of heights, clock biases and the initial velocity.
    sweeps : tuple of SweepFactor
        Walls seen on the way.
    height2_prior : tuple of (float, float), length K, optional
        Mean and standard deviation of each anchor's squared height difference; by default those of the noise
        model.
    """

    layout: Layout
    time_s: Array
    paths: PathFactors
    sensed: tuple[GaussianVrp | None, ...]
    config: Models
    sweeps: tuple[SweepFactor, ...] = field(default=())
    height2_prior: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        if len(self.sensed) != self.layout.slots or not self.sensed or self.sensed[0] is None:
            raise InputError(
                f"Problem.sensed: expected an entry for each of {self.layout.slots} walls and the first "
                f"one sensed, got {len(self.sensed)}"
            )
        if len(self.time_s) == 0 or np.any(np.diff(self.time_s) <= 0.0):
            raise InputError("Problem.time_s: expected ascending times")
        limits = (len(self.time_s), self.layout.anchors, self.layout.features)
        for name, limit in zip(("epoch", "anchor", "feature"), limits, strict=True):
            value = getattr(self.paths, name)
            if value.size and (value.min() < 0 or value.max() >= limit):
                raise InputError(
                    f"Problem.paths.{name}: expected numbers from 0 to {limit - 1}, got {value.max()}"
                )

    @property
    def bearing_rad(self) -> float:
        """Sensed bearing of the reference wall: the gauge frame's x axis for ``theta = 0``."""
        reference = self.sensed[0]
        assert reference is not None  # checked on construction
        return float(np.arctan2(reference.mean_m[1], reference.mean_m[0]))

    def height2_of(self, anchor: int) -> tuple[float, float]:
        """Prior mean and standard deviation of an anchor's squared height difference, square metres."""
        if self.height2_prior is not None:
            return self.height2_prior[anchor]
        return self.config.noise.height2_mean_m2, self.config.noise.height2_std_m2

    def basis(self) -> tuple[Array, Array]:
        """Free directions (n, q) of what stands still, and the information (q,) of their priors."""
        layout, clocks = self.layout, self.config.clocks
        columns, information = [THETA], [0.0]
        if self.config.sweeps.echo_bias_std_m > 0.0:
            columns.append(ECHO_BIAS)
            information.append(self.config.sweeps.echo_bias_std_m**-2)
        for k in range(layout.anchors):
            place = layout.anchor_xy(k)
            columns += [place.start, place.start + 1]
            information += [_VAGUE, _VAGUE]
            _, height2_std = self.height2_of(k)
            if height2_std > 0.0:
                columns.append(layout.height2(k))
                information.append(height2_std**-2)
            if clocks.clock_bias_std_m > 0.0 and not (clocks.clock_bias_common and k):
                columns.append(layout.bias(k))
                information.append(clocks.clock_bias_std_m**-2)
        walls = np.arange(layout.walls.start, layout.walls.stop)
        columns += [int(c) for c in np.delete(walls, 1)]  # the gauge: VRP 0 lies on the x axis
        information += [_VAGUE] * (len(walls) - 1)
        basis = np.zeros((layout.size, len(columns)))
        basis[columns, np.arange(len(columns))] = 1.0
        if clocks.clock_bias_std_m > 0.0 and clocks.clock_bias_common:
            shared = columns.index(layout.bias(0))
            basis[[layout.bias(k) for k in range(layout.anchors)], shared] = 1.0
        return basis, np.array(information)


def column_of(basis: Array) -> NDArray[np.int64]:
    """Column of a basis (n, q) that moves each element of the state vector, (n,); -1 where none does."""
    return np.where(np.any(basis != 0.0, axis=1), np.argmax(basis, axis=1), -1)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where everything is, in the gauge frame.

    Parameters
    ----------
    agent : ndarray, shape (T, 4)
        Agent states.
    still : ndarray, shape (n,)
        State vector of what stands still; its agent entries are not used.
    """

    agent: Array
    still: Array

    def moved(self, agent: Array, border: Array, basis: Array) -> Trajectory:
        """The trajectory after a step of the chain (T, 4) and of the border (q,)."""
        return Trajectory(self.agent + agent, self.still + basis @ border)

    def states(self) -> Array:
        """State vectors of all epochs, shape (T, n)."""
        states = np.tile(self.still, (len(self.agent), 1))
        states[:, AGENT] = self.agent
        return states
