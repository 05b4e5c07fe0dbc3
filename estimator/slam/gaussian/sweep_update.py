"""Beam sweeps on the way: flashes are matched to walls, correct the hypotheses, and show new walls.

A wall seen for the first time enters all hypotheses and waits for its confirmation as every new wall does.
Time is that of the hypotheses times flashes times walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam.association.sweep_matching import MatchModel, heading_of, match_flashes
from estimator.slam.gaussian.polar_correction import correct_along_circles
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.extents import bounce_along_wall
from estimator.slam.models.features import mirror
from estimator.slam.models.hypotheses import Hypotheses, log_sum_exp
from estimator.slam.models.settings import Settings, not_negative, positive, probability
from estimator.slam.models.state_vector import ECHO_BIAS, THETA, Layout
from estimator.slam.models.sweeps import own_covariance
from estimator.slam.models.visibility import Visibility

__all__ = ["SweepMatching", "take_sweep"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_ANY_HEADING_RAD2 = (2.0 * np.pi) ** 2 / 12.0  # variance of an angle of which nothing is known
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class SweepMatching(Settings):
    """How flashes and walls are matched.

    Parameters
    ----------
    flash_gate_sigma : float
        A flash farther from every wall than this many standard deviations is none of theirs.
    new_flash_density : float
        Density of flashes of walls not yet known, per metre of range and radian of bearing: half a flash a
        sweep, anywhere within 20 m.
    heading_scale_m : float
        Distances between flashes and walls that a common heading explains, beside their noise, metres.
    echo_bias_std_m : float
        Of what the covariances of flashes say of range, the part that all sweeps have in common: a standard
        deviation, metres. It becomes a state.
    square_share, square_std_rad : float
        Share of new walls that stand parallel or square to a known one, and how exactly, radians.
    ghost_flashes : float
        Flashes of a sweep that are double bounces over two known walls, on average,
    ghost_std_m, ghost_azimuth_rad : float
        and how far off the range of the image and the directions of arrival and departure they are, metres
        and radians.
    rival_nats : float
        A match no more than this likelier than another one, or than a new wall, gets that one as its rival.
    least_new_weight : float
        Weight of the hypotheses that must ask for a new wall; it enters those alone.
    residual_flashes, residual_memory : float
        The variances claimed of flashes are scaled to their residuals, in range and in direction: the claim
        counts as so many flashes, and the last so many tell.
    often_epochs : int
        Sweeps no more epochs apart than this tell how the agent moves.
    mislabelled_probability : float
        Probability that the paths of an epoch without a sweep are all taken for the wrong features, where
        sweeps come now and then.
    least_echo_scale, most_echo_scale : float
        Within these limits.
    """

    flash_gate_sigma: float = positive(4.0)
    new_flash_density: float = positive(0.5 / (20.0 * 2.0 * np.pi))
    heading_scale_m: float = positive(0.5)
    echo_bias_std_m: float = not_negative(0.0)
    square_share: float = probability(0.8)
    square_std_rad: float = positive(0.01)
    ghost_flashes: float = positive(0.3)
    ghost_std_m: float = positive(0.05)
    ghost_azimuth_rad: float = positive(0.2)
    rival_nats: float = not_negative(8.0)
    least_new_weight: float = probability(0.01)
    residual_flashes: float = positive(20.0)
    residual_memory: float = positive(200.0)
    often_epochs: int = positive(4)
    mislabelled_probability: float = probability(0.1)
    least_echo_scale: float = positive(0.25)
    most_echo_scale: float = positive(9.0)

    def compiled(self, most_turn_rad: float) -> MatchModel:
        """What compiled functions take."""
        return MatchModel(
            self.flash_gate_sigma,
            self.new_flash_density,
            self.square_share,
            self.square_std_rad,
            self.heading_scale_m,
            self.ghost_flashes,
            self.ghost_std_m,
            self.ghost_azimuth_rad,
            self.rival_nats,
            most_turn_rad,
        )


@compiled
def _update(
    layout: Layout,
    hypotheses: Hypotheses,
    before: int,
    seen: Array,
    noise: Array,
    held: bool,
    model: MatchModel,
) -> tuple[int, Index, Index, Array]:
    """Correct the first ``before`` hypotheses in place; the others are room for rivals of doubtful matches.

    How many there are then, which one (R,) each was, the walls (R, J) of its flashes, residuals (R, 2, 2).
    """
    flashes, n = seen.shape[0], hypotheses.mean.shape[1]
    label, residual = np.empty((2 * before, flashes), dtype=np.int64), np.empty((2 * before, 2, 2))
    back, spread = np.empty(seen.shape), np.empty(noise.shape)
    slot = np.empty(flashes, dtype=np.int64)
    count, parent = before, np.arange(2 * before)
    forced = np.empty(2, dtype=np.int64)
    for r in range(before):
        mean, covariance = hypotheses.mean[r].copy(), hypotheses.covariance[r].copy()
        turn = 0.0
        if not held:
            turn = heading_of(layout, mean, hypotheses.present[r], seen, noise, model.heading_scale_m)
        c, s = np.cos(turn), np.sin(turn)
        for j in range(flashes):
            back[j, 0] = c * seen[j, 0] + s * seen[j, 1]
            back[j, 1] = c * seen[j, 1] - s * seen[j, 0]
            xx, xy, yy = noise[j, 0, 0], noise[j, 0, 1], noise[j, 1, 1]
            spread[j, 0, 0] = c * c * xx + 2.0 * c * s * xy + s * s * yy
            spread[j, 1, 1] = s * s * xx - 2.0 * c * s * xy + c * c * yy
            spread[j, 0, 1] = c * s * (yy - xx) + (c * c - s * s) * xy
            spread[j, 1, 0] = spread[j, 0, 1]
        heading_variance = 0.0 if held else _ANY_HEADING_RAD2
        forced[:] = -1
        support, weight = hypotheses.support[r].copy(), hypotheses.log_weight[r]
        for attempt in range(2):
            at = r if attempt == 0 else count
            wide_mean, wide = np.zeros(n + 1), np.zeros((n + 1, n + 1))
            wide_mean[:n] = mean
            wide[:n, :n] = covariance
            wide[n, n] = heading_variance
            density, margin, flash, wall = match_flashes(
                layout,
                wide_mean,
                wide,
                hypotheses.present[r],
                back,
                spread,
                heading_variance,
                model,
                forced,
                slot,
                residual[at],
            )
            if attempt:
                parent[at] = r
                hypotheses.located[at], hypotheses.present[at] = hypotheses.located[r], hypotheses.present[r]
                hypotheses.visibility[at], hypotheses.support[at] = hypotheses.visibility[r], support
                count += 1
            hypotheses.log_weight[at] = weight + density
            hypotheses.mean[at], hypotheses.covariance[at] = wide_mean[:n], wide[:n, :n]
            for j in range(flashes):
                label[at, j] = slot[j]
                if slot[j] >= 0:
                    hypotheses.support[at, slot[j]] += 1
            if model.most_turn_rad > 0.0:
                correct_along_circles(
                    layout,
                    mean,
                    hypotheses.mean[at],
                    hypotheses.covariance[at],
                    hypotheses.located[at],
                    model.most_turn_rad,
                )
            if not margin < model.rival_nats:
                break
            forced[0], forced[1] = flash, wall
    return count, parent, label, residual


def take_sweep(
    state: GaussianState,
    sweep: Sequence[GaussianVrp],
    heading_held: bool,
    model: SweepMatching,
    most_turn_rad: float,
    visibility: Visibility,
) -> tuple[GaussianState, Index]:
    """Take the flashes of a sweep into all hypotheses.

    Parameters
    ----------
    state : GaussianState
        State with predicted hypotheses.
    sweep : sequence of GaussianVrp
        The agent's mirror images relative to the agent, in its axes.
    heading_held : bool
        Whether these axes are those of the start.
    model : SweepMatching
        Gates.
    most_turn_rad : float
        As in :class:`estimator.slam.gaussian.update.UpdateModel`.
    visibility : Visibility
        Prior visibility of new walls.

    Returns
    -------
    state : GaussianState
        With the hypotheses corrected, and rivals of doubtful matches after them.
    parent : ndarray of int64, shape (R,)
        Which hypothesis each one was.
    """
    if not sweep:
        return state, np.arange(state.hypotheses.number)
    to_gauge = rotation_matrix(-state.bearing_rad)
    seen = np.array([wall.mean_m for wall in sweep]) @ to_gauge.T
    noise = np.array([to_gauge @ own_covariance(wall, model.echo_bias_std_m) @ to_gauge.T for wall in sweep])
    scale = state.echo_residuals[:, 0] / state.echo_residuals[:, 1]
    scale = np.clip(scale, model.least_echo_scale, model.most_echo_scale)
    noise = _scaled(noise, seen, scale)
    room = state.hypotheses.take(np.tile(np.arange(state.hypotheses.number), 2))
    count, parent, label, residual = _update(
        state.layout, room, state.hypotheses.number, seen, noise, heading_held, model.compiled(most_turn_rad)
    )
    corrected, label = room.take(np.arange(count)), label[:count]
    evidence = log_sum_exp(corrected.log_weight)
    corrected.log_weight[...] -= evidence
    often = state.swept_within(model.often_epochs)
    told = residual[corrected.best] * np.stack([scale, np.ones(2)], axis=1)
    kept = np.maximum(1.0 - told[:, 1:] / model.residual_memory, 0.0)
    state = state.but(
        hypotheses=corrected,
        log_evidence=state.log_evidence + evidence,
        swept_epoch=state.epoch,
        tracked_epoch=state.epoch if often else state.tracked_epoch,
        echo_residuals=kept * state.echo_residuals + told,
    )
    shown = label[corrected.best]
    slots = state.slots.copy()
    slots.swept[shown[shown >= 0]] += 1
    likeliest = corrected.mean[corrected.best]
    for slot in shown[shown >= 0].tolist():
        slots.flash_m[slot, 1, 0] = likeliest[:2]
        slots.flash_m[slot, 1, 1] = mirror(*likeliest[:2], *likeliest[state.layout.wall(slot)])
        foot = bounce_along_wall(*likeliest[:2], *likeliest[:2], *likeliest[state.layout.wall(slot)])
        slots.extent_m[slot] = min(slots.extent_m[slot, 0], foot), max(slots.extent_m[slot, 1], foot)
    state = state.but(slots=slots)
    if heading_held:
        weight = np.exp(corrected.log_weight)
        for j in range(len(seen)):
            if weight[label[:, j] == -1].sum() > model.least_new_weight:
                state = _enter(state, np.flatnonzero(label[:, j] == -1), seen[j], noise[j], visibility)
    return state, parent[:count]


def _scaled(noise: Array, seen: Array, scale: Array) -> Array:
    """Covariances (J, 2, 2) of flashes, variances in range and in direction ``scale`` (2,) times as large."""
    away = seen / np.linalg.norm(seen, axis=1)[:, None]
    axes = np.stack([away, away @ _QUARTER.T], axis=2)
    stretch = (axes * np.sqrt(scale)) @ axes.transpose(0, 2, 1)
    return np.asarray(stretch @ noise @ stretch)


def _enter(
    state: GaussianState, members: Index, seen: Array, noise: Array, visibility: Visibility
) -> GaussianState:
    """Give some hypotheses the wall whose flash no wall of theirs explains."""
    state, slot = open_slot(state, visibility)
    layout, columns = state.layout, state.layout.wall(slot)
    new = state.hypotheses.take(np.arange(state.hypotheses.number))
    for r in members.tolist():
        mean, covariance = new.mean[r], new.covariance[r]
        turn = rotation_matrix(-float(mean[THETA]))
        gauge, agent = turn @ seen, mean[:2]
        along = gauge / np.linalg.norm(gauge)
        gauge = gauge - 2.0 * float(mean[ECHO_BIAS]) * along
        # v = (1 + 2 p.m / |m|^2) m stands where p's image relative to p is m
        square = gauge @ gauge
        scale = 1.0 + 2.0 * (agent @ gauge) / square
        by_agent = 2.0 / square * np.outer(gauge, gauge)
        by_flash = scale * np.eye(2) + 2.0 / square * np.outer(
            gauge, agent - 2.0 * (agent @ gauge) / square * gauge
        )
        linear = np.zeros((2, layout.size))
        linear[:, :2] = by_agent
        linear[:, THETA] = by_flash @ (-_QUARTER @ gauge)
        linear[:, ECHO_BIAS] = -2.0 * by_flash @ along
        spread = by_flash @ turn @ noise @ turn.T @ by_flash.T
        mean[columns] = scale * gauge
        covariance[columns, :] = linear @ covariance
        covariance[:, columns] = covariance[columns, :].T
        covariance[columns, columns] = linear @ covariance @ linear.T + spread
        new.present[r, slot] = True
    slots = state.slots.copy()
    slots.wall_id[slot], slots.born[slot] = state.next_wall_id, state.epoch
    likeliest = new.mean[members[np.argmax(new.log_weight[members])]]
    slots.flash_m[slot, :, 0] = likeliest[:2]
    slots.flash_m[slot, :, 1] = mirror(*likeliest[:2], *likeliest[columns])
    slots.extent_m[slot] = bounce_along_wall(*likeliest[:2], *likeliest[:2], *likeliest[columns])
    return state.but(hypotheses=new, slots=slots, next_wall_id=state.next_wall_id + 1)
