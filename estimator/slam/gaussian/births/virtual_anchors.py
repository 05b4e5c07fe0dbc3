"""Virtual anchors enter the hypotheses, each place as one of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.gaussian.births.virtual_search import Modes, Recent, search
from estimator.slam.gaussian.clutter import clutter_density
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["bear_virtual_anchors", "recent_paths", "shorter_than_sight"]

Array = NDArray[np.float64]


@compiled
def shorter_than_sight(
    layout: Layout,
    mean: Array,
    explained: Array,
    paths: EpochPaths,
    clutter_density: float,
    clutter: Array,
    gate_sigma: float,
    range_std_m: float,
) -> Array:
    """Log weight (R,) that hypotheses lose by unexplained paths shorter than their line of sight.

    A feature not yet found is farther away than its anchor: among the shorter paths there is
    only clutter, and less of it than of unassociated paths in all, (K,) per metre. A hypothesis that takes
    the path of a virtual anchor for the line of sight leaves the true one, which is shorter, unexplained
    in every epoch.
    """
    loss = np.zeros(mean.shape[0])
    for r in range(mean.shape[0]):
        for k in range(layout.anchors):
            a = FIRST_ANCHOR + PER_ANCHOR * k
            dx, dy = mean[r, a] - mean[r, 0], mean[r, a + 1] - mean[r, 1]
            flat = np.sqrt(max(dx * dx + dy * dy + mean[r, a + 2], 0.0))
            sight = (1.0 + mean[r, a + 4]) * flat + mean[r, a + 3]
            rarer = np.log(min(clutter_density / clutter[k], 1.0))
            for j in range(paths.number[k]):
                margin = gate_sigma * max(paths.std_m[k, j], range_std_m)
                if paths.length_m[k, j] + margin < sight:
                    loss[r] += (1.0 - explained[r, k, j]) * rarer
    return loss


def recent_paths(state: GaussianState, k: int, config: GaussianConfig) -> Recent | None:
    """What the buffer holds of anchor ``k``, as far back as virtual anchors need; None if too little."""
    model, noise = config.virtual_births, config.noise
    buffer, track = state.buffer, state.buffer.track
    gone = np.linalg.norm(track.position_m - track.position_m[-1], axis=1)
    far = np.flatnonzero(gone > model.travel_sigma * noise.range_std_m)
    begin = min(int(far[-1]) + 1 if far.size else 0, max(buffer.epochs - model.least_epochs, 0))
    rows = np.flatnonzero(buffer.unassociated & (buffer.anchor == k) & (buffer.epoch >= track.epoch[begin]))[
        -model.most_recent_paths :
    ]
    if len(rows) < config.lifecycle.confirm_support:
        return None
    device = state.hypotheses.mean[state.hypotheses.best, state.layout.anchor(k)]
    scale = 1.0 + state.hypotheses.mean[state.hypotheses.best, state.layout.scale(k)]
    flat = np.sqrt(np.maximum(((buffer.length_m[rows] - device[3]) / scale) ** 2 - device[2], 1e-4))
    variance = max(noise.range_std_m, float(np.median(buffer.std_m[rows]))) ** 2
    spread = track.std_m[begin:] ** 2
    density = clutter_density(buffer, state.layout.anchors, state.blind, noise, config.clutter)
    return Recent(
        rows,
        flat,
        buffer.row_of(buffer.epoch[rows]) - begin,
        np.ascontiguousarray(track.position_m[begin:]),
        variance + spread,
        variance + model.virtual_alike_epochs * spread,
        float(density[k]),
    )


def bear_virtual_anchors(state: GaussianState, config: GaussianConfig, most: int) -> GaussianState:
    """Give all hypotheses the virtual anchors that recent paths show; every few epochs, anchor by anchor.

    Parameters
    ----------
    state : GaussianState
        A state of virtual anchors, its buffer with the present epoch.
    config : GaussianConfig
        Models.
    most : int
        Hypotheses that there may be.
    """
    model = config.virtual_births
    for k in range(state.layout.anchors):
        if (state.epoch + k) % model.virtual_stride:
            continue
        for _ in range(model.most_modes):
            recent = recent_paths(state, k, config)
            if recent is None:
                break
            modes = search(recent, config.noise.detection_probability, config.births.birth_trust, model)
            if modes is None or state.hypotheses.number * len(modes.mean) > most:
                break
            state = _enter(state, k, recent, modes, config)
    return state


def _enter(
    state: GaussianState, k: int, recent: Recent, modes: Modes, config: GaussianConfig
) -> GaussianState:
    """Each hypothesis once for each mode; the paths that it explains start nothing any more."""
    state, slot = open_slot(state, config.visibility)
    before, columns = state.hypotheses, state.layout.wall(slot)
    centre = before.mean[before.best, :2]
    parent, mode = np.divmod(np.arange(before.number * len(modes.mean)), len(modes.mean))
    new = before.take(parent)
    new.mean[:, columns] = np.concatenate([modes.mean[mode], np.tile(centre, (len(mode), 1))], axis=1)
    free = slice(columns.start, columns.start + 2)
    new.covariance[:, free, free] = modes.covariance[mode]
    new.present[:, slot] = True
    new.log_weight[...] += modes.log_weight[mode]
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot], slots.owner[slot] = state.next_wall_id, state.epoch, k
    return state.but(
        hypotheses=new,
        slots=slots,
        next_wall_id=state.next_wall_id + 1,
        buffer=state.buffer.with_associated(recent.row[modes.explained]),
    )
