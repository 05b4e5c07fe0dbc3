"""The hypotheses behind an estimate, one by one: how likely, where the agent would be, which walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotation_matrix
from estimator.slam.state import GaussianState
from estimator.slam.virtual_anchors import implied_walls

__all__ = ["LEAST_WEIGHT", "MOST", "Candidate", "candidates"]

MOST = 8  # candidates told of an estimate
LEAST_WEIGHT = 1e-3  # of a candidate worth telling


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way that things may be.

    Parameters
    ----------
    weight : float
        Its probability.
    agent_m : ndarray, shape (2,)
        The agent, metres, estimator's frame.
    wall_id : ndarray of int64, shape (J,)
        The walls that it has, those not found yet included.
    wall_mean_m : ndarray, shape (J, 2)
        Their VRPs.
    """

    weight: float
    agent_m: NDArray[np.float64]
    wall_id: NDArray[np.int64]
    wall_mean_m: NDArray[np.float64]


def candidates(
    state: GaussianState, most: int = MOST, least_weight: float = LEAST_WEIGHT
) -> tuple[Candidate, ...]:
    """The likeliest hypotheses of a state, the likeliest first, at most ``most``.

    The likeliest of all is always there; the others have ``least_weight`` or more.
    """
    rows, layout = state.rows, state.layout
    weight = np.exp(rows.log_weight - rows.log_weight.max())
    weight /= weight.sum()
    order = np.argsort(-weight, kind="stable")[:most]
    found: list[Candidate] = []
    for r in order:
        if found and weight[r] < least_weight:
            break
        mean = rows.mean[r]
        turn = rotation_matrix(state.bearing_rad + float(mean[layout.THETA]))
        present = np.flatnonzero(rows.present[r])
        vrps = implied_walls(mean[None], layout, state.slots.owner)[0, present]
        found.append(
            Candidate(float(weight[r]), turn @ mean[:2], state.slots.wall_id[present], vrps @ turn.T)
        )
    return tuple(found)
