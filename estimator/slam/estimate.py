"""Point estimates with covariances from the hypotheses, in the estimator's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotation_matrix
from estimator.slam.births.virtual_walls import Wall, virtual_walls
from estimator.slam.candidates import Candidate, candidates
from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.hypotheses import moments
from estimator.slam.gaussian.state import GaussianState

__all__ = ["Estimate", "estimate"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Agent, anchors and walls after an epoch.

    Parameters
    ----------
    agent_mean : ndarray, shape (4,)
        Position and velocity, estimator's frame.
    agent_covariance : ndarray, shape (4, 4)
        Covariance, the rotation of the map included.
    rotation_std_rad : float
        Standard deviation of the rotation of the map about RP.
    anchor_valid : ndarray of bool, shape (K,)
        Whether the anchor has been located in the likeliest hypothesis.
    anchor_mean_m, anchor_covariance_m2 : ndarray, shapes (K, 2) and (K, 2, 2)
        Anchors; NaN where not located.
    wall_id : ndarray of int64, shape (J,)
        Walls that count as found.
    wall_mean_m, wall_covariance_m2 : ndarray, shapes (J, 2) and (J, 2, 2)
        Their VRPs.
    hypotheses : int
        Number of hypotheses (or particles) behind the estimate.
    log_evidence : float
        Log of the evidence of all epochs so far.
    anchor_existence : ndarray, shape (K,)
        Probability that the anchor stands where it is said to, 0 where not located.
    wall_existence : ndarray, shape (J,)
        Probability that the wall exists, (35).
    candidates : tuple of Candidate
        The likeliest hypotheses one by one, the likeliest first; of engines that keep marginals
        alone, the walls not found yet, each with its probability of existence.
    """

    agent_mean: Array
    agent_covariance: Array
    rotation_std_rad: float
    anchor_valid: NDArray[np.bool_]
    anchor_mean_m: Array
    anchor_covariance_m2: Array
    wall_id: NDArray[np.int64]
    wall_mean_m: Array
    wall_covariance_m2: Array
    hypotheses: int
    log_evidence: float
    anchor_existence: Array
    wall_existence: Array
    candidates: tuple[Candidate, ...]


def estimate(state: GaussianState, config: GaussianConfig) -> Estimate:
    """Moment-matched estimates (the MMSE estimates (34), (37) of the mixture).

    Parameters
    ----------
    state : GaussianState
        Hypotheses.
    config : GaussianConfig
        ``confirm_radius_m``: rows that have a wall elsewhere do not blur it.
    """
    layout = state.layout
    rows = state.rows
    weight = np.exp(rows.log_weight)
    weight = weight / weight.sum()
    mean, covariance = moments(weight, rows.mean, rows.covariance)
    best = int(np.argmax(weight))

    agent = _turned(state, mean, covariance, (slice(0, 2), slice(2, 4)))

    def place(know: NDArray[np.bool_], xy: slice) -> tuple[Array, Array]:
        """A point in the rows that know it."""
        if know.all():
            return _turned(state, mean, covariance, (xy,))
        share = weight[know] / weight[know].sum()
        return _turned(state, *moments(share, rows.mean[know], rows.covariance[know]), (xy,))

    def wall(slot: int) -> Wall:
        """A wall in the rows that have it where the likeliest has it."""
        xy = layout.wall(slot)
        near = np.linalg.norm(rows.mean[:, xy] - rows.mean[best, xy], axis=1) < config.confirm_radius_m
        standing = rows.present[:, slot] & near
        existence = min(float(weight[standing].sum()), 1.0)
        return Wall(int(state.slots.wall_id[slot]), *place(standing, xy), existence)

    valid = rows.located[best].copy()
    anchors, anchor_covariances = (
        np.full((layout.anchors, 2), np.nan),
        np.full((layout.anchors, 2, 2), np.nan),
    )
    anchor_existence = np.zeros(layout.anchors)
    for k in np.flatnonzero(valid):
        anchor_existence[k] = min(float(weight[rows.located[:, k]].sum()), 1.0)
        xy = layout.anchor_xy(int(k))
        anchors[k], anchor_covariances[k] = place(rows.located[:, k], xy)
    found = np.flatnonzero(state.slots.confirmed & rows.present[best]).tolist()
    walls = [wall(slot) for slot in found] if state.shared else virtual_walls(state, weight)
    return Estimate(
        agent[0],
        agent[1],
        float(np.sqrt(covariance[layout.THETA, layout.THETA])),
        valid,
        anchors,
        anchor_covariances,
        np.array([wall.wall_id for wall in walls], dtype=np.int64),
        np.array([wall.mean_m for wall in walls]).reshape(-1, 2),
        np.array([wall.covariance_m2 for wall in walls]).reshape(-1, 2, 2),
        len(rows),
        state.log_evidence,
        anchor_existence,
        np.array([wall.existence for wall in walls], dtype=np.float64),
        candidates(state),
    )


def _turned(
    state: GaussianState, mean: Array, covariance: Array, parts: tuple[slice, ...]
) -> tuple[Array, Array]:
    """Vectors of the gauge frame, and theta's uncertainty, in the estimator's frame."""
    theta = state.layout.THETA
    turn = rotation_matrix(state.bearing_rad + mean[theta])
    linear = np.zeros((2 * len(parts), len(mean)))
    values = np.empty(2 * len(parts))
    for i, part in enumerate(parts):
        rows = slice(2 * i, 2 * i + 2)
        values[rows] = turn @ mean[part]
        linear[rows, part] = turn
        linear[rows, theta] = (-values[2 * i + 1], values[2 * i])
    return values, linear @ covariance @ linear.T
