"""The recent epochs, seen with what is known now.

A path was noted as unexplained by the map of its day. Once an anchor is located, or turns out to be
elsewhere, old paths find their explanation, and must not start a wall; so do those over three known
walls, which only this asks for. And the paths that *are* explained tell where nothing stands in the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import predict_paths, wall_side
from estimator.slam.gaussian.multiples import multiple_lengths
from estimator.slam.gaussian.state import GaussianState

__all__ = ["Hindsight", "look_back"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hindsight:
    """What the likeliest row says about recent epochs.

    Parameters
    ----------
    state : GaussianState
        The state, with the paths marked that are explained now.
    legs : ndarray, shape (S, 2, 2)
        Straight pieces of the paths heard, from the agent to the anchor or over one wall: end points,
        gauge frame, metres.
    """

    state: GaussianState
    legs: Array


def look_back(state: GaussianState, config: GaussianConfig) -> Hindsight:
    """Compare the remembered paths with what the likeliest row predicts along its track.

    Parameters
    ----------
    state : GaussianState
        State with at least one remembered epoch.
    config : GaussianConfig
        ``pair_radius_m`` and ``range_std_m``.

    Returns
    -------
    Hindsight
    """
    best, layout, trail = state.rows.best, state.layout, state.trail
    mean = np.repeat(state.rows.mean[best][None], len(trail), axis=0)
    mean[:, :2] = trail[:, 1:3]
    prediction = predict_paths(mean, layout)
    active = state.active()[best] & prediction.possible  # (W, K, F)
    known = np.isin(state.heard[:, 0], trail[:, 0])
    at = np.searchsorted(trail[:, 0], state.heard[known, 0])
    anchor = state.heard[known, 1].astype(np.int64)
    gap = np.abs(state.heard[known, 2, None] - prediction.length_m[at, anchor])  # (N, F)
    gap = np.where(active[at, anchor], gap, np.inf)
    radius = config.pair_radius_m + 2.0 * trail[at, 3]
    near = np.any(gap < radius[:, None], axis=1)
    heard = state.heard.copy()
    found = np.flatnonzero(state.slots.confirmed & state.rows.present[best])
    for k in np.flatnonzero(state.rows.located[best]).tolist():
        walls = mean[0, layout.walls].reshape(-1, 2)[found]
        multiple = multiple_lengths(trail[:, 1:3], mean[0, layout.anchor(k)], walls)
        own = anchor == k
        gap_k = np.abs(heard[known, 2, None][own] - multiple[at[own]])
        near[own] |= np.any(gap_k < radius[own, None], axis=1)
    heard[known, 5] = np.where(near, 0.0, heard[known, 5])

    first = gap[:, : 1 + layout.slots]  # line of sight and single bounces
    width = 3.0 * np.maximum(state.heard[known, 3], config.range_std_m)
    path, feature = np.nonzero(first < width[:, None])
    agent = mean[at[path], :2]
    room = prediction.room
    source = room.sources()[at[path], anchor[path], feature]
    direct = feature == 0
    wall = mean[0, layout.walls].reshape(-1, 2)[np.maximum(feature - 1, 0)] if layout.slots else source
    side, other = wall_side(agent, wall), wall_side(source, wall)
    fraction = np.where(direct, 1.0, side / np.where(side == other, np.inf, side - other))
    bounce = agent + fraction[:, None] * (source - agent)
    place = room.anchor[0]  # (K, 2)
    legs = np.concatenate(
        [
            np.stack([agent, bounce], axis=1),
            np.stack([bounce, place[anchor[path]]], axis=1)[~direct],
        ]
    )
    return Hindsight(state.but(heard=heard), legs)
