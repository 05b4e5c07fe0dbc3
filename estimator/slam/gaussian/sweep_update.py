"""Beam sweeps on the way: flashes are matched to walls, correct the hypotheses, and show new walls.

A wall seen for the first time enters all hypotheses and waits for its confirmation as every new wall does.
Time is that of the hypotheses times flashes times walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam.gaussian.polar_correction import correct_along_circles
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.directions import wrapped
from estimator.slam.models.features import mirror
from estimator.slam.models.hypotheses import Hypotheses, log_sum_exp
from estimator.slam.models.kalman import projected, scalar_update
from estimator.slam.models.settings import Settings, not_negative, positive, probability
from estimator.slam.models.state_vector import ECHO_BIAS, FIRST_ANCHOR, PER_ANCHOR, THETA, Layout
from estimator.slam.models.sweeps import FLASH_ENTRIES, flash_of, own_covariance
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
    pair_flashes : float
        Flashes of a sweep that are double bounces over two known walls, on average,
    pair_std_m, pair_azimuth_rad : float
        and how far off the range of the image and the directions of arrival and departure they are, metres
        and radians.
    rival_nats : float
        A match no more than this likelier than another one, or than a new wall, gets that one as its rival.
    least_new_weight : float
        Weight of the hypotheses that must ask for a new wall; it enters those alone.
    residual_flashes, residual_memory : float
        The variance claimed of flashes is scaled to their residuals in range: the claim counts as so many
        flashes, and the last so many tell.
    least_echo_scale, most_echo_scale : float
        Within these limits.
    """

    flash_gate_sigma: float = positive(4.0)
    new_flash_density: float = positive(0.5 / (20.0 * 2.0 * np.pi))
    heading_scale_m: float = positive(0.5)
    echo_bias_std_m: float = not_negative(0.0)
    square_share: float = probability(0.8)
    square_std_rad: float = positive(0.01)
    pair_flashes: float = positive(0.3)
    pair_std_m: float = positive(0.05)
    pair_azimuth_rad: float = positive(0.2)
    rival_nats: float = not_negative(8.0)
    least_new_weight: float = probability(0.01)
    residual_flashes: float = positive(20.0)
    residual_memory: float = positive(200.0)
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
            self.pair_flashes,
            self.pair_std_m,
            self.pair_azimuth_rad,
            self.rival_nats,
            most_turn_rad,
        )


class MatchModel(NamedTuple):
    """What compiled matching needs to know: fields of :class:`SweepMatching`, and the polar correction's."""

    gate_sigma: float
    new_density: float
    square_share: float
    square_std_rad: float
    heading_scale_m: float
    pair_flashes: float
    pair_std_m: float
    pair_azimuth_rad: float
    rival_nats: float
    most_turn_rad: float


@compiled
def _heading(
    layout: Layout, mean: Array, present: NDArray[np.bool_], seen: Array, noise: Array, scale_m: float
) -> float:
    """The turn of the agent's axes that fits a sweep best: each pairing proposes, distances vote."""
    index, value = np.empty(FLASH_ENTRIES, dtype=np.int64), np.empty((2, FLASH_ENTRIES))
    flash = np.empty((layout.slots, 2))
    for i in range(layout.slots):
        x, y = flash_of(layout, mean, i, index, value)
        flash[i, 0], flash[i, 1] = x, y
    best, least = 0.0, np.inf
    for a in range(seen.shape[0]):
        for b in range(layout.slots):
            if not present[b]:
                continue
            turn = np.arctan2(seen[a, 1], seen[a, 0]) - np.arctan2(flash[b, 1], flash[b, 0])
            c, s = np.cos(turn), np.sin(turn)
            score = 0.0
            for j in range(seen.shape[0]):
                x, y = c * seen[j, 0] + s * seen[j, 1], c * seen[j, 1] - s * seen[j, 0]
                nearest = np.inf
                for i in range(layout.slots):
                    if present[i]:
                        nearest = min(nearest, np.hypot(x - flash[i, 0], y - flash[i, 1]))
                scale = np.sqrt(0.5 * (noise[j, 0, 0] + noise[j, 1, 1])) + scale_m
                score += min((nearest / scale) ** 2, 16.0)
            if score < least:
                best, least = turn, score
    return wrapped(best)


@compiled
def _cost(
    layout: Layout,
    mean: Array,
    covariance: Array,
    slot: int,
    x: float,
    y: float,
    noise: Array,
    index: Index,
    value: Array,
    first: Array,
    second: Array,
) -> tuple[float, float]:
    """Squared distance of a flash from a wall in standard deviations, and its negative log density."""
    fx, fy = flash_of(layout, mean, slot, index, value)
    xx = projected(covariance, index, value[0], FLASH_ENTRIES, first)
    yy = projected(covariance, index, value[1], FLASH_ENTRIES, second)
    xy = 0.0
    for e in range(FLASH_ENTRIES):
        xy += value[1, e] * first[index[e]]
    a, b, c = xx + noise[0, 0], xy + noise[0, 1], yy + noise[1, 1]
    dx, dy = x - fx, y - fy
    determinant = a * c - b * b
    square = (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / determinant
    return square, 0.5 * (square + np.log(determinant)) + np.log(2.0 * np.pi)


@compiled
def _take(
    layout: Layout,
    mean: Array,
    covariance: Array,
    slot: int,
    x: float,
    y: float,
    noise: Array,
    heading_variance: float,
) -> float:
    """Correct a Gaussian, whose last state is the heading, in place by one flash; its log density."""
    n = mean.size - 1
    last = FLASH_ENTRIES
    index, value = np.empty(last + 1, dtype=np.int64), np.empty((2, last + 1))
    fx, fy = flash_of(layout, mean, slot, index[:last], value[:, :last])
    index[last], value[0, last], value[1, last] = n, -fy, fx
    entries = last + 1 if heading_variance > 0.0 else last
    fx, fy = fx - mean[n] * fy, fy + mean[n] * fx
    root = np.sqrt(noise[0, 0])  # Cholesky factor of the noise: whitened coordinates
    low = noise[0, 1] / root
    rest = np.sqrt(noise[1, 1] - low * low)
    white, cross = np.empty((2, entries)), np.empty(n + 1)
    for e in range(entries):
        white[0, e] = value[0, e] / root
        white[1, e] = (value[1, e] - low * value[0, e] / root) / rest
    gap = (x - fx) / root
    other = (y - fy - low * (x - fx) / root) / rest
    log_density = -np.log(root * rest)
    before = np.empty(entries)
    for e in range(entries):
        before[e] = mean[index[e]]
    log_density += scalar_update(mean, covariance, index, white[0], entries, gap, 1.0, cross)
    for e in range(entries):
        other -= white[1, e] * (mean[index[e]] - before[e])
    return float(log_density) + scalar_update(mean, covariance, index, white[1], entries, other, 1.0, cross)


@compiled
def _new_density(
    layout: Layout,
    mean: Array,
    present: NDArray[np.bool_],
    x: float,
    y: float,
    noise: Array,
    model: MatchModel,
) -> float:
    """Density of a flash at (x, y) of a wall not known yet, per square metre: most stand square to known ones."""
    reach = max(np.hypot(x, y), 1e-3)
    along = np.arctan2(y, x) - mean[THETA]
    variance = model.square_std_rad**2 + (
        noise[0, 0] * y * y - 2.0 * noise[0, 1] * x * y + noise[1, 1] * x * x
    ) / (reach**4)
    walls, square = 0, 0.0
    first = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    for i in range(layout.slots):
        if present[i]:
            turn = along - np.arctan2(mean[first + 2 * i + 1], mean[first + 2 * i])
            turn -= 0.5 * np.pi * np.round(turn / (0.5 * np.pi))
            square += np.exp(-0.5 * turn * turn / variance)
            walls += 1
    if walls:
        square *= 2.0 * np.pi / (4.0 * walls * np.sqrt(2.0 * np.pi * variance))
    share = model.square_share if walls else 0.0
    return float(0.5 * model.new_density / reach * (1.0 - share + share * square))


@compiled
def _pair_density(
    layout: Layout,
    mean: Array,
    present: NDArray[np.bool_],
    x: float,
    y: float,
    noise: Array,
    model: MatchModel,
) -> float:
    """Density of a flash at (x, y) that is no wall's but a double bounce over two known ones, per square metre.

    There and back over both walls the range is half the way to the agent's image over both; the direction lies
    between those in which the way there begins and the way back ends.
    """
    reach = max(np.hypot(x, y), 1e-3)
    range_m, along = 0.5 * reach - mean[ECHO_BIAS], np.arctan2(y, x) - mean[THETA]
    variance = model.pair_std_m**2 + 0.25 * (
        noise[0, 0] * x * x + 2.0 * noise[0, 1] * x * y + noise[1, 1] * y * y
    ) / (reach * reach)
    first, pairs, density = FIRST_ANCHOR + PER_ANCHOR * layout.anchors, 0, 0.0
    px, py = mean[0], mean[1]
    for i in range(layout.slots):
        if not present[i]:
            continue
        vx, vy = mean[first + 2 * i], mean[first + 2 * i + 1]
        for j in range(i):
            if not present[j]:
                continue
            pairs += 1
            wx, wy = mean[first + 2 * j], mean[first + 2 * j + 1]
            ax, ay = mirror(px, py, vx, vy)
            ax, ay = mirror(ax, ay, wx, wy)
            gap = 0.5 * np.hypot(ax - px, ay - py) - range_m
            if gap * gap > 16.0 * variance:
                continue
            bx, by = mirror(px, py, wx, wy)
            bx, by = mirror(bx, by, vx, vy)
            arrival, departure = np.arctan2(ay - py, ax - px), np.arctan2(by - py, bx - px)
            half = 0.5 * wrapped(departure - arrival)
            off, width = abs(wrapped(along - arrival - half)), abs(half) + model.pair_azimuth_rad
            if off < width:
                density += np.exp(-0.5 * gap * gap / variance) / (np.sqrt(2.0 * np.pi * variance) * 2.0 * width)
    return float(0.5 * model.pair_flashes * density / max(pairs, 1) / reach)


@compiled
def _match(
    layout: Layout,
    mean: Array,
    covariance: Array,
    present: NDArray[np.bool_],
    seen: Array,
    noise: Array,
    heading_variance: float,
    model: MatchModel,
    forced: Index,
    slot: Index,
    residual: Array,
) -> tuple[float, float, int, int]:
    """Match flashes with walls, the best pair first, each taken at once; the log density of all.

    What a flash tells of the agent makes the next pair surer. A flash is matched where that is likelier than
    a new wall.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean, covariance : ndarray, shapes (n + 1,) and (n + 1, n + 1)
        The Gaussian, the unknown heading last; corrected in place.
    present : ndarray of bool, shape (L,)
        Walls that there are.
    seen, noise : ndarray, shapes (J, 2) and (J, 2, 2)
        Flashes and their covariances.
    heading_variance : float
        Of the heading; 0 where it is held.
    model : MatchModel
        Gate, and density of flashes of walls not yet known.
    forced : ndarray of int64, shape (2,)
        A flash, -1 for none, and the wall it must match, -1 for none.
    slot : ndarray of int64, shape (J,)
        Takes the wall of each flash, -1 for a new one, -2 for a double bounce over known ones.
    residual : ndarray, shape (2,)
        Takes the squared residuals in range of the matched flashes over their variances, and what they should be.

    Returns
    -------
    log_density : float
        Of all flashes.
    margin : float
        By how much the least sure match was likelier than its best alternative, nats.
    flash, wall : int
        That alternative: as ``forced``.
    """
    flashes, slots = seen.shape[0], layout.slots
    index, value = np.empty(FLASH_ENTRIES, dtype=np.int64), np.empty((2, FLASH_ENTRIES))
    first, second = np.empty(mean.size), np.empty(mean.size)
    used = np.zeros(slots, dtype=np.bool_)
    none = np.empty(flashes)
    for j in range(flashes):
        new = _new_density(layout, mean, present, seen[j, 0], seen[j, 1], noise[j], model)
        pair = _pair_density(layout, mean, present, seen[j, 0], seen[j, 1], noise[j], model)
        none[j], slot[j] = -np.log(new + pair), -1 if new > pair else -2
    total, margin, other_flash, other_wall = 0.0, np.inf, -1, -1
    cost = np.empty((flashes, slots))
    for _ in range(flashes):
        best, flash, wall = np.inf, -1, -1
        for j in range(flashes):
            if slot[j] >= 0:
                continue
            for i in range(slots):
                cost[j, i] = np.inf
                if not present[i] or used[i] or (j == forced[0] and i != forced[1]):
                    continue
                square, own = _cost(
                    layout, mean, covariance, i, seen[j, 0], seen[j, 1], noise[j], index, value, first, second
                )
                if square < model.gate_sigma**2:
                    cost[j, i] = own
                    gain = own - none[j] - (1e6 if j == forced[0] else 0.0)
                    if gain < min(best, 0.0):
                        best, flash, wall = gain, j, i
        if flash < 0:
            break
        if flash != forced[0]:
            gap, rival = none[flash] - cost[flash, wall], -1
            for i in range(slots):
                if i != wall and cost[flash, i] - cost[flash, wall] < gap:
                    gap, rival = cost[flash, i] - cost[flash, wall], i
            if gap < margin:
                margin, other_flash, other_wall = gap, flash, rival
        slot[flash] = wall
        used[wall] = True
        total += _take(
            layout, mean, covariance, wall, seen[flash, 0], seen[flash, 1], noise[flash], heading_variance
        )
    residual[:] = 0.0
    for j in range(flashes):
        if slot[j] >= 0:
            fx, fy = flash_of(layout, mean, slot[j], index, value)
            length = max(np.hypot(fx, fy), 1e-3)
            nx, ny = fx / length, fy / length
            for e in range(FLASH_ENTRIES):
                value[0, e] = nx * value[0, e] + ny * value[1, e]
            claimed = nx * nx * noise[j, 0, 0] + 2.0 * nx * ny * noise[j, 0, 1] + ny * ny * noise[j, 1, 1]
            fitted = projected(covariance, index, value[0], FLASH_ENTRIES, first)
            residual[0] += (nx * (seen[j, 0] - fx) + ny * (seen[j, 1] - fy)) ** 2 / claimed
            residual[1] += max(1.0 - fitted / claimed, 0.0)
            continue
        total -= none[j]
    return total, margin, other_flash, other_wall


@compiled
def _update(
    layout: Layout,
    hypotheses: Hypotheses,
    before: int,
    seen: Array,
    noise: Array,
    held: bool,
    model: MatchModel,
) -> tuple[int, NDArray[np.bool_], Array]:
    """Correct the first ``before`` hypotheses in place; the others are room for rivals, where matches are in doubt.

    How many there are then, which flashes (R, J) no wall of each explains, and residuals (R, 2).
    """
    flashes, n = seen.shape[0], hypotheses.mean.shape[1]
    unmatched, residual = np.empty((2 * before, flashes), dtype=np.bool_), np.empty((2 * before, 2))
    back, spread = np.empty(seen.shape), np.empty(noise.shape)
    slot = np.empty(flashes, dtype=np.int64)
    count = before
    forced = np.empty(2, dtype=np.int64)
    for r in range(before):
        mean, covariance = hypotheses.mean[r].copy(), hypotheses.covariance[r].copy()
        turn = 0.0
        if not held:
            turn = _heading(layout, mean, hypotheses.present[r], seen, noise, model.heading_scale_m)
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
            density, margin, flash, wall = _match(
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
                hypotheses.located[at], hypotheses.present[at] = hypotheses.located[r], hypotheses.present[r]
                hypotheses.visibility[at], hypotheses.support[at] = hypotheses.visibility[r], support
                count += 1
            hypotheses.log_weight[at] = weight + density
            hypotheses.mean[at], hypotheses.covariance[at] = wide_mean[:n], wide[:n, :n]
            for j in range(flashes):
                unmatched[at, j] = slot[j] == -1
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
    return count, unmatched, residual


def take_sweep(
    state: GaussianState,
    sweep: Sequence[GaussianVrp],
    heading_held: bool,
    model: SweepMatching,
    most_turn_rad: float,
    visibility: Visibility,
) -> GaussianState:
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
    GaussianState
    """
    if not sweep:
        return state
    to_gauge = rotation_matrix(-state.bearing_rad)
    seen = np.array([wall.mean_m for wall in sweep]) @ to_gauge.T
    scale = float(state.echo_residuals[0] / state.echo_residuals[1])
    noise = np.array([to_gauge @ own_covariance(wall, model.echo_bias_std_m) @ to_gauge.T for wall in sweep])
    scale = min(max(scale, model.least_echo_scale), model.most_echo_scale)
    noise *= scale
    room = state.hypotheses.take(np.tile(np.arange(state.hypotheses.number), 2))
    count, unmatched, residual = _update(
        state.layout, room, state.hypotheses.number, seen, noise, heading_held, model.compiled(most_turn_rad)
    )
    corrected, unmatched = room.take(np.arange(count)), unmatched[:count]
    evidence = log_sum_exp(corrected.log_weight)
    corrected.log_weight[...] -= evidence
    told = np.array([scale, 1.0]) * residual[corrected.best]
    kept = max(1.0 - told[1] / model.residual_memory, 0.0)
    state = state.but(
        hypotheses=corrected,
        log_evidence=state.log_evidence + evidence,
        tracked_epoch=state.epoch,
        echo_residuals=kept * state.echo_residuals + told,
    )
    if heading_held:
        weight = np.exp(corrected.log_weight)
        for j in range(len(seen)):
            if weight[unmatched[:, j]].sum() > model.least_new_weight:
                state = _enter(state, np.flatnonzero(unmatched[:, j]), seen[j], noise[j], visibility)
    return state


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
    return state.but(hypotheses=new, slots=slots, next_wall_id=state.next_wall_id + 1)
