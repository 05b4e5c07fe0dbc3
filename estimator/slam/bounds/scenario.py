"""What a run through a known scene could measure: the information that bounds are made of.

A :class:`Scenario` is the truth (walls, anchors, track); :class:`Sensing` says what is known and what
is measured of it. Together they give, for every epoch, the derivatives of the expected
measurements by the state vector of :mod:`estimator.slam.models.state_vector` and the measurements'
covariance, with associations known and true visibility (:mod:`estimator.specular`). Everything is in the
estimator's frame: RP is the origin, ``theta`` is zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import vrp_of_line
from estimator.slam.models.directions import predict_azimuths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import ECHO_BIAS, POSITION, THETA, Layout
from estimator.slam.models.sweeps import predict_flashes
from estimator.specular import SpecularPaths, specular_paths

__all__ = ["Observation", "Scenario", "Sensing"]

Array = NDArray[np.float64]

_ANY_CLOCK_M2 = 1e4  # variance of a clock bias that is not known
_ANY_HEADING_RAD2 = 100.0  # variance of a heading that is not known
_UNKNOWN_M2 = 1e6  # variance of a coordinate that is not known


@dataclass(frozen=True)
class Sensing:
    """What is known and what is measured; the defaults are the paper's numbers of Section V-E.

    Parameters
    ----------
    range_std_m : float
        Standard deviation of a path length, metres.
    detection_probability : float
        Each path is measured with this probability; information is scaled by it, which is
        slightly optimistic.
    order : int
        Largest number of bounces measured, 1 or 2.
    anchors_known, walls_known : bool
        Whether their places are given.
    sensed : mapping of int to float or array
        Walls sensed at the start: index in the scenario to variance per axis, or to the covariance (2, 2)
        of its VRP, square metres.
    sweep_every : int
        The sweep is repeated every so many epochs; 0 for never. It sees the walls of
        :meth:`Scenario.walls_met`.
    sweep_variance : float
        A repeated sweep gives the agent's mirror image in each of these walls, with this variance per axis
        and per square metre of the wall's distance. The default is the law that the
        paper's four variances follow.
    azimuth_std_rad : float or None
        Standard deviation of the arrival angle of each path; None if angles are not measured.
    flashes : bool
        Whether a sweep sees instead the walls that flash: those on which the perpendicular from the agent has
        its foot, with nothing in the way (:meth:`Scenario.flashing`).
    echo_bias_std_m : float
        Of the range of all sweeps, the one at the start included, the error that they share: its standard
        deviation, metres.
    odometry : tuple of float, optional
        Standard deviation of each component of a displacement between epochs, as a share of its length, and
        of the body's turn, radians; None for the motion model.
    lines_shared : bool
        Whether walls in one line are one unknown.
    heading_held : bool
        Whether the agent's axes stay those of the start. If not, each epoch after the first has an
        unknown heading of its own, common to its angles and its sweep.
    clock_bias : {"none", "common", "each", "free"}
        Unknown clock bias: none, a constant one of all anchors or of each, or one of all anchors that is new
        in every epoch, as of time differences of arrival.
    height2_std_m2 : float
        Standard deviation of the squared height differences; 0 if they are known.
    acceleration_variance : float
        Driving noise of the motion (39), m^2/s^4 per axis.
    velocity_std_m_s : float
        Standard deviation of the unknown initial velocity, per axis.
    """

    range_std_m: float = 0.1
    detection_probability: float = 1.0
    order: int = 1
    anchors_known: bool = False
    walls_known: bool = False
    sensed: Mapping[int, ArrayLike] = field(default_factory=dict)
    sweep_every: int = 0
    sweep_variance: float = 8e-4
    flashes: bool = False
    echo_bias_std_m: float = 0.0
    odometry: tuple[float, float] | None = None
    lines_shared: bool = False
    azimuth_std_rad: float | None = None
    heading_held: bool = True
    clock_bias: Literal["none", "common", "each", "free"] = "none"
    height2_std_m2: float = 0.0
    acceleration_variance: float = 0.0278
    velocity_std_m_s: float = 1.0

    def __post_init__(self) -> None:
        for name in ("range_std_m", "sweep_variance", "acceleration_variance", "velocity_std_m_s"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"Sensing.{name}: expected a positive number, got {getattr(self, name)}"
                )
        if self.azimuth_std_rad is not None and not 0.0 < self.azimuth_std_rad < np.inf:
            raise ConfigurationError(
                f"Sensing.azimuth_std_rad: expected a positive number, got {self.azimuth_std_rad}"
            )
        if not 0.0 < self.detection_probability <= 1.0:
            raise ConfigurationError(
                "Sensing.detection_probability: expected a number from 0 (excluded) to 1, "
                f"got {self.detection_probability}"
            )
        if self.order not in (0, 1, 2):
            raise ConfigurationError(f"Sensing.order: expected 0, 1 or 2, got {self.order}")
        if self.clock_bias not in ("none", "common", "each", "free"):
            raise ConfigurationError(
                f"Sensing.clock_bias: expected none, common, each or free, got {self.clock_bias!r}"
            )
        if self.odometry is not None and not all(0.0 < std < np.inf for std in self.odometry):
            raise ConfigurationError(f"Sensing.odometry: expected two positive numbers, got {self.odometry}")
        if not 0.0 <= self.echo_bias_std_m < np.inf:
            raise ConfigurationError(
                f"Sensing.echo_bias_std_m: expected 0 or a positive number, got {self.echo_bias_std_m}"
            )
        if self.sweep_every < 0 or not 0.0 <= self.height2_std_m2 < np.inf:
            raise ConfigurationError(
                "Sensing.sweep_every, height2_std_m2: expected 0 or more, "
                f"got {self.sweep_every}, {self.height2_std_m2}"
            )


@dataclass(frozen=True, eq=False)
class Observation:
    """One epoch's measurements to first order.

    Parameters
    ----------
    jacobian : ndarray, shape (m, n)
        Derivatives by the state vector.
    covariance : ndarray, shape (m, m)
        Covariance of the measurements.
    """

    jacobian: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Scenario:
    """The truth of a run.

    Parameters
    ----------
    start_m, end_m : array_like, shape (L, 2)
        End points of the walls in the plan's frame, metres. All of them block and reflect.
    anchors_m : array_like, shape (K, 2)
        Anchors, plan's frame, metres.
    track_m : array_like, shape (T, 2)
        The agent at every epoch, plan's frame, metres; the first is RP.
    step_s : float
        Time between epochs, seconds.
    height2_m2 : array_like, shape (K,), optional
        Squared height differences of anchors and agent, square metres; zero by default.
    same_line_m : float
        Walls whose VRPs are nearer than this lie in one line, metres. Plans round ends of walls to
        centimetres, which moves the VRPs of two parts of one line apart by about two.
    """

    start_m: Array
    end_m: Array
    anchors_m: Array
    track_m: Array
    step_s: float = 1.0
    height2_m2: Array | None = None
    same_line_m: float = 0.02
    _paths: dict[int, SpecularPaths] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("start_m", "end_m", "anchors_m", "track_m"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.ndim != 2 or value.shape[-1] != 2 or not len(value) or not np.all(np.isfinite(value)):
                raise InputError(f"Scenario.{name}: expected finite points (n, 2), got shape {value.shape}")
            object.__setattr__(self, name, value)
        if self.start_m.shape != self.end_m.shape:
            raise InputError("Scenario.end_m: expected one end for every start")
        if not 0.0 < self.step_s < np.inf:
            raise InputError(f"Scenario.step_s: expected a positive number, got {self.step_s}")
        if not 0.0 < self.same_line_m < np.inf:
            raise InputError(f"Scenario.same_line_m: expected a positive number, got {self.same_line_m}")

    @property
    def layout(self) -> Layout:
        """State vector with one slot per wall."""
        return Layout(len(self.anchors_m), len(self.start_m))

    @cached_property
    def vrps_m(self) -> Array:
        """VRPs relative to RP, shape (L, 2)."""
        reference = self.track_m[0]
        return np.asarray(vrp_of_line(self.start_m, self.end_m, reference) - reference)

    @cached_property
    def states(self) -> Array:
        """True state vectors, shape (T, n); velocities are differences of the track."""
        layout, track = self.layout, self.track_m
        states = np.zeros((len(track), layout.size))
        states[:, POSITION] = track - track[0]
        if len(track) > 1:
            states[:, 2:4] = np.gradient(track, self.step_s, axis=0)
        for k, anchor in enumerate(self.anchors_m - track[0]):
            states[:, layout.anchor_xy(k)] = anchor
            if self.height2_m2 is not None:
                states[:, layout.height2(k)] = self.height2_m2[k]
        states[:, layout.walls] = self.vrps_m.ravel()
        return states

    def paths(self, order: int = 1) -> SpecularPaths:
        """Paths of up to ``order`` bounces, traced once."""
        if order not in self._paths:
            self._paths[order] = specular_paths(self.start_m, self.end_m, self.anchors_m, self.track_m, order)
        return self._paths[order]

    def visible(self, order: int = 1) -> NDArray[np.bool_]:
        """Paths that exist, shape (T, K, F), features as in :mod:`estimator.slam.models.features`."""
        layout = self.layout
        paths = self.paths(order)
        seen = np.zeros((*paths.visible.shape[:2], layout.features), dtype=bool)
        for i, walls in enumerate(paths.walls):
            seen[..., _feature(walls, layout.slots)] = paths.visible[..., i]
        return seen

    def walls_met(self, beams: int = 64, least: int = 2) -> NDArray[np.bool_]:
        """Walls that a sweep of pencil beams all around would see, shape (T, L).

        Parameters
        ----------
        beams : int
            Number of beams, equally spaced.
        least : int
            Beams that must meet a wall first: two points make a wall.
        """
        start, end, track = self.start_m, self.end_m, self.track_m
        along, gap = end - start, start - track[:, None]  # (L, 2), (T, L, 2)
        azimuth = 2.0 * np.pi * (np.arange(beams) + 0.5) / beams
        towards = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        facing = _cross(towards[:, None], along)  # (B, L)
        facing = np.where(np.abs(facing) < 1e-12, np.inf, facing)
        reach = _cross(gap, along)[:, None] / facing  # (T, B, L)
        share = _cross(gap[:, None], towards[:, None]) / facing
        hit = (reach > 0.0) & (share >= 0.0) & (share <= 1.0)
        first = np.argmin(np.where(hit, reach, np.inf), axis=-1)
        met = np.any(hit, axis=-1)[..., None] & (first[..., None] == np.arange(len(start)))
        return np.asarray(met.sum(axis=1) >= least)

    def flashing(self) -> NDArray[np.bool_]:
        """Walls that flash at normal incidence, shape (T, L).

        The foot of the perpendicular from the agent lies on the wall, and no wall crosses the way there.
        """
        start, along, track = self.start_m, self.end_m - self.start_m, self.track_m
        share = np.sum((track[:, None] - start) * along, axis=-1) / np.sum(along**2, axis=-1)
        way = start + share[..., None] * along - track[:, None]  # (T, L, 2), to the foot
        crossing = _cross(way[:, :, None], along)  # (T, L, walls in the way)
        crossing = np.where(np.abs(crossing) < 1e-12, np.inf, crossing)
        gap = (start - track[:, None])[:, None]
        reach, place = _cross(gap, along) / crossing, _cross(gap, way[:, :, None]) / crossing
        blocks = (reach > 0.0) & (reach < 1.0 - 1e-9) & (place >= 0.0) & (place <= 1.0)
        return np.asarray((share >= 0.0) & (share <= 1.0) & ~np.any(blocks, axis=-1))

    @cached_property
    def lines(self) -> NDArray[np.int64]:
        """For each wall the first one that lies in the same line, shape (L,)."""
        first: list[int] = []
        for wall, vrp in enumerate(self.vrps_m):
            away = {one: np.linalg.norm(self.vrps_m[one] - vrp) for one in first}
            same = [one for one, distance_m in away.items() if distance_m < self.same_line_m]
            first.append(same[0] if same else wall)
        return np.array(first)

    def observations(self, sensing: Sensing) -> list[Observation]:
        """What every epoch measures."""
        states, layout = self.states, self.layout
        seen = self.visible(sensing.order)
        met = self.flashing() if sensing.flashes else self.walls_met()
        result = []
        for t, state in enumerate(states):
            # of each kind of measurement: derivatives, variances, derivatives by the agent's heading
            count = int(seen[t].sum())
            variance = sensing.range_std_m**2 / sensing.detection_probability
            lengths = predict_paths(state[None], layout).jacobian[0]
            parts = [(lengths[seen[t]], np.full(count, variance), np.zeros(count))]
            if sensing.azimuth_std_rad is not None:
                angles = predict_azimuths(state[None], layout)[1][0]
                variance = sensing.azimuth_std_rad**2 / sensing.detection_probability
                parts.append((angles[seen[t]], np.full(count, variance), -np.ones(count)))
            if sensing.sweep_every and t and t % sensing.sweep_every == 0:
                images, by_state = predict_flashes(state, layout)
                for wall in np.flatnonzero(met[t]):
                    image = images[wall]
                    variance = sensing.sweep_variance * 0.25 * float(image @ image)
                    parts.append((by_state[wall], np.full(2, variance), np.array([image[1], -image[0]])))
            jacobian, variances, by_heading = (np.concatenate(column) for column in zip(*parts, strict=True))
            jacobian[:, THETA] = 0.0
            covariance = np.diag(variances)
            if sensing.clock_bias == "free":
                covariance[:count, :count] += _ANY_CLOCK_M2
            if t and not sensing.heading_held:
                covariance += _ANY_HEADING_RAD2 * np.outer(by_heading, by_heading)
            result.append(Observation(jacobian, covariance))
        return result

    def prior(self, sensing: Sensing) -> tuple[Array, Array]:
        """Independent unknowns of the first state.

        Returns
        -------
        basis : ndarray, shape (n, q)
            Derivatives of the state vector by the unknowns.
        variance : ndarray, shape (q,)
            Their prior variances: the covariance of the state is ``basis diag(variance) basis'``.
        """
        layout = self.layout
        columns: list[Array] = []
        variances: list[float] = []

        def unknown(index: int | list[int], variance: float) -> None:
            column = np.zeros(layout.size)
            column[index] = 1.0
            columns.append(column)
            variances.append(variance)

        for axis in (2, 3):
            unknown(axis, sensing.velocity_std_m_s**2)
        for k in range(layout.anchors):
            place = layout.anchor_xy(k)
            if not sensing.anchors_known:
                unknown(place.start, _UNKNOWN_M2)
                unknown(place.start + 1, _UNKNOWN_M2)
            if sensing.height2_std_m2 > 0.0:
                unknown(layout.height2(k), sensing.height2_std_m2**2)
            if sensing.clock_bias == "each":
                unknown(layout.bias(k), _UNKNOWN_M2)
        if sensing.clock_bias == "common":
            unknown([layout.bias(k) for k in range(layout.anchors)], _UNKNOWN_M2)
        if sensing.echo_bias_std_m > 0.0:
            column = np.zeros(layout.size)
            column[ECHO_BIAS] = 1.0
            for wall in sensing.sensed:  # the first sweep saw them too far by it
                column[layout.wall(wall)] = -2.0 * self.vrps_m[wall] / np.linalg.norm(self.vrps_m[wall])
            columns.append(column)
            variances.append(sensing.echo_bias_std_m**2)
        lines = self.lines if sensing.lines_shared else np.arange(layout.slots)
        for wall in [] if sensing.walls_known else np.unique(lines).tolist():
            group = np.flatnonzero(lines == wall).tolist()
            seen = [sensing.sensed[one] for one in group if one in sensing.sensed]
            given = np.asarray(seen[0] if seen else _UNKNOWN_M2, dtype=np.float64)
            values, vectors = np.linalg.eigh(given if given.ndim == 2 else given * np.eye(2))
            for value, vector in zip(values, vectors.T, strict=True):
                column = np.zeros(layout.size)
                for other in group:
                    column[layout.wall(other)] = vector
                columns.append(column)
                variances.append(float(value))
        return np.stack(columns, axis=1), np.array(variances)


def _feature(walls: tuple[int, ...], slots: int) -> int:
    """Number of the feature with at most two bounces."""
    if len(walls) == 2:
        return 1 + slots + walls[0] * slots + walls[1]
    return 1 + walls[0] if walls else 0


def _cross(a: Array, b: Array) -> Array:
    """Cross products of plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
