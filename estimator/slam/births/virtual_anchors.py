"""Virtual anchors as features: points that each anchor has for itself.

The path of a virtual anchor is as long as the straight line from it to the agent, whatever
walls stand between, and however many bounces it stands for. So its length depends on the agent and on that
point alone, and on nothing that another anchor knows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.layout import Layout

__all__ = ["VirtualAnchors", "implied_walls", "vrp_by_anchor", "vrp_by_image", "vrp_of_image"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def vrp_of_image(image: Array, anchor: Array) -> Array:
    """VRPs of the walls half-way between anchors and virtual anchors, (3), RP at the origin; (..., 2)."""
    chord = image - anchor
    rise = np.sum(image * image, axis=-1) - np.sum(anchor * anchor, axis=-1)
    return np.asarray((rise / np.sum(chord * chord, axis=-1))[..., None] * chord)


def vrp_by_image(image: Array, anchor: Array) -> Array:
    """Jacobians (..., 2, 2) of VRPs by virtual anchors (..., 2) of anchors (..., 2)."""
    chord = image - anchor
    square = np.sum(chord * chord, axis=-1)[..., None, None]
    rise = (np.sum(image * image, axis=-1) - np.sum(anchor * anchor, axis=-1))[..., None, None]
    by_scale = 2.0 * (image[..., None, :] - rise / square * chord[..., None, :])
    return np.asarray((chord[..., :, None] * by_scale + rise * np.eye(2)) / square)


def vrp_by_anchor(image: Array, anchor: Array) -> Array:
    """Jacobians (..., 2, 2) of VRPs by anchors (..., 2), of virtual anchors (..., 2) that stay."""
    chord = image - anchor
    square = np.sum(chord * chord, axis=-1)[..., None, None]
    rise = (np.sum(image * image, axis=-1) - np.sum(anchor * anchor, axis=-1))[..., None, None]
    by_scale = 2.0 * (rise / square * chord[..., None, :] - anchor[..., None, :])
    return np.asarray((chord[..., :, None] * by_scale - rise * np.eye(2)) / square)


class VirtualAnchors:
    """The parts of state vectors whose slots hold virtual anchors (:mod:`estimator.slam.layout`).

    Every point is predicted for every anchor; which of them an anchor really has is the caller's
    to say (:meth:`estimator.slam.gaussian.state.GaussianState.active`).

    Parameters
    ----------
    mean : ndarray, shape (R, n)
        State vectors.
    layout : Layout
        Positions in them, ``shared`` false.
    """

    def __init__(self, mean: Array, layout: Layout) -> None:
        rows, self.layout = len(mean), layout
        devices = mean[:, layout.FIRST_ANCHOR : layout.walls.start].reshape(
            rows, layout.anchors, layout.PER_ANCHOR
        )
        self.agent = mean[:, None, 0:2]  # (R, 1, 2)
        self.anchor, self.height2, self.bias = devices[..., 0:2], devices[..., 2], devices[..., 3]
        slots = mean[:, layout.walls].reshape(rows, layout.slots, layout.per_slot)
        self.reach, bearing = slots[..., 0], slots[..., 1]  # (R, L)
        self.outward = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)  # (R, L, 2)
        self.across = np.stack([-np.sin(bearing), np.cos(bearing)], axis=-1)
        self.point = slots[..., 2:4] + self.reach[..., None] * self.outward

    def sources(self) -> Array:
        """The anchors and the points, (R, K, F, 2)."""
        shape = (*self.anchor.shape[:2], self.layout.slots, 2)
        points = np.broadcast_to(self.point[:, None], shape)
        return np.concatenate([self.anchor[:, :, None], points], axis=2)

    def offsets(self) -> Complex:
        """From the sources to the agent, (R, K, F), in the complex plane."""
        offset = self.agent[:, :, None] - self.sources()
        return np.asarray(offset[..., 0] + 1j * offset[..., 1])

    def offset_of(self, feature: NDArray[np.int64]) -> Complex:
        """From the sources of the features ``feature`` (R, K, C) to the agent, (R, K, C)."""
        return np.asarray(np.take_along_axis(self.offsets(), feature, axis=2))

    def pull_back(self, covector: Complex, feature: NDArray[np.int64]) -> Array:
        """Derivatives (R, K, C, n) of something of features ``feature`` (R, K, C).

        It depends on agent minus source by ``covector`` (R, K, C).
        """
        covector = np.stack([covector.real, covector.imag], axis=-1)
        layout = self.layout
        jacobian = np.zeros((*feature.shape, layout.size))
        jacobian[..., 0:2] = covector
        direct = (feature == 0)[..., None]
        for k in range(layout.anchors):
            jacobian[:, k, :, layout.anchor_xy(k)] = np.where(direct, -covector, 0.0)[:, k]
        image = feature > 0
        row, slot, own = np.nonzero(image)[0], feature[image] - 1, -covector[image]  # by the point
        lines = jacobian.reshape(-1, layout.size)
        line, first = np.flatnonzero(image), layout.walls.start + layout.per_slot * slot
        lines[line, first] = np.sum(own * self.outward[row, slot], axis=-1)
        lines[line, first + 1] = self.reach[row, slot] * np.sum(own * self.across[row, slot], axis=-1)
        lines[line, first + 2], lines[line, first + 3] = own[:, 0], own[:, 1]
        return jacobian

    def possible(self) -> NDArray[np.bool_]:
        """No geometry forbids a virtual anchor: all true, (R, K, F)."""
        return np.ones((*self.anchor.shape[:2], self.layout.features), dtype=bool)


def implied_walls(mean: Array, layout: Layout, owner: NDArray[np.int64]) -> Array:
    """VRPs (R, L, 2) of the walls that the slots hold or, as virtual anchors, imply.

    Parameters
    ----------
    mean : ndarray, shape (R, n)
        State vectors.
    layout : Layout
        Positions in them.
    owner : ndarray of int64, shape (L,)
        The anchor whose virtual anchor each slot holds; of empty slots anything.
    """
    if layout.shared:
        return mean[:, layout.walls].reshape(len(mean), layout.slots, 2)
    places = VirtualAnchors(mean, layout)
    return vrp_of_image(places.point, places.anchor[:, owner])
