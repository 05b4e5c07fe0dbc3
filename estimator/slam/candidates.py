"""The hypotheses behind an estimate, one by one: how likely, where the agent would be, which walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotation_matrix
from estimator.slam.births.virtual_anchors import implied_walls
from estimator.slam.gaussian.state import GaussianState

__all__ = ["LEAST_WEIGHT", "MOST", "Candidate", "candidates", "stacked_candidates"]

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


def stacked_candidates(told: Sequence[tuple[Candidate, ...]]) -> dict[str, NDArray[Any]]:
    """The candidates of all epochs as the arrays of a :class:`estimator.result.SlamResult`, by name."""
    epochs, most = len(told), max(map(len, told), default=0)
    ids = np.unique(np.concatenate([[], *(one.wall_id for found in told for one in found)])).astype(np.int64)
    weight, agent = np.full((epochs, most), np.nan), np.full((epochs, most, 2), np.nan)
    walls = np.full((epochs, most, ids.size, 2), np.nan)
    for t, found in enumerate(told):
        for c, one in enumerate(found):
            weight[t, c], agent[t, c] = one.weight, one.agent_m
            walls[t, c, np.searchsorted(ids, one.wall_id)] = one.wall_mean_m
    return {
        "candidate_weight": weight,
        "candidate_agent_m": agent,
        "candidate_wall_id": ids,
        "candidate_wall_mean_m": walls,
    }
