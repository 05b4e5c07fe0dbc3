"""The anchor search as the Gaussian engine's state calls it."""

from __future__ import annotations

import numpy as np

from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.initialise import SearchInput
from estimator.slam.anchors.initialise import locate_anchors as locate
from estimator.slam.anchors.observations import RecentPaths, RecentTrack
from estimator.slam.anchors.schedule import is_due
from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.hypotheses import tidy
from estimator.slam.gaussian.levels import known_gains
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.gaussian.slots import fresh_visibility
from estimator.slam.gaussian.state import GaussianState

__all__ = ["locate_anchors", "may_locate"]


def may_locate(state: GaussianState) -> bool:
    """Whether :func:`locate_anchors` has anything to look at in this epoch."""
    return is_due(state.epoch, len(state.trail), bool(state.rows.located.all()), AnchorSearchConfig())


def locate_anchors(state: GaussianState, paths: PathTable, config: GaussianConfig) -> GaussianState:
    """The state after :func:`estimator.slam.anchors.initialise.locate_anchors`."""
    search = AnchorSearchConfig(
        start_window=config.start_window,
        start_matches=config.start_matches,
        start_attempts=config.start_attempts,
        restart_distance_m=config.restart_distance_m,
        search_gate_sigma=config.gate_sigma,
    )
    epoch, anchor, length, std, loss, unassociated = state.heard.T
    given = SearchInput(
        layout=state.layout,
        confirmed=state.slots.confirmed,
        epoch=state.epoch,
        paths=paths,
        track=RecentTrack(state.trail[:, 0].astype(np.int64), state.trail[:, 1:3], state.trail[:, 3]),
        heard=RecentPaths(
            epoch.astype(np.int64), anchor.astype(np.int64), length, std, loss, unassociated == 1.0
        ),
        gain_offset_db=known_gains(state),
        noise=config,
        fresh_visibility=fresh_visibility(state.layout),
        prune_nats=config.prune_nats,
        reduce=lambda hypotheses: tidy(hypotheses, config),
    )
    rows = locate(state.rows, given, search)
    return state if rows is state.rows else state.but(rows=rows)
