"""Path lengths of features and their derivatives.

Per anchor (PA) at ``a`` the features are the line of sight, a bounce off each wall
``l`` (the virtual anchor, (2), (11), (12)) and the double bounces off each ordered
pair ``(l, m)``, from the anchor over ``l`` then ``m`` to the agent (the image of an
image). With ``n = v / |v|`` a mirror is ``M_v(q) = q + (1 - 2 s) v``, ``s = q.v / |v|^2``,
because RP is the origin and the wall stands half-way to its VRP ``v``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimator.slam.births.virtual_anchors import VirtualAnchors
from estimator.slam.layout import Layout

__all__ = [
    "Features",
    "Prediction",
    "every_feature",
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
        length = np.take_along_axis(self.flat_m, feature, axis=2)
        jacobian = self.room.pull_back(self.room.offset_of(feature) / length[..., None], feature)
        for k in range(layout.anchors):
            jacobian[:, k, :, layout.height2(k)] = 0.5 / length[:, k]
            jacobian[:, k, :, layout.bias(k)] = 1.0
        return jacobian


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


def _plane(vectors: Array) -> Complex:
    """Plane vectors (..., 2) as complex numbers (...)."""
    return np.asarray(vectors[..., 0] + 1j * vectors[..., 1])


def _vectors(plane: Complex) -> Array:
    """The inverse of :func:`_plane`."""
    return np.ascontiguousarray(plane)[..., None].view(np.float64)


def _by_wall(point: Complex, vrp: Complex, turn: Complex, direction: Complex) -> Complex:
    """``direction^T d M_vrp(point) / d vrp``."""
    part = direction * point / vrp
    return np.asarray(direction - part + turn * part.conj())


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
        self.agent = mean[:, None, 0:2]  # (R, 1, 2)
        self.anchor, self.height2, self.bias = devices[..., 0:2], devices[..., 2], devices[..., 3]
        self._anchor = _plane(self.anchor)  # (R, K)
        wall = _plane(mean[:, layout.walls].reshape(rows, 1, layout.slots, 2))
        turn = wall / wall.conj()
        self._wall, self._turn = wall, turn  # (R, 1, L)
        self._second, self._second_turn = wall[:, :, None, :], turn[:, :, None, :]  # of (l, m)
        self._image = wall - turn * self._anchor[:, :, None].conj()  # (R, K, L)
        self._double = self._second - self._second_turn * self._image[..., None].conj()  # (R, K, L, M)
        flat = self._double.reshape(*self._anchor.shape, layout.pairs)
        self._source = np.concatenate([self._anchor[:, :, None], self._image, flat], axis=2)

    def sources(self) -> Array:
        """The anchors and their images, (R, K, F, 2)."""
        return _vectors(self._source)

    def offset_of(self, feature: Features) -> Array:
        """From the sources of the features ``feature`` (R, K, C) to the agent, (R, K, C, 2)."""
        return self.agent[:, :, None] - _vectors(np.take_along_axis(self._source, feature, axis=2))

    def pull_back(self, covector: Array, feature: Features) -> Array:
        """Derivatives (R, K, C, n) of something of features ``feature`` (R, K, C).

        It depends on agent minus source by ``covector`` (R, K, C, 2).
        """
        layout, slots = self.layout, self.layout.slots
        jacobian = np.zeros((*feature.shape, layout.size))
        jacobian[..., 0:2] = covector
        by_source = _plane(covector)
        lines = jacobian.reshape(-1, layout.size)
        row, anchor, _ = np.broadcast_arrays(*np.ogrid[: len(feature), : layout.anchors, : feature.shape[2]])

        def through(chosen: NDArray[np.bool_], last: NDArray[np.int64], before: Complex) -> None:
            """Bounce chosen features off their walls ``last``; ``before`` is the image before."""
            r, direction = row[chosen], by_source[chosen]
            wall, turn = self._wall[r, 0, last], self._turn[r, 0, last]
            by_last = -_by_wall(before, wall, turn, direction)
            by_source[chosen] = -turn * direction.conj()  # seen from before the bounce
            line, column = np.flatnonzero(chosen), layout.walls.start + 2 * last
            lines[line, column] += by_last.real
            lines[line, column + 1] += by_last.imag

        double, single = feature > slots, (feature > 0) & (feature <= slots)
        if double.any():
            first, second = np.divmod(feature[double] - 1 - slots, slots)
            r, k = row[double], anchor[double]
            through(double, second, self._image[r, k, first])
            through(double, first, self._anchor[r, k])
        if single.any():
            through(single, feature[single] - 1, self._anchor[row[single], anchor[single]])
        by_anchor = _vectors(-by_source)
        for j in range(layout.anchors):
            jacobian[:, j, :, layout.anchor_xy(j)] = by_anchor[:, j]
        return jacobian

    def possible(self) -> NDArray[np.bool_]:
        """Whether agent and anchor stand on the sides of the walls that bounces need, (R, K, F)."""
        rows, anchors = self._anchor.shape
        length = np.abs(self._wall)
        towards, half = (self._wall / length).conj(), 0.5 * length
        agent = _plane(self.agent)[..., None]  # (R, 1, 1)
        agent_side = (agent * towards).real - half  # (R, 1, L)
        anchor_side = (self._anchor[:, :, None] * towards).real - half  # (R, K, L)
        image_side = (self._image[..., None] * towards[:, :, None, :]).real - half[:, :, None, :]
        near = agent_side[:, :, None, :]
        total = near + image_side
        fraction = near / np.where(np.abs(total) < 1e-9, 1e-9, total)
        bounce = agent[..., None] + fraction * (self._double - agent[..., None])  # on wall m
        bounce_side = (bounce * towards[..., None]).real - half[..., None]
        pair = (near * image_side > 0.0) & (bounce_side * anchor_side[..., None] > 0.0)
        pair &= ~np.eye(self.layout.slots, dtype=bool)
        direct = np.ones((rows, anchors, 1), dtype=bool)
        return np.concatenate(
            [direct, agent_side * anchor_side > 0.0, pair.reshape(rows, anchors, self.layout.pairs)], axis=2
        )


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
    offset = room.agent[:, :, None, :] - room.sources()
    square = _dot(offset, offset) + room.height2[:, :, None]
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
    square = np.maximum(_dot(offset, offset), 1e-6)[..., None]
    azimuth = np.arctan2(-offset[..., 1], -offset[..., 0]) + mean[:, None, None, layout.THETA]
    across = np.stack([-offset[..., 1], offset[..., 0]], axis=-1) / square
    jacobian = room.pull_back(across, feature)
    jacobian[..., layout.THETA] = 1.0
    return azimuth, jacobian
