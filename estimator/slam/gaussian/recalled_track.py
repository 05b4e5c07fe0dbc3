"""Places passed, as what is heard now tells of them: a fixed-point smoother of some positions.

The error of a past position and those of the present state have a part in common, until something tells them
apart. What corrects the state corrects the past by that part, and what stands on past positions (a surveyed
anchor) moves with the state. Each place keeps its cross-covariance with the whole state of the likeliest
hypothesis; of a step only the state before and after its measurements is needed, since the past and the
measurements tell of each other by way of that state alone. Time and memory are linear in the places.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.motion import Driving
from estimator.slam.models.state_vector import FIRST_ANCHOR, HEADING, PER_ANCHOR, Layout

__all__ = ["Move", "RecalledTrack", "came_from"]

Array = NDArray[np.float64]
_ROUNDING_M2 = 1e-10  # numerical floor of variances, beside which known coordinates are constants


class Move(NamedTuple):
    """How hypotheses were predicted.

    Parameters
    ----------
    step_s : float
        Time of the step, seconds.
    driving : Driving
        What the motion model did.
    by_odometry : bool
        Whether odometry took its place.
    straight : int
        So many hypotheses went on; those after them turned.
    """

    step_s: float
    driving: Driving
    by_odometry: bool
    straight: int


class RecalledTrack(NamedTuple):
    """Some past positions, oldest first.

    Parameters
    ----------
    position_m : ndarray, shape (N, 2)
        Positions, gauge frame, metres.
    covariance_m2 : ndarray, shape (N, 2, 2)
        Their covariances.
    with_state : ndarray, shape (N, 2, n)
        Cross-covariances of their errors with those of the present state of the likeliest hypothesis.
    """

    position_m: Array
    covariance_m2: Array
    with_state: Array

    @classmethod
    def empty(cls, size: int) -> RecalledTrack:
        """No place yet, of a state of ``size`` coordinates."""
        return cls(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 2, size)))

    def every_other(self) -> RecalledTrack:
        """Every other place, the last one kept."""
        every = slice((len(self.position_m) - 1) % 2, None, 2)
        return RecalledTrack(*(column[every] for column in self))

    def with_place(self, mean: Array, covariance: Array) -> RecalledTrack:
        """These places and the present one, of a state with mean (n,) and covariance (n, n)."""
        return RecalledTrack(
            np.concatenate([self.position_m, mean[None, :2]]),
            np.concatenate([self.covariance_m2, covariance[None, :2, :2]]),
            np.concatenate([self.with_state, covariance[None, :2, :]]),
        )

    def unlinked(self, size: int) -> RecalledTrack:
        """The places, of which a present state of ``size`` coordinates tells nothing more."""
        return self._replace(with_state=np.zeros((len(self.position_m), 2, size)))

    def moved(self, columns: slice, by_position: Array) -> RecalledTrack:
        """The places where coordinates of the state became ``by_position`` (., 2) times its position's."""
        with_state = self.with_state.copy()
        with_state[:, :, columns] = with_state[:, :, :2] @ by_position.T
        return self._replace(with_state=with_state)

    def after(
        self, layout: Layout, predicted: Hypotheses, corrected: Hypotheses, move: Move, gate_sigma: float
    ) -> RecalledTrack:
        """The places after an epoch.

        Parameters
        ----------
        layout : Layout
            Of ``corrected``; ``predicted`` may have fewer slots.
        predicted, corrected : Hypotheses
            At the epoch, before and after its measurements.
        move : Move
            How they were predicted.
        gate_sigma : float
            An agent that is farther than this from all that was predicted, or a state that is in the mean of
            its coordinates, is another's: no error of the past is one of its.
        """
        best = corrected.best
        mean, covariance = corrected.mean[best], corrected.covariance[best]
        source, distance = came_from(predicted, mean[:2], covariance[:2, :2])
        if distance > gate_sigma:
            return self.unlinked(mean.size)
        told = _told(layout, predicted, source)
        before = predicted.covariance[source][np.ix_(told, told)]
        before[np.diag_indices_from(before)] += _ROUNDING_M2
        common = self._predicted(predicted.mean[source], source, move)[:, :, told]
        gain = np.linalg.solve(before, common.reshape(-1, told.size).T).T.reshape(common.shape)
        moved = mean[told] - predicted.mean[source, told]
        if moved @ np.linalg.solve(before, moved) > gate_sigma**2 * told.size:
            return self.unlinked(mean.size)
        gain *= _damping(self.covariance_m2, common @ gain.transpose(0, 2, 1))
        change = covariance[np.ix_(told, told)] - before
        return RecalledTrack(
            self.position_m + gain @ moved,
            self.covariance_m2 + gain @ change @ gain.transpose(0, 2, 1),
            gain @ covariance[told],
        )

    def _predicted(self, mean: Array, source: int, move: Move) -> Array:
        """Cross-covariances with the predicted state ``source``, whose mean (n,) is given."""
        after = self.with_state.copy()
        if move.by_odometry:
            around = np.array([-mean[3], mean[2]])
            by_heading = after[:, :, HEADING, None] * around
            after[:, :, :2] += move.step_s * by_heading
            after[:, :, 2:4] = by_heading
            return after
        if source >= move.straight:
            after[:, :, 2:4] = 0.0
        after[:, :, :2] += move.driving.reach_s * after[:, :, 2:4]
        after[:, :, 2:4] *= move.driving.kept
        return after


def _damping(covariance: Array, explained: Array) -> Array:
    """Factors (N, 1, 1) of gains, below 1 where more of a covariance (N, 2, 2) is explained than there is.

    A corrected hypothesis is a mixture's, and no exact posterior of one that was predicted.
    """
    root = np.linalg.cholesky(covariance + _ROUNDING_M2 * np.eye(2))
    half = np.linalg.solve(root, explained)
    share = np.linalg.eigvalsh(np.linalg.solve(root, half.transpose(0, 2, 1)))[:, -1]
    return np.asarray(1.0 / np.sqrt(np.maximum(share, 1.0))[:, None, None])


def _told(layout: Layout, hypotheses: Hypotheses, which: int) -> NDArray[np.int64]:
    """Coordinates that a hypothesis knows something of: the agent's, located anchors', present walls'."""
    anchors = FIRST_ANCHOR + PER_ANCHOR * np.flatnonzero(hypotheses.located[which])
    walls = layout.walls.start + layout.per_slot * np.flatnonzero(hypotheses.present[which])
    return np.concatenate(
        [
            np.arange(FIRST_ANCHOR),
            (anchors[:, None] + np.arange(PER_ANCHOR)).ravel(),
            (walls[:, None] + np.arange(layout.per_slot)).ravel(),
        ]
    )


def came_from(predicted: Hypotheses, position_m: Array, covariance_m2: Array) -> tuple[int, float]:
    """The predicted hypothesis that a corrected position (2,) most likely came from.

    Returns
    -------
    hypothesis : int
        Its number.
    distance : float
        How far the position is from it, standard deviations of both.
    """
    offset = position_m - predicted.mean[:, :2]
    spread = predicted.covariance[:, :2, :2] + covariance_m2 + _ROUNDING_M2 * np.eye(2)
    square = np.einsum("ri,ri->r", offset, np.linalg.solve(spread, offset[..., None])[..., 0])
    score = predicted.log_weight - 0.5 * square - 0.5 * np.log(np.linalg.det(spread))
    source = int(np.argmax(score))
    return source, float(np.sqrt(square[source]))
