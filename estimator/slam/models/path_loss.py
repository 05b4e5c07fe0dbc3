"""Path loss: how strong an anchor's paths are, in line of sight and after one bounce at normal incidence.

Powers tell single bounces from double ones, if only relative to each other. The line of sight, which loses
nothing beyond free space, shows the gain that an anchor really has, where its EIRP is unknown. The walls
seen by the first sweep, which are walls for certain, show what a bounce costs in this building: at
normal incidence most of all (waves polarised along the wall, Fresnel's formula for a half-space). A path that
lost clearly more than that bounced more than once, or off something unlike any known wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import mirror
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.models.settings import Settings, not_negative, positive, probability
from estimator.slam.models.state_vector import Layout

__all__ = ["PathLoss", "first_losses", "known_gain_offsets", "learn_losses", "loss_limits", "normal_loss_db"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PathLoss(Settings):
    """What is believed of losses, and how it is learnt.

    Parameters
    ----------
    bounce_loss_db, bounce_loss_std_db : float
        Prior of the loss in a bounce at normal incidence: building materials have 5 to 13 dB. The walls seen
        by the first sweep soon tell it better.
    birth_margin_db : float
        A path may start a wall only if it lost at most this more than a bounce at normal incidence, where
        a wall reflects least. Double bounces lose more: in a right corner of concrete, glass or plasterboard
        at least 1.3 dB more, but for the last metres before one of the walls is grazed.
    loss_stride : int
        Epochs between looks at the powers.
    floor_db : float
        Walls differ by this much,
    drift_db : float
        and from one look to the next.
    fading_paths : float
        Paths in a row that fade alike.
    known_gain_db : float
        Standard deviation of a gain offset that counts as known.
    least_cosine : float
        Of the incidence: at a slant the loss hardly tells the material.
    near_sigma : float
        A path tells the loss of a feature that it is within so many standard deviations of.
    """

    bounce_loss_db: float = positive(9.0)
    bounce_loss_std_db: float = positive(3.0)
    birth_margin_db: float = positive(1.5)
    loss_stride: int = positive(4)
    floor_db: float = positive(0.5)
    drift_db: float = not_negative(0.2)
    fading_paths: float = positive(4.0)
    known_gain_db: float = positive(3.0)
    least_cosine: float = probability(0.5)
    near_sigma: float = positive(3.0)


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


def first_losses(anchors: int, gain_offset_std_db: float, model: PathLoss) -> Array:
    """What is believed before the first path: losses (K, 2, 2).

    Of each anchor, mean and variance of its loss beyond free space in line of sight (not zero where its
    gain is not known), and beyond that in a bounce at normal incidence, dB.
    """
    own = (0.0, gain_offset_std_db**2), (model.bounce_loss_db, model.bounce_loss_std_db**2)
    return np.tile(np.array(own), (anchors, 1, 1))


def learn_losses(
    losses_db: Array,
    hypotheses: Hypotheses,
    layout: Layout,
    sensed: NDArray[np.int64],
    buffer: PathBuffer,
    range_std_m: float,
    model: PathLoss,
) -> Array:
    """Losses (K, 2, 2) after the powers of the latest epochs' paths.

    Parameters
    ----------
    losses_db : ndarray, shape (K, 2, 2)
        Losses before.
    hypotheses, layout
        The state; the likeliest hypothesis is believed.
    sensed : ndarray of int64
        Slots of the walls that the first sweep saw.
    buffer : PathBuffer
        Recent paths.
    range_std_m : float
        Smallest standard deviation of a path length, metres.
    model : PathLoss
        How to learn.
    """
    track = buffer.track
    latest = track.epoch > track.epoch[-1] - model.loss_stride
    use = np.isfinite(buffer.excess_loss_db) & np.isin(buffer.epoch, track.epoch[latest])
    if not use.any():
        return losses_db
    best = hypotheses.best
    mean = hypotheses.mean[best]
    walls = mean[layout.walls].reshape(-1, 2)[sensed]
    size = np.linalg.norm(walls, axis=-1)
    losses = losses_db.copy()
    for k in np.flatnonzero(hypotheses.located[best]).tolist():
        own = np.flatnonzero(use & (buffer.anchor == k))
        agent = track.position_m[buffer.row_of(buffer.epoch[own])]
        x, y, height2, bias = mean[layout.anchor(k)]
        anchor = np.array([x, y])
        source = np.concatenate([anchor[None], mirror(anchor, walls)])
        offset = agent[:, None] - source
        flat = np.linalg.norm(offset, axis=-1)  # (N, 1 + L)
        slanted = np.sqrt(np.maximum(flat**2 + height2, 1e-6))
        std = np.maximum(buffer.std_m[own], range_std_m)
        near = np.abs(buffer.length_m[own, None] - slanted - bias) < model.near_sigma * std[:, None]
        losses[k, 0] = _updated(losses[k, 0], buffer.excess_loss_db[own[near[:, 0]]], 0.0, model)
        if not losses[k, 0, 1] < model.known_gain_db**2:
            continue
        along = np.abs(np.sum(offset[:, 1:] * walls, axis=-1)) / size
        cosine = along / np.maximum(flat[:, 1:], 1e-6)
        side, other = agent @ walls.T / size - 0.5 * size, anchor @ walls.T / size - 0.5 * size
        path, wall = np.nonzero(near[:, 1:] & (side * other > 0.0) & (cosine > model.least_cosine))
        loss = buffer.excess_loss_db[own[path]] - losses[k, 0, 0]
        samples = normal_loss_db(loss, cosine[path, wall])
        losses[k, 1] = _updated(losses[k, 1], samples, model.floor_db, model)
    return losses


def _updated(loss: Array, samples: Array, floor_db: float, model: PathLoss) -> Array:
    """A loss's mean and variance (2,) after some samples, of which the median counts."""
    if samples.size == 0 or loss[1] == 0.0:
        return loss
    low, middle, high = np.percentile(samples, [25.0, 50.0, 75.0])
    spread = max((high - low) / 1.35, model.floor_db)  # quartiles of a normal law are 1.35 deviations apart
    noise = floor_db**2 + 0.5 * np.pi * spread**2 * model.fading_paths / samples.size  # variance of a median
    before = loss[1] + model.drift_db**2
    share = before / (before + noise)
    return np.array([loss[0] + share * (middle - loss[0]), (1.0 - share) * before])


def known_gain_offsets(losses_db: Array, model: PathLoss) -> Array:
    """Losses in line of sight (K,), dB, to be taken off all losses of each anchor; NaN if unknown."""
    mean, variance = losses_db[:, 0].T
    return np.where(variance < model.known_gain_db**2, mean, np.nan)


def loss_limits(losses_db: Array, model: PathLoss) -> Array:
    """Losses beyond free space (K,), dB, from which a path of each anchor bounced more than once.

    Infinite where the anchor's gain is not known.
    """
    limit = known_gain_offsets(losses_db, model) + losses_db[:, 1, 0] + model.birth_margin_db
    return np.where(np.isnan(limit), np.inf, limit)
