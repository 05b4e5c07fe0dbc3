"""Path lengths of features and their derivatives.

Per anchor (PA) at ``a`` the features are the line of sight, a bounce off each wall
``l`` (the virtual anchor, (2), (11), (12)) and the double bounces off each ordered
pair ``(l, m)``, from the anchor over ``l`` then ``m`` to the agent (the image of an
image). With ``n = v / |v|`` a mirror is ``M_v(q) = q + (1 - 2 s) v``, ``s = q.v / |v|^2``,
because RP is the origin and the wall stands half-way to its VRP ``v``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from estimator.slam.births.virtual_anchors import VirtualAnchors
from estimator.slam.layout import Layout

__all__ = [
    "Complex",
    "Features",
    "Prediction",
    "every_feature",
    "lines_of",
    "plane",
    "plane_side",
    "predict_azimuths",
    "predict_paths",
    "reflect",
    "wall_side",
]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Features = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Expected path lengths of all features of all anchors.

    Parameters
    ----------
    length_m : ndarray, shape (R, K, F)
        Path lengths; features ordered line of sight, walls or virtual anchors, pairs of walls
        ``1 + L + l * L + m``.
    flat_m : ndarray, shape (R, K, F)
        Their projections on the plan plus height: what is left without the clock bias.
    room : Room or VirtualAnchors
        The places that this follows from.
    """

    length_m: Array
    flat_m: Array
    room: Room | VirtualAnchors

    @property
    def possible(self) -> NDArray[np.bool_]:
        """Whether the bounces are geometrically possible if the walls were infinite, (R, K, F)."""
        return self.room.possible()

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives (R, K, F, n) of all lengths by the state vector."""
        return self.derivatives(every_feature(len(self.length_m), self.room.layout))

    def derivatives(self, feature: Features) -> Array:
        """Derivatives (R, K, C, n) of the lengths of features ``feature`` (R, K, C)."""
        layout = self.room.layout
        length = self.flat_m[(*lines_of(feature), feature)]
        jacobian = self.room.pull_back(self.room.offset_of(feature) / length, feature)
        for k in range(layout.anchors):
            jacobian[:, k, :, layout.height2(k)] = 0.5 / length[:, k]
            jacobian[:, k, :, layout.bias(k)] = 1.0
        return jacobian


def lines_of(feature: Features) -> tuple[Features, Features]:
    """Row and anchor of features (R, K, C), to be indexed with."""
    rows, anchors, _ = feature.shape
    return np.arange(rows)[:, None, None], np.arange(anchors)[:, None]


def every_feature(rows: int, layout: Layout) -> Features:
    """The numbers (R, K, F) of all features of all anchors."""
    return np.broadcast_to(np.arange(layout.features), (rows, layout.anchors, layout.features))


def _dot(a: Array, b: Array) -> Array:
    """Inner products of plane vectors, (..., 2) -> (...); on small arrays far faster than an axis sum."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


def reflect(point: Array, vrp: Array) -> Array:
    """Mirror images, arrays (..., 2) that broadcast, RP at the origin (equation (2))."""
    scale = (_dot(point, vrp) / _dot(vrp, vrp))[..., None]
    return np.asarray(point + (1.0 - 2.0 * scale) * vrp)


def wall_side(point: Array, vrp: Array) -> Array:
    """Signed distance of points from walls, negative on RP's side; (..., 2) -> (...)."""
    length = np.sqrt(_dot(vrp, vrp))
    return np.asarray(_dot(point, vrp) / length - 0.5 * length)


def plane(vectors: Array) -> Complex:
    """Plane vectors (..., 2) as complex numbers (...)."""
    return np.asarray(vectors[..., 0] + 1j * vectors[..., 1])


def plane_side(point: Complex, towards: Complex, half: Array) -> Array:
    """:func:`wall_side` of walls, given conjugate directions ``towards`` and half the VRPs' lengths."""
    return np.asarray((point * towards).real - half)


def _vectors(plane: Complex) -> Array:
    """The inverse of :func:`plane`."""
    return np.ascontiguousarray(plane)[..., None].view(np.float64)


@dataclass(frozen=True, eq=False)
class _Bounces:
    """Over which walls the paths of the F features of L slots go.

    Parameters
    ----------
    wall : tuple of ndarray of int64, shape (F,)
        The wall of the first of two bounces, and of the last; 0 of a bounce that a feature lacks.
    before : ndarray of int64, shape (F,)
        What the last bounce mirrors: 0 the anchor, 1 + l its image in wall l.
    two : ndarray of bool, shape (L, L)
        Pairs of different walls.
    """

    wall: tuple[Features, Features]
    before: Features
    two: NDArray[np.bool_]


@cache
def _bounces(slots: int) -> _Bounces:
    walls, none = np.arange(slots), np.zeros(1, dtype=np.int64)
    first = np.concatenate([none, 0 * walls, np.repeat(walls, slots)])
    last = np.concatenate([none, walls, np.tile(walls, slots)])
    before = np.where(np.arange(first.size) > slots, 1 + first, 0)
    return _Bounces((first, last), before, ~np.eye(slots, dtype=bool))


class Room:
    """The parts of state vectors, and how a shift of a source follows from theirs.

    In the complex plane a mirror is ``M_v(q) = v - t conj(q)`` with ``t = v / conj(v)``, and the
    mirrored direction of ``d`` is ``-t conj(d)``: a few products of small arrays, which is what counts.
    """

    def __init__(self, mean: Array, layout: Layout) -> None:
        rows, self.layout = len(mean), layout
        devices = mean[:, layout.FIRST_ANCHOR : layout.walls.start].reshape(
            rows, layout.anchors, layout.PER_ANCHOR
        )
        self.anchor, self.height2, self.bias = devices[..., 0:2], devices[..., 2], devices[..., 3]
        self._agent = plane(mean[:, None, None, 0:2])  # (R, 1, 1)
        self._anchor = plane(self.anchor)  # (R, K)
        wall = plane(mean[:, layout.walls].reshape(rows, 1, layout.slots, 2))
        turn = wall / wall.conj()
        self._wall, self._turn = wall, turn  # (R, 1, L)
        self._second, self._second_turn = wall[:, :, None, :], turn[:, :, None, :]  # of (l, m)
        self._image = wall - turn * self._anchor[:, :, None].conj()  # (R, K, L)
        self._double = self._second - self._second_turn * self._image[..., None].conj()  # (R, K, L, M)
        flat = self._double.reshape(*self._anchor.shape, layout.pairs)
        self._before = np.concatenate([self._anchor[:, :, None], self._image], axis=2)  # the last bounce
        self._source = np.concatenate([self._before, flat], axis=2)

    def sources(self) -> Array:
        """The anchors and their images, (R, K, F, 2)."""
        return _vectors(self._source)

    def offsets(self) -> Complex:
        """From the sources to the agent, (R, K, F)."""
        return np.asarray(self._agent - self._source)

    def offset_of(self, feature: Features) -> Complex:
        """From the sources of the features ``feature`` (R, K, C) to the agent, (R, K, C)."""
        return np.asarray(self._agent - self._source[(*lines_of(feature), feature)])

    def pull_back(self, covector: Complex, feature: Features) -> Array:
        """Derivatives (R, K, C, n) of something of features ``feature`` (R, K, C).

        It depends on agent minus source by ``covector`` (R, K, C).
        """
        layout, bounces = self.layout, _bounces(self.layout.slots)
        row, anchor = lines_of(feature)
        by_source = covector
        by_wall = np.zeros((*feature.shape, layout.slots), dtype=np.complex128)
        lines = np.arange(feature.size).reshape(feature.shape) * layout.slots
        for number in (1, 0):  # the last bounce, then the one before
            passes = feature > (0 if number else layout.slots)
            if not passes.any():
                continue
            wall = bounces.wall[number][feature]
            vrp, turn = self._wall[row, 0, wall], self._turn[row, 0, wall]
            back = turn * by_source.conj()  # minus the direction as seen from before the bounce
            scale = self._before[row, anchor, bounces.before[feature] if number else 0] / vrp
            by_vrp = by_source * (scale - 1.0) - back * scale.conj()  # minus direction^T d M_vrp / d vrp
            by_wall.reshape(-1)[lines + wall] += np.where(passes, by_vrp, 0.0)
            by_source = np.where(passes, -back, by_source)
        jacobian = np.zeros((*feature.shape, layout.size))
        jacobian[..., 0], jacobian[..., 1] = covector.real, covector.imag
        jacobian[..., layout.walls] = by_wall.view(np.float64)
        by_anchor = _vectors(-by_source)
        for j in range(layout.anchors):
            jacobian[:, j, :, layout.anchor_xy(j)] = by_anchor[:, j]
        return jacobian

    def possible(self) -> NDArray[np.bool_]:
        """Whether agent and anchor stand on the sides of the walls that bounces need, (R, K, F)."""
        rows, anchors = self._anchor.shape
        length = np.abs(self._wall)
        towards, half = (self._wall / length).conj(), 0.5 * length
        agent = plane_side(self._agent, towards, half)  # (R, 1, L)
        anchor = plane_side(self._anchor[:, :, None], towards, half)  # (R, K, L)
        image = plane_side(self._image[..., None], towards[:, :, None], half[:, :, None])  # (R, K, L, M)
        double = plane_side(self._double, towards[..., None], half[..., None])
        near, before = agent[:, :, None], agent[..., None]
        total = near + image
        fraction = near / np.where(np.abs(total) < 1e-9, 1e-9, total)  # of the way back to wall m
        bounce = before + fraction * (double - before)  # its side of wall l
        pair = (near * image > 0.0) & (bounce * anchor[..., None] > 0.0) & _bounces(self.layout.slots).two
        result = np.ones((rows, anchors, self.layout.features), dtype=bool)
        result[..., 1 : 1 + self.layout.slots] = agent * anchor > 0.0
        result[..., 1 + self.layout.slots :] = pair.reshape(rows, anchors, self.layout.pairs)
        return result


def _places(mean: Array, layout: Layout) -> Room | VirtualAnchors:
    return Room(mean, layout) if layout.shared else VirtualAnchors(mean, layout)


def predict_paths(mean: Array, layout: Layout) -> Prediction:
    """Path lengths, derivatives and geometric possibility of features.

    Parameters
    ----------
    mean : ndarray, shape (R, n)
        State vectors; empty wall slots and unknown anchors may hold any finite,
        non-zero numbers (their features are the caller's to mask).
    layout : Layout
        Positions in the state vector.

    Returns
    -------
    Prediction
    """
    room = _places(mean, layout)
    offset = room.offsets()
    square = offset.real**2 + offset.imag**2 + room.height2[:, :, None]
    length = np.sqrt(np.maximum(square, 1e-6))
    return Prediction(length + room.bias[:, :, None], length, room)


def predict_azimuths(mean: Array, layout: Layout, feature: Features | None = None) -> tuple[Array, Array]:
    """Directions of arrival of features and their derivatives.

    A path arrives from its source: the anchor, or its image. Angles are measured from
    the expected direction of the gauge frame's x axis, so that ``theta`` adds to them.

    Parameters
    ----------
    mean, layout
        As for :func:`predict_paths`.
    feature : ndarray of int64, shape (R, K, C), optional
        Which features of each anchor; by default all, in order.

    Returns
    -------
    azimuth : ndarray, shape (R, K, C)
        Radians, not wrapped.
    jacobian : ndarray, shape (R, K, C, n)
        Derivatives by the state vector.
    """
    room = _places(mean, layout)
    feature = every_feature(len(mean), layout) if feature is None else feature
    offset = room.offset_of(feature)
    azimuth = np.angle(-offset) + mean[:, None, None, layout.THETA]
    across = 1j * offset / np.maximum(offset.real**2 + offset.imag**2, 1e-6)
    jacobian = room.pull_back(across, feature)
    jacobian[..., layout.THETA] = 1.0
    return azimuth, jacobian
