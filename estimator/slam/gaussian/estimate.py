"""Point estimates with covariances from the hypotheses, in the estimator's frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotate_by_angle_of, rotation_matrix
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.integrity import judged
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.gaussian.virtual_walls import Wall, virtual_walls
from estimator.slam.models.hypotheses import moments, normalised_weights
from estimator.slam.models.state_vector import THETA
from estimator.slam.models.virtual_anchors import implied_walls
from estimator.slam.protocol import LEAST_WEIGHT, MOST, Candidate, Estimate

__all__ = ["candidates", "estimate"]

Array = NDArray[np.float64]


def estimate(state: GaussianState, config: GaussianConfig) -> Estimate:
    """Moment-matched estimates (the MMSE estimates (34), (37) of the mixture).

    Parameters
    ----------
    state : GaussianState
        Hypotheses.
    config : GaussianConfig
        ``confirm_radius_m``: hypotheses that have a wall elsewhere do not blur it.
    """
    layout, hypotheses = state.layout, state.hypotheses
    weight = normalised_weights(hypotheses.log_weight)
    mean, covariance = moments(weight, hypotheses.mean, hypotheses.covariance)
    best = int(np.argmax(weight))

    agent = _turned(state, mean, covariance, (slice(0, 2), slice(2, 4)))

    def place(know: NDArray[np.bool_], xy: slice) -> tuple[Array, Array]:
        """A point in the hypotheses that know it."""
        if know.all():
            return _turned(state, mean, covariance, (xy,))
        share = weight[know] / weight[know].sum()
        return _turned(state, *moments(share, hypotheses.mean[know], hypotheses.covariance[know]), (xy,))

    def wall(slot: int) -> Wall:
        """A wall in the hypotheses that have it where the likeliest has it."""
        xy = layout.wall(slot)
        away = np.linalg.norm(hypotheses.mean[:, xy] - hypotheses.mean[best, xy], axis=1)
        near = away < config.lifecycle.confirm_radius_m
        standing = hypotheses.present[:, slot] & near
        existence = min(float(weight[standing].sum()), 1.0)
        return Wall(int(state.slots.wall_id[slot]), *place(standing, xy), existence)

    valid = hypotheses.located[best].copy()
    anchors, anchor_covariances = (
        np.full((layout.anchors, 2), np.nan),
        np.full((layout.anchors, 2, 2), np.nan),
    )
    anchor_existence = np.zeros(layout.anchors)
    for k in np.flatnonzero(valid):
        anchor_existence[k] = min(float(weight[hypotheses.located[:, k]].sum()), 1.0)
        xy = layout.anchor_xy(int(k))
        anchors[k], anchor_covariances[k] = place(hypotheses.located[:, k], xy)
    found = np.flatnonzero(state.slots.confirmed & hypotheses.present[best]).tolist()
    if state.shared:
        walls = [wall(slot) for slot in found]
    else:
        walls = virtual_walls(state, weight, config.virtual_births.same_wall_m)
    return Estimate(
        agent[0],
        agent[1],
        float(np.sqrt(covariance[THETA, THETA])),
        valid,
        anchors,
        anchor_covariances,
        np.array([wall.wall_id for wall in walls], dtype=np.int64),
        np.array([wall.mean_m for wall in walls]).reshape(-1, 2),
        np.array([wall.covariance_m2 for wall in walls]).reshape(-1, 2, 2),
        hypotheses.number,
        state.log_evidence,
        anchor_existence,
        np.array([wall.existence for wall in walls], dtype=np.float64),
        candidates(state),
        judged(state.indicators, agent[1][:2, :2], config.integrity),
        *_clocks_and_heights(state, weight, valid, config),
    )


def _clocks_and_heights(
    state: GaussianState, weight: Array, valid: NDArray[np.bool_], config: GaussianConfig
) -> tuple[Array | None, Array | None]:
    """Clock biases and heights of located anchors with standard deviations, where they are estimated."""
    clocks = config.clocks.clock_bias_std_m > 0.0 or config.clocks.clock_free_std_m > 0.0
    heights = config.noise.height2_std_m2 > 0.0
    if not clocks and not heights:
        return None, None
    layout, hypotheses = state.layout, state.hypotheses
    clock, height = np.full((2, layout.anchors, 2), np.nan)
    for k in np.flatnonzero(valid).tolist():
        know = np.flatnonzero(hypotheses.located[:, k])
        at = np.array([layout.height2(k), layout.bias(k)])
        share = weight[know] / weight[know].sum()
        covariances = hypotheses.covariance[np.ix_(know, at, at)]
        (height2, bias), spread = moments(share, hypotheses.mean[np.ix_(know, at)], covariances)
        std = np.sqrt(np.diag(spread))
        clock[k] = bias, std[1]
        height[k] = np.sqrt(max(height2, 0.0)), std[0] / (2.0 * np.sqrt(max(height2, std[0], 1e-12)))
    return clock if clocks else None, height if heights else None


def _turned(
    state: GaussianState, mean: Array, covariance: Array, parts: tuple[slice, ...]
) -> tuple[Array, Array]:
    """Vectors of the gauge frame, and theta's uncertainty, in the estimator's frame."""
    values, linear = rotate_by_angle_of(mean, THETA, parts, state.bearing_rad)
    return values, linear @ covariance @ linear.T


def candidates(
    state: GaussianState, most: int = MOST, least_weight: float = LEAST_WEIGHT
) -> tuple[Candidate, ...]:
    """The likeliest hypotheses of a state, the likeliest first, at most ``most``.

    The likeliest of all is always there; the others have ``least_weight`` or more.
    """
    hypotheses, layout = state.hypotheses, state.layout
    weight = normalised_weights(hypotheses.log_weight)
    order = np.argsort(-weight, kind="stable")[:most]
    found: list[Candidate] = []
    for r in order:
        if found and weight[r] < least_weight:
            break
        mean = hypotheses.mean[r]
        turn = rotation_matrix(state.bearing_rad + float(mean[THETA]))
        present = np.flatnonzero(hypotheses.present[r])
        vrps = implied_walls(mean[None], layout, state.slots.owner)[0, present]
        found.append(
            Candidate(float(weight[r]), turn @ mean[:2], state.slots.wall_id[present], vrps @ turn.T)
        )
    return tuple(found)
