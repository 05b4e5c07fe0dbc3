"""How strong an anchor's paths are: in line of sight, and after one bounce at normal incidence.

Powers tell single bounces from double ones, if only relative to each other. The line of sight, which loses
nothing beyond free space, shows the gain that an anchor really has, where its EIRP is unknown. The walls
seen by the first sweep, which are walls for certain, show what a bounce costs in this building: at
normal incidence most of all (waves polarised along the wall, Fresnel's formula for a half-space). A path that
lost clearly more than that bounced more than once, or off something unlike any known wall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import reflect, wall_side
from estimator.slam.gaussian.state import GaussianState

__all__ = ["first_levels", "known_gains", "learn_levels", "loss_limits", "normal_loss_db"]

Array = NDArray[np.float64]
_EVERY = 4  # epochs between looks
_FLOOR_DB = 0.5  # walls differ by this much
_DRIFT_DB = 0.2  # and from one look to the next
_ALIKE = 4  # paths in a row fade alike
_KNOWN_DB = 3.0  # standard deviation of a gain that counts as known
_LEAST_COSINE = 0.5  # of the incidence: at a slant the loss hardly tells the material


def normal_loss_db(loss_db: Array, cosine: Array) -> Array:
    """The loss at normal incidence of a half-space that reflects with ``loss_db`` at another incidence.

    Fresnel's formula for an electric field along the surface, ``r = (c - s) / (c + s)`` with
    ``s = sqrt(epsilon - 1 + c^2)`` and the cosine ``c`` of the incidence, solved for the permittivity.

    Parameters
    ----------
    loss_db, cosine : ndarray
        Of equal shapes; losses below 0.1 dB count as that.
    """
    r = 10.0 ** (-np.maximum(loss_db, 0.1) / 20.0)
    s = cosine * (1.0 + r) / (1.0 - r)
    index = np.sqrt(s**2 + 1.0 - cosine**2)
    return np.asarray(-20.0 * np.log10((index - 1.0) / (index + 1.0)))


def first_levels(anchors: int, config: GaussianConfig) -> Array:
    """What is believed before the first path: levels (K, 2, 2) as in :class:`GaussianState`."""
    own = (0.0, config.gain_offset_std_db**2), (config.bounce_loss_db, config.bounce_loss_std_db**2)
    return np.tile(np.array(own), (anchors, 1, 1))


def learn_levels(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Take the powers of the latest epochs' paths in, every few epochs.

    Parameters
    ----------
    state : GaussianState
        State that remembers them.
    config : GaussianConfig
        ``range_std_m``.
    """
    if state.epoch % _EVERY or not np.isfinite(state.heard[:, 4]).any():
        return state
    best, layout = state.rows.best, state.layout
    mean, trail = state.rows.mean[best], state.trail[state.trail[:, 0] > state.epoch - _EVERY]
    recent = state.heard[np.isin(state.heard[:, 0], trail[:, 0]) & np.isfinite(state.heard[:, 4])]
    sensed = np.flatnonzero((state.slots.wall_id >= 0) & (state.slots.born < 0))
    walls = mean[layout.walls].reshape(-1, 2)[sensed]
    levels = state.levels_db.copy()
    for k in np.flatnonzero(state.rows.located[best]).tolist():
        heard = recent[recent[:, 1] == k]
        agent = trail[np.searchsorted(trail[:, 0], heard[:, 0]), 1:3]
        x, y, height2, bias = mean[layout.anchor(k)]
        anchor = np.array([x, y])
        source = np.concatenate([anchor[None], reflect(anchor, walls)])
        offset = agent[:, None] - source
        flat = np.linalg.norm(offset, axis=-1)  # (N, 1 + L)
        gap = np.abs(heard[:, 2, None] - np.sqrt(np.maximum(flat**2 + height2, 1e-6)) - bias)
        near = gap < 3.0 * np.maximum(heard[:, 3], config.range_std_m)[:, None]
        levels[k, 0] = _updated(levels[k, 0], heard[near[:, 0], 4], 0.0)
        if not levels[k, 0, 1] < _KNOWN_DB**2:
            continue
        along = np.abs(np.sum(offset[:, 1:] * walls, axis=-1)) / np.linalg.norm(walls, axis=-1)
        cosine = along / np.maximum(flat[:, 1:], 1e-6)
        facing = wall_side(agent[:, None], walls) * wall_side(anchor, walls) > 0.0
        path, wall = np.nonzero(near[:, 1:] & facing & (cosine > _LEAST_COSINE))
        loss = heard[path, 4] - levels[k, 0, 0]
        levels[k, 1] = _updated(levels[k, 1], normal_loss_db(loss, cosine[path, wall]), _FLOOR_DB)
    return state.but(levels_db=levels)


def _updated(level: Array, samples: Array, floor: float) -> Array:
    """A level's mean and variance (2,) after some samples, of which the median counts."""
    if samples.size == 0 or level[1] == 0.0:
        return level
    low, middle, high = np.percentile(samples, [25.0, 50.0, 75.0])
    spread = max((high - low) / 1.35, _FLOOR_DB)
    noise = floor**2 + 1.6 * spread**2 * _ALIKE / samples.size
    before = level[1] + _DRIFT_DB**2
    share = before / (before + noise)
    return np.array([level[0] + share * (middle - level[0]), (1.0 - share) * before])


def known_gains(state: GaussianState) -> Array:
    """Losses in line of sight (K,), dB, to be taken off all losses of each anchor; NaN if unknown."""
    mean, variance = state.levels_db[:, 0].T
    return np.where(variance < _KNOWN_DB**2, mean, np.nan)


def loss_limits(state: GaussianState, config: GaussianConfig) -> Array:
    """Losses beyond free space (K,), dB, from which a path of each anchor bounced more than once.

    Infinite where the anchor's gain is not known.
    """
    limit = known_gains(state) + state.levels_db[:, 1, 0] + config.birth_margin_db
    return np.where(np.isnan(limit), np.inf, limit)
