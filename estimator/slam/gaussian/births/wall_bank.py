"""A bank of walls that would explain a line of path lengths.

Over a stretch of track a wall's virtual anchor lies on a circle round the agent; how well the
bearing is known depends on how the agent turns. So a wall is born as a *bank* of
bearings, each a narrow Gaussian with the weight that the stretch gives it (and with a prior
that is even in the wall's direction), and later epochs decide between them. Two tests keep walls
out that cannot be: the bounce must not lie behind the observed extent of a known wall, and the
new wall must not stand in the way of paths that were detected.

Time is that of the bearings (at most 2 pi / spacing times ``most_parts``) times epochs, walls and legs, each
of which is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.geometry import vrp_by_image, vrp_by_point, vrp_of_image
from estimator.slam.gaussian.births.config import Births
from estimator.slam.gaussian.births.lines import Line
from estimator.slam.models.features import side_of_wall
from estimator.slam.models.state_vector import POSITION, Layout

__all__ = ["Bank", "Known", "wall_bank"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


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
        jacobian[:, :, POSITION] = self.by_agent
        jacobian[:, :, layout.anchor(anchor)] = self.by_device
        return jacobian


@dataclass(frozen=True, eq=False)
class Known:
    """What a new wall must not contradict.

    Parameters
    ----------
    vrps_m : ndarray, shape (L, 2)
        Known walls.
    extents_m : ndarray, shape (L, 2)
        Stretch along each of them that is known to reflect.
    legs_m : ndarray, shape (S, 2, 2)
        Straight pieces of paths detected lately.
    """

    vrps_m: Array
    extents_m: Array
    legs_m: Array


def wall_bank(
    line: Line,
    position: Array,
    position_std: Array,
    device: Array,
    known: Known,
    config: Births,
    prune_nats: float,
    radius_m: float,
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
    known : Known
        What must not be contradicted.
    config : Births
        Spacing and tests.
    prune_nats : float
        Places this far below the best are dropped.
    radius_m : float
        Walls closer than this are the same.
    """
    anchor = device[:2]
    flat = np.sqrt(np.maximum((line.length_m - device[3]) ** 2 - device[2], 1.0))
    variance = line.std_m**2 + position_std**2
    bearing = np.arange(0.0, 2.0 * np.pi, config.birth_spacing_rad)
    spacing = np.full(bearing.size, config.birth_spacing_rad)
    image, cost = _images(bearing, flat, variance, position, config.wild_sigma)
    parts = _parts(image, cost, anchor, config, prune_nats, radius_m)
    spacing = np.repeat(spacing / parts, parts)
    within = np.arange(spacing.size) - np.repeat(np.cumsum(parts) - parts, parts)
    bearing = np.repeat(bearing, parts) + spacing * (within - 0.5 * (np.repeat(parts, parts) - 1))
    image, cost = _images(bearing, flat, variance, position, config.wild_sigma)
    vrp = vrp_of_image(image, anchor)
    fits = cost < 0.5 * len(line.epoch) + prune_nats
    fits &= cost - cost[fits].min(initial=np.inf) < prune_nats
    fits &= np.linalg.norm(vrp, axis=1) > config.least_vrp_m
    index = np.flatnonzero(fits)
    legs = known.legs_m[-config.most_legs :]
    extents = known.extents_m + np.array([config.extent_error_m, -config.extent_error_m])
    can_be = _can_be(
        vrp[index],
        image[index],
        np.ascontiguousarray(position),
        np.ascontiguousarray(anchor),
        known.vrps_m,
        extents,
        legs,
        radius_m,
        config.blocked_legs,
    )
    index = index[can_be]
    if index.size == 0:
        return None
    unit = image[index] - position[-1]
    reach = np.linalg.norm(unit, axis=1)
    unit /= reach[:, None]
    along = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    width = config.overlap * spacing[index] * reach
    spread = width[:, None, None] ** 2 * along[:, :, None] * along[:, None, :]
    spread += config.reach_std_m**2 * unit[:, :, None] * unit[:, None, :]
    by_image = vrp_by_image(image[index], anchor)
    covariance = by_image @ spread @ np.swapaxes(by_image, 1, 2) + config.floor_std_m**2 * np.eye(2)
    by_length = (by_image @ unit[..., None])[..., 0]
    by_device = np.concatenate(
        [
            vrp_by_point(image[index], anchor),
            (-0.5 / flat[-1] * by_length)[..., None],
            (-(line.length_m[-1] - device[3]) / flat[-1] * by_length)[..., None],
        ],
        axis=2,
    )
    # the angle of the wall that each bearing stands for
    turn = spacing[index] * reach / np.linalg.norm(image[index] - anchor, axis=1)
    log_weight = -config.birth_trust * (cost[index] - cost[index].min()) + np.log(turn)
    return Bank(vrp[index], covariance, by_image, by_device, log_weight - log_weight.max())


@compiled
def _images(
    bearing: Array, flat: Array, variance: Array, position: Array, wild_sigma: float
) -> tuple[Array, Array]:
    """The virtual anchor (B, 2) that fits a stretch best, on each bearing from its end, and its cost (B,).

    Epochs far off count no more than others: in the first of them the agent itself may have been taken for
    its mirror image in the line through two anchors.
    """
    count, epochs = bearing.size, flat.size
    image, cost = np.empty((count, 2)), np.empty(count)
    x, y = position[epochs - 1, 0], position[epochs - 1, 1]
    for i in range(count):
        ux, uy = np.cos(bearing[i]), np.sin(bearing[i])
        reach = flat[epochs - 1]
        for _ in range(8):
            pull, information, total = 0.0, 0.0, 0.0
            for e in range(epochs):
                dx, dy = x + reach * ux - position[e, 0], y + reach * uy - position[e, 1]
                distance = np.sqrt(dx * dx + dy * dy)
                error = flat[e] - distance
                off = error * error / variance[e]
                if off < wild_sigma**2:
                    slope = (dx * ux + dy * uy) / distance
                    pull += slope / variance[e] * error
                    information += slope * slope / variance[e]
                total += min(off, wild_sigma**2)
            cost[i] = 0.5 * total
            reach += pull / max(information, 1e-3)
        image[i, 0], image[i, 1] = x + reach * ux, y + reach * uy
    return image, cost


def _parts(
    image: Array, cost: Array, anchor: Array, config: Births, prune_nats: float, radius_m: float
) -> Index:
    """In how many parts (B,) to divide the spacing round each bearing.

    A wall near the anchor turns much faster than the bearing of its image; no part may move the VRP
    farther than walls are told apart.
    """
    vrp = vrp_of_image(image, anchor)
    step = np.linalg.norm(np.roll(vrp, -1, axis=0) - vrp, axis=1)
    step = np.maximum(step, np.roll(step, 1))
    plausible = cost - cost.min() < 2.0 * prune_nats
    parts = np.where(plausible, np.ceil(step / radius_m), 1.0)
    return np.asarray(np.clip(parts, 1, config.most_parts).astype(np.int64))


@compiled
def _cross(px: float, py: float, qx: float, qy: float, rx: float, ry: float, sx: float, sy: float) -> bool:
    """Whether two segments, p to q and r to s, cross between their ends."""
    ax, ay, bx, by = qx - px, qy - py, sx - rx, sy - ry
    first = ax * (ry - py) - ay * (rx - px)
    second = ax * (sy - py) - ay * (sx - px)
    third = bx * (py - ry) - by * (px - rx)
    fourth = bx * (qy - ry) - by * (qx - rx)
    return first * second < 0.0 and third * fourth < 0.0


@compiled
def _can_be(
    vrp: Array,
    image: Array,
    position: Array,
    anchor: Array,
    walls: Array,
    extents: Array,
    legs: Array,
    radius_m: float,
    most_blocked: int,
) -> Mask:
    """Whether new walls (B,) contradict nothing that is known."""
    count, epochs = vrp.shape[0], position.shape[0]
    fine = np.ones(count, dtype=np.bool_)
    bounce = np.empty((epochs, 2))
    for i in range(count):
        vx, vy = vrp[i, 0], vrp[i, 1]
        size = np.sqrt(vx * vx + vy * vy)
        tx, ty = -vy / size, vx / size
        device = side_of_wall(anchor[0], anchor[1], vx, vy)
        other = side_of_wall(image[i, 0], image[i, 1], vx, vy)
        least, most = np.inf, -np.inf
        for e in range(epochs):
            here = side_of_wall(position[e, 0], position[e, 1], vx, vy)
            if not here * device > 0.0:
                fine[i] = False
                break
            fraction = here / (here - other)
            bounce[e, 0] = position[e, 0] + fraction * (image[i, 0] - position[e, 0])
            bounce[e, 1] = position[e, 1] + fraction * (image[i, 1] - position[e, 1])
            along = bounce[e, 0] * tx + bounce[e, 1] * ty
            least, most = min(least, along), max(most, along)
        if not fine[i]:
            continue
        bx, by = 0.5 * vx + least * tx, 0.5 * vy + least * ty
        ex, ey = 0.5 * vx + most * tx, 0.5 * vy + most * ty
        for w in range(walls.shape[0]):
            wx, wy = walls[w, 0], walls[w, 1]
            if np.sqrt((vx - wx) ** 2 + (vy - wy) ** 2) <= radius_m:
                fine[i] = False
                break
            if not extents[w, 1] > extents[w, 0]:
                continue
            length = np.sqrt(wx * wx + wy * wy)
            ax, ay = -wy / length, wx / length
            lx, ly = 0.5 * wx + extents[w, 0] * ax, 0.5 * wy + extents[w, 0] * ay
            rx, ry = 0.5 * wx + extents[w, 1] * ax, 0.5 * wy + extents[w, 1] * ay
            through = 0
            for e in range(epochs):
                px, py = bounce[e, 0], bounce[e, 1]
                if _cross(position[e, 0], position[e, 1], px, py, lx, ly, rx, ry) or _cross(
                    anchor[0], anchor[1], px, py, lx, ly, rx, ry
                ):
                    through += 1
            if through >= most_blocked or _cross(bx, by, ex, ey, lx, ly, rx, ry):
                fine[i] = False
                break
        if not fine[i]:
            continue
        # the new wall would stand in the way of what was detected, or across the track
        blocked = 0
        for s in range(legs.shape[0]):
            if _cross(legs[s, 0, 0], legs[s, 0, 1], legs[s, 1, 0], legs[s, 1, 1], bx, by, ex, ey):
                blocked += 1
        last = epochs - 1
        across = _cross(position[0, 0], position[0, 1], position[last, 0], position[last, 1], bx, by, ex, ey)
        fine[i] = blocked < most_blocked and not across
    return fine
