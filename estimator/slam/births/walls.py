"""New walls from paths that nothing explains.

A wall not yet known shows as one anchor's path whose length changes steadily. Over a
stretch of track its virtual anchor lies on a circle round the agent; how well the
bearing is known depends on how the agent turns. So a wall is born as a *bank* of
bearings, each a narrow Gaussian with the weight that the stretch gives it (and with a prior
that is even in the wall's direction), and later epochs decide between them. Two tests keep walls
out that cannot be: the bounce must not lie behind the stretch of a known wall that reflects, and the
new wall must not stand in the way of paths that were heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import segments_cross
from estimator.slam.births.virtual_anchors import vrp_by_anchor, vrp_by_image, vrp_of_image
from estimator.slam.config import GaussianConfig
from estimator.slam.features import wall_side
from estimator.slam.gaussian.levels import loss_limits
from estimator.slam.gaussian.memory import heard_of
from estimator.slam.gaussian.pool import pending_of
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.layout import Layout

__all__ = ["Bank", "Line", "find_line", "may_bear", "wall_bank"]

Array = NDArray[np.float64]
_MOST_PARTS = 12  # of the spacing of bearings
_SPAN_MARGIN_M = 1.0  # where a wall ends is known no better
_WILD = 4.0  # standard deviations from which an epoch tells nothing: the agent was thought to be elsewhere
_BLOCKED = 2  # pieces of paths that go through a wall if it is not there


@dataclass(frozen=True, eq=False)
class Line:
    """Unexplained paths of one anchor that lie on a line of length against time.

    Parameters
    ----------
    anchor : int
        The anchor.
    epoch : ndarray of int64, shape (N,)
        Epochs, at most one path each.
    length_m, std_m : ndarray, shape (N,)
        Path lengths and their standard deviations.
    """

    anchor: int
    epoch: NDArray[np.int64]
    length_m: Array
    std_m: Array


@dataclass(frozen=True, eq=False)
class Bank:
    """Places of a new wall, as Gaussian VRPs in the gauge frame.

    Parameters
    ----------
    mean_m : ndarray, shape (B, 2)
        VRPs.
    covariance_m2 : ndarray, shape (B, 2, 2)
        Covariances, if agent and anchor stood where they are believed to stand.
    by_agent, by_device : ndarray, shapes (B, 2, 2) and (B, 2, 4)
        Derivatives of the VRPs by the agent's position, and by the anchor in the state vector: the errors
        of a new wall are theirs, too.
    log_weight : ndarray, shape (B,)
        Log likelihoods relative to the best.
    """

    mean_m: Array
    covariance_m2: Array
    by_agent: Array
    by_device: Array
    log_weight: Array

    def jacobian(self, layout: Layout, anchor: int) -> Array:
        """Derivatives (B, 2, n) of the VRPs by the state vector, heard from an anchor."""
        jacobian = np.zeros((len(self.mean_m), 2, layout.size))
        jacobian[:, :, layout.POSITION] = self.by_agent
        jacobian[:, :, layout.anchor(anchor)] = self.by_device
        return jacobian


def may_bear(states: Sequence[GaussianState], config: GaussianConfig) -> list[int]:
    """The runs that :func:`find_line` should be asked about, by a quick test of all of them.

    Those that no wall is pending in, and in which some path of the last two epochs has company in enough
    others: by the triangle inequality the length of a path over a wall changes by no more than the
    agent moves. Of clutter few are so near.
    """
    heard, run = heard_of(states)
    now = np.array([state.epoch for state in states])
    use = (heard[:, 5] == 1.0) & (heard[:, 0] > (now - config.birth_window)[run])
    points, run = heard[use], run[use]
    tracks = [state.trail[-config.birth_window :, 1:3] for state in states]
    ends = np.cumsum([len(track) for track in tracks])
    track, begin = np.concatenate(tracks), np.concatenate([[0], ends[:-1]])
    way = track - np.repeat(track[ends - 1], ends - begin, axis=0)
    moved = np.maximum.reduceat(np.hypot(way[:, 0], way[:, 1]), begin)
    std = np.maximum(points[:, 3], config.range_std_m)
    late = points[:, 0] >= (now - 1)[run]
    reach = moved[run[late]] + 4.0 * np.hypot(std[late], std.max(initial=0.0))
    # lengths side by side, those of each run and anchor out of the others' reach
    line = run * len(states[0].anchor_names) + points[:, 1]
    place = points[:, 2] + line * (points[:, 2].max(initial=0.0) + 2.0 * reach.max(initial=0.0))
    ordered, place = np.sort(place), place[late]
    company = ordered.searchsorted(place + reach) - ordered.searchsorted(place - reach)
    crowded = np.unique(run[late][company >= config.birth_support])
    idle = ~pending_of(states)
    return [i for i in crowded[idle[crowded]].tolist() if _in_company(states[i], config)]


def _in_company(state: GaussianState, config: GaussianConfig) -> bool:
    """The test of :func:`may_bear` of one run, with the place of the agent at each epoch, and powers."""
    points = state.loose[state.loose[:, 0] > state.epoch - config.birth_window]
    points = points[~(points[:, 4] >= loss_limits(state, config)[points[:, 1].astype(np.int64)])]
    late = points[:, 0] >= state.epoch - 1
    place = state.trail[np.searchsorted(state.trail[:, 0], points[:, 0]), 1:3]
    std = np.maximum(points[:, 3], config.range_std_m)
    moved = np.linalg.norm(place[late, None] - place, axis=-1)
    reach = moved + 4.0 * np.hypot(std[late, None], std)
    company = (np.abs(points[late, None, 2] - points[:, 2]) < reach) & (points[late, None, 1] == points[:, 1])
    return bool(company.sum(axis=1).max(initial=0) >= config.birth_support)


def find_line(loose: Array, now: int, limit_db: Array, config: GaussianConfig) -> Line | None:
    """The line with most support among recent unexplained paths, or None.

    Parameters
    ----------
    loose : ndarray, shape (N, 5)
        As in :class:`estimator.slam.gaussian.state.GaussianState`.
    now : int
        Present epoch; the line must reach the last two epochs.
    limit_db : ndarray, shape (K,)
        Loss beyond free space of each anchor's paths from which they start no wall
        (:func:`estimator.slam.gaussian.levels.loss_limits`).
    config : GaussianConfig
        ``birth_window`` and ``birth_support``.
    """
    recent = loose[loose[:, 0] > now - config.birth_window]
    strong = ~(recent[:, 4] >= limit_db[recent[:, 1].astype(np.int64)])  # unknown powers pass
    recent = recent[strong]
    best: Line | None = None
    for anchor in np.unique(recent[:, 1]):
        points = recent[recent[:, 1] == anchor]
        line = _densest(points, now, config)
        if line is not None and (best is None or len(line.epoch) > len(best.epoch)):
            best = line
    return best


def _densest(points: Array, now: int, config: GaussianConfig) -> Line | None:
    time, length = points[:, 0], points[:, 2]
    if len(points) < config.birth_support:
        return None
    a, b = np.nonzero(time[None, :] - time[:, None] >= 3)
    if a.size == 0:
        return None
    slope = (length[b] - length[a]) / (time[b] - time[a])
    width = 3.0 * np.maximum(points[:, 3], config.range_std_m)
    deviation = np.abs(length - (length[a, None] + slope[:, None] * (time - time[a, None])))
    count = np.sum(deviation < width, axis=1)
    best = int(np.argmax(count))
    if count[best] < config.birth_support:
        return None
    # the motion bends the line: a parabola through the points near it gathers the rest
    near = deviation[best] < 2.0 * width
    fit = np.polynomial.Polynomial.fit(time[near], length[near], 2)
    residual = np.abs(length - fit(time))
    keep: list[int] = []
    for epoch in np.unique(time):
        at = np.flatnonzero(time == epoch)
        closest = int(at[np.argmin(residual[at])])
        if residual[closest] < width[closest]:
            keep.append(closest)
    if len(keep) < config.birth_support or time[keep[-1]] < now - 1:
        return None
    chosen = points[keep]
    std = np.maximum(chosen[:, 3], config.range_std_m)
    return Line(int(points[0, 1]), chosen[:, 0].astype(np.int64), chosen[:, 2], std)


def wall_bank(
    line: Line,
    position: Array,
    position_std: Array,
    device: Array,
    walls: Array,
    spans: Array,
    legs: Array,
    config: GaussianConfig,
) -> Bank | None:
    """Walls that would explain a line of path lengths, or None if none can be.

    Parameters
    ----------
    line : Line
        The paths.
    position : ndarray, shape (N, 2)
        The agent at the line's epochs, gauge frame, metres.
    position_std : ndarray, shape (N,)
        Its standard deviation per axis, metres.
    device : ndarray, shape (4,)
        The anchor in the state vector: position, squared height difference, clock bias.
    walls : ndarray, shape (L, 2)
        Known VRPs.
    spans : ndarray, shape (L, 2)
        Stretch along each of them that is known to reflect.
    legs : ndarray, shape (S, 2, 2)
        Straight pieces of paths heard lately (:class:`estimator.slam.gaussian.hindsight.Hindsight`).
    config : GaussianConfig
        ``birth_spacing_rad``, ``prune_nats`` and the test radius.
    """
    anchor = device[:2]
    flat = np.sqrt(np.maximum((line.length_m - device[3]) ** 2 - device[2], 1.0))
    variance = line.std_m**2 + position_std**2
    bearing = np.arange(0.0, 2.0 * np.pi, config.birth_spacing_rad)
    spacing = np.full(bearing.size, config.birth_spacing_rad)
    image, cost = _images(bearing, flat, variance, position)
    parts = _parts(image, cost, anchor, config)
    spacing = np.repeat(spacing / parts, parts)
    within = np.arange(spacing.size) - np.repeat(np.cumsum(parts) - parts, parts)
    bearing = np.repeat(bearing, parts) + spacing * (within - 0.5 * (np.repeat(parts, parts) - 1))
    image, cost = _images(bearing, flat, variance, position)
    vrp = vrp_of_image(image, anchor)
    fits = cost < 0.5 * len(line.epoch) + config.prune_nats
    fits &= cost - cost[fits].min(initial=np.inf) < config.prune_nats
    fits &= np.linalg.norm(vrp, axis=1) > 1.0
    fits &= _can_be(vrp, image, position, anchor, walls, spans, legs, config)
    index = np.flatnonzero(fits)
    if index.size == 0:
        return None
    unit = image[index] - position[-1]
    reach = np.linalg.norm(unit, axis=1)
    unit /= reach[:, None]
    along = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    width = 0.7 * spacing[index] * reach
    spread = width[:, None, None] ** 2 * along[:, :, None] * along[:, None, :]
    spread += 0.3**2 * unit[:, :, None] * unit[:, None, :]
    by_image = vrp_by_image(image[index], np.broadcast_to(anchor, (index.size, 2)))
    covariance = by_image @ spread @ np.swapaxes(by_image, 1, 2) + 0.05**2 * np.eye(2)
    by_length = (by_image @ unit[..., None])[..., 0]
    by_device = np.concatenate(
        [
            vrp_by_anchor(image[index], np.broadcast_to(anchor, (index.size, 2))),
            (-0.5 / flat[-1] * by_length)[..., None],
            (-(line.length_m[-1] - device[3]) / flat[-1] * by_length)[..., None],
        ],
        axis=2,
    )
    turn = (
        spacing[index] * reach / np.linalg.norm(image[index] - anchor, axis=1)
    )  # angle each bearing stands for
    log_weight = -config.birth_trust * (cost[index] - cost[index].min()) + np.log(turn)
    return Bank(vrp[index], covariance, by_image, by_device, log_weight - log_weight.max())


def _images(bearing: Array, flat: Array, variance: Array, position: Array) -> tuple[Array, Array]:
    """The virtual anchor (B, 2) that fits a stretch best, on each bearing from its end, and its cost (B,).

    Epochs far off count no more than others: in the first of them the agent itself may have been taken for
    its mirror image in the line through two anchors.
    """
    unit = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    here = position[-1]
    reach = np.full(bearing.size, flat[-1])
    for _ in range(8):
        offset = here + reach[:, None] * unit - position[:, None, :]  # (N, B, 2)
        distance = np.linalg.norm(offset, axis=-1)
        slope = np.sum(offset * unit, axis=-1) / distance
        error = flat[:, None] - distance
        off = error**2 / variance[:, None]
        weight = np.where(off < _WILD**2, slope / variance[:, None], 0.0)
        reach = reach + np.sum(weight * error, axis=0) / np.maximum(np.sum(weight * slope, axis=0), 1e-3)
    return here + reach[:, None] * unit, 0.5 * np.sum(np.minimum(off, _WILD**2), axis=0)


def _parts(image: Array, cost: Array, anchor: Array, config: GaussianConfig) -> NDArray[np.int64]:
    """In how many parts (B,) to divide the spacing round each bearing.

    A wall near the anchor turns much faster than the bearing of its image; no part may move the VRP
    farther than walls are told apart.
    """
    vrp = vrp_of_image(image, anchor)
    step = np.linalg.norm(np.roll(vrp, -1, axis=0) - vrp, axis=1)
    step = np.maximum(step, np.roll(step, 1))
    plausible = cost - cost.min() < 2.0 * config.prune_nats
    parts = np.where(plausible, np.ceil(step / config.confirm_radius_m), 1.0)
    return np.asarray(np.clip(parts, 1, _MOST_PARTS).astype(np.int64))


def _can_be(
    vrp: Array,
    image: Array,
    position: Array,
    anchor: Array,
    walls: Array,
    spans: Array,
    legs: Array,
    config: GaussianConfig,
) -> NDArray[np.bool_]:
    """Whether new walls (B,) contradict nothing that is known."""
    fine = np.all(wall_side(position[:, None, :], vrp) * wall_side(anchor, vrp) > 0.0, axis=0)
    side = wall_side(position[:, None, :], vrp)  # (N, B)
    other = wall_side(image, vrp)
    fraction = side / (side - other)
    bounce = position[:, None, :] + fraction[..., None] * (image - position[:, None, :])  # (N, B, 2)
    direction = vrp / np.linalg.norm(vrp, axis=1, keepdims=True)
    tangent = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    along = np.sum(bounce * tangent, axis=-1)
    foot = 0.5 * vrp
    begin, end = foot + along.min(axis=0)[:, None] * tangent, foot + along.max(axis=0)[:, None] * tangent
    for wall, span in zip(walls, spans, strict=True):
        fine &= np.linalg.norm(vrp - wall, axis=1) > config.confirm_radius_m
        span = span + np.array([_SPAN_MARGIN_M, -_SPAN_MARGIN_M])
        if not span[1] > span[0]:
            continue
        normal = wall / np.linalg.norm(wall)
        across = np.array([-normal[1], normal[0]])
        left, right = 0.5 * wall + span[0] * across, 0.5 * wall + span[1] * across
        through = segments_cross(position[:, None, :], bounce, left, right)
        through |= segments_cross(anchor, bounce, left, right)
        fine &= np.sum(through, axis=0) < _BLOCKED
        fine &= ~segments_cross(begin, end, left, right)
    # the new wall would stand in the way of what was heard, or across the track
    blocked = segments_cross(legs[:, :1], legs[:, 1:], begin, end)
    fine &= np.sum(blocked, axis=0) < _BLOCKED
    fine &= ~segments_cross(position[0], position[-1], begin, end)
    return np.asarray(fine)
