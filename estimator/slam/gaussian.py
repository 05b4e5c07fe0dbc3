"""The Gaussian engine: hybrid SLAM with one joint, gauge-separated Gaussian per hypothesis.

``start`` turns the walls sensed at the beginning into a state; ``step`` takes one
epoch of path lengths into it. Online and offline use call the same two functions.

The reference wall's bearing defines the gauge frame (:mod:`estimator.slam.layout`), so
that the rotation of the whole map, which passive measurements cannot see, is a state
of its own that they do not touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.geometry import rotation_matrix
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp
from estimator.slam.anchors import Candidates, Centres, PathBatch, images_of_agent, locate
from estimator.slam.births import find_line, wall_bank
from estimator.slam.config import GaussianConfig
from estimator.slam.features import predict_paths, reflect, wall_side
from estimator.slam.hypotheses import tidy
from estimator.slam.layout import Layout
from estimator.slam.motion import predict_motion
from estimator.slam.state import GaussianState, take_rows
from estimator.slam.update import correct, kalman, predicted_variance
from estimator.waveform import free_space_loss_db

__all__ = ["start", "step"]

Array = NDArray[np.float64]
_NOWHERE = 1e4  # where the VRPs of empty slots stand, metres
_FRESH = (0.9, 0.6, 0.1)  # prior visibility of line of sight, wall and pair


def start(
    walls: Sequence[GaussianVrp], anchor_names: Sequence[str], carrier_hz: float, config: GaussianConfig
) -> GaussianState:
    """The state before the first epoch.

    Parameters
    ----------
    walls : sequence of GaussianVrp
        Walls sensed at the start, estimator's frame; at least one, for it fixes the
        direction of the map.
    anchor_names : sequence of str
        The anchors that epochs will report on, in order.
    carrier_hz : float
        Carrier frequency, hertz.
    config : GaussianConfig
        Models.

    Raises
    ------
    InputError
        If no wall or no anchor is given.
    """
    if not walls or not anchor_names:
        raise InputError(
            f"hybrid SLAM: expected at least one wall sensed at the start and one anchor, "
            f"got {len(walls)} walls and {len(anchor_names)} anchors"
        )
    walls = sorted(walls, key=_bearing_std)
    layout = Layout(len(anchor_names), len(walls))
    reference = walls[0].mean_m
    bearing = float(np.arctan2(reference[1], reference[0]))
    to_gauge = rotation_matrix(-bearing)
    vrps = np.array([wall.mean_m for wall in walls]) @ to_gauge.T
    vrps[0, 1] = 0.0

    mean = np.zeros(layout.size)
    mean[layout.walls] = vrps.ravel()
    covariance = np.zeros((layout.size, layout.size))
    covariance[2:4, 2:4] = config.velocity_std_m_s**2 * np.eye(2)
    for k in range(layout.anchors):
        height2 = layout.anchor(k).start + 2
        mean[height2] = config.height2_mean_m2
        mean[layout.anchor(k).start] = _NOWHERE
        covariance[height2, height2] = config.height2_std_m2**2
    covariance += _wall_prior(walls, vrps, to_gauge, layout)

    count = len(walls)
    visibility = np.empty((1, layout.anchors, layout.features))
    visibility[..., 0], visibility[..., 1 : 1 + count], visibility[..., 1 + count :] = _FRESH
    return GaussianState(
        anchor_names=tuple(anchor_names),
        bearing_rad=bearing,
        epoch=-1,
        time_s=0.0,
        carrier_hz=float(carrier_hz),
        log_evidence=0.0,
        log_weight=np.zeros(1),
        mean=mean[None],
        covariance=covariance[None],
        located=np.zeros((1, layout.anchors), dtype=bool),
        present=np.ones((1, count), dtype=bool),
        visibility=visibility,
        support=np.zeros((1, count), dtype=np.int64),
        wall_id=np.arange(count),
        wall_epoch=np.full(count, -1),
        confirmed=np.ones(count, dtype=bool),
        span_m=np.zeros((count, 2)),
        trail=np.empty((0, 6)),
        loose=np.empty((0, 5)),
    )


def _bearing_std(wall: GaussianVrp) -> float:
    """Standard deviation of a VRP's bearing, radians."""
    square = float(wall.mean_m @ wall.mean_m)
    tangent = np.array([-wall.mean_m[1], wall.mean_m[0]]) / np.sqrt(square)
    return float(np.sqrt(tangent @ wall.covariance_m2 @ tangent / square))


def _wall_prior(walls: Sequence[GaussianVrp], vrps: Array, to_gauge: Array, layout: Layout) -> Array:
    """Covariance of theta and the VRPs in the gauge frame.

    An error of the reference wall's bearing turns all the others the other way.
    """
    count = len(walls)
    errors = np.zeros((2 * count, 2 * count))
    for i, wall in enumerate(walls):
        errors[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = to_gauge @ wall.covariance_m2 @ to_gauge.T
    linear = np.zeros((layout.size, 2 * count))
    linear[layout.THETA, 1] = 1.0 / vrps[0, 0]
    for i in range(count):
        rows = layout.wall(i)
        linear[rows, 2 * i : 2 * i + 2] += np.eye(2)
        quarter_turn = np.array([-vrps[i, 1], vrps[i, 0]])
        linear[rows, :] -= np.outer(quarter_turn, linear[layout.THETA])
    linear[layout.wall(0).start + 1] = 0.0
    return np.asarray(linear @ errors @ linear.T)


def step(
    state: GaussianState, epoch: Epoch, config: GaussianConfig, rng: np.random.Generator | None = None
) -> GaussianState:
    """Take one epoch into the state.

    Parameters
    ----------
    state : GaussianState
        The state after the previous epoch; it is not changed.
    epoch : Epoch
        The next epoch: a larger index and time than the state's.
    config : GaussianConfig
        Models.
    rng : Generator, optional
        Part of the step protocol; this engine draws nothing.

    Returns
    -------
    GaussianState

    Raises
    ------
    InputError
        If the epoch is not later than the state, or has another number of anchors.
    """
    if len(epoch.paths) != len(state.anchor_names):
        raise InputError(
            f"epoch {epoch.index}: expected paths of {len(state.anchor_names)} anchors, got {len(epoch.paths)}"
        )
    if state.epoch >= 0:
        if epoch.index <= state.epoch or not epoch.time_s > state.time_s:
            raise InputError(
                f"epoch {epoch.index}: expected one later than epoch {state.epoch} at {state.time_s} s, "
                f"got time {epoch.time_s} s"
            )
        state = _predict(state, epoch.time_s - state.time_s, config)
    state = replace(state, epoch=epoch.index, time_s=epoch.time_s)
    paths = _stack(epoch, state.carrier_hz)
    state, explained = _correct(state, paths, config)
    state = _locate_anchors(state, paths, config)
    state = _note(state, paths, explained, config)
    state = _bear(state, config)
    return _judge(tidy(state, config), config)


class _Paths:
    """The paths of an epoch as padded arrays (K, M)."""

    def __init__(self, length: Array, std: Array, loss: Array, valid: NDArray[np.bool_]) -> None:
        self.length, self.std, self.loss, self.valid = length, std, loss, valid


def _stack(epoch: Epoch, carrier_hz: float) -> _Paths:
    count = max((len(paths) for paths in epoch.paths), default=0)
    shape = (len(epoch.paths), max(count, 1))
    length, std = np.ones(shape), np.ones(shape)
    loss, valid = np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    for k, paths in enumerate(epoch.paths):
        n = len(paths)
        length[k, :n], std[k, :n], valid[k, :n] = paths.range_m, paths.range_std_m, True
        if paths.gain_db is not None:
            loss[k, :n] = -paths.gain_db - free_space_loss_db(paths.range_m, carrier_hz)
    return _Paths(length, std, loss, valid)


def _predict(state: GaussianState, step_s: float, config: GaussianConfig) -> GaussianState:
    mean, covariance = predict_motion(state.mean, state.covariance, step_s, config.acceleration_variance)
    e = state.visibility
    e = (1.0 - config.vanish_probability) * e + config.appear_probability * (1.0 - e)
    return replace(state, mean=mean, covariance=covariance, visibility=e)


def _active(state: GaussianState) -> NDArray[np.bool_]:
    """Features (R, K, F) that each row has; pairs need two walls that count as found."""
    rows, slots = state.present.shape
    found = state.present & state.confirmed
    pairs = (found[:, :, None] & found[:, None, :]).reshape(rows, slots**2)
    features = np.concatenate([np.ones((rows, 1), dtype=bool), state.present, pairs], axis=1)
    return np.asarray(state.located[:, :, None] & features[:, None, :])


def _correct(
    state: GaussianState, paths: _Paths, config: GaussianConfig
) -> tuple[GaussianState, NDArray[np.float64]]:
    """Associate and update all rows; also the best row's explained probabilities (K, M)."""
    if not state.located.any():
        return state, np.zeros(paths.length.shape)
    done = correct(
        state.mean,
        state.covariance,
        state.visibility,
        _active(state),
        paths.length,
        paths.std,
        paths.valid,
        state.layout,
        config,
    )
    heard = np.any(done.heard[:, :, 1 : 1 + state.layout.slots] > 0.5, axis=1)
    weight = state.log_weight + done.log_evidence
    top = float(weight.max())
    total = top + float(np.log(np.sum(np.exp(weight - top))))
    best = int(np.argmax(weight))
    state = replace(
        state,
        mean=done.mean,
        covariance=done.covariance,
        visibility=done.visibility,
        support=state.support + heard,
        log_weight=weight - total,
        log_evidence=state.log_evidence + total,
        span_m=_widen(state, done.mean[best], done.heard[best]),
    )
    return state, done.explained[best]


def _widen(state: GaussianState, mean: Array, heard: Array) -> Array:
    """Spans (L, 2) after the bounces that a row heard."""
    layout = state.layout
    span = state.span_m.copy()
    wall = mean[layout.walls].reshape(-1, 2)
    for k in range(layout.anchors):
        anchor = mean[layout.anchor(k)][:2]
        image = reflect(anchor[None], wall)
        side, other = wall_side(mean[None, :2], wall), wall_side(image, wall)
        gap = np.where(side == other, 1.0, side - other)
        bounce = mean[:2] + (side / gap)[:, None] * (image - mean[:2])
        normal = wall / np.linalg.norm(wall, axis=1, keepdims=True)
        along = bounce[:, 1] * normal[:, 0] - bounce[:, 0] * normal[:, 1]
        hit = heard[k, 1 : 1 + layout.slots] > 0.5
        span[:, 0] = np.where(hit, np.minimum(span[:, 0], along), span[:, 0])
        span[:, 1] = np.where(hit, np.maximum(span[:, 1], along), span[:, 1])
    return span


def _best(state: GaussianState) -> int:
    return int(np.argmax(state.log_weight))


def _locate_anchors(state: GaussianState, paths: _Paths, config: GaussianConfig) -> GaussianState:
    """Start the anchors that the best row has not located, where the paths allow it."""
    for k in range(state.layout.anchors):
        best = _best(state)
        if state.located[best, k]:
            continue
        found, centres = _search(state, paths, k, best, config)
        if len(found.mean_m):
            state = _fork_anchor(state, paths, k, found, centres, config)
            state = tidy(state, config)
    return state


def _search(
    state: GaussianState, paths: _Paths, k: int, best: int, config: GaussianConfig
) -> tuple[Candidates, Centres]:
    """Places for anchor ``k`` from this epoch and, every fourth epoch, recent ones."""
    layout, mean, covariance = state.layout, state.mean[best], state.covariance[best]
    slots = np.flatnonzero(state.present[best] & state.confirmed)
    walls = mean[layout.walls].reshape(-1, 2)[slots]
    spread = np.array([covariance[layout.wall(s), layout.wall(s)] for s in slots])
    n = int(paths.valid[k].sum())
    here = np.full(n, state.epoch)
    parts = [images_of_agent(mean[:2], 0.5 * float(np.trace(covariance[:2, :2])), walls, spread, slots, state.epoch)]
    length, std, loss, epoch = [paths.length[k, :n]], [paths.std[k, :n]], [paths.loss[k, :n]], [here]
    old = state.loose[(state.loose[:, 1] == k)] if len(state.trail) and state.epoch % 4 == 0 else state.loose[:0]
    for row in state.trail[:-1:3] if len(old) else ():
        at = old[old[:, 0] == row[0]]
        if len(at) == 0:
            continue
        parts.append(images_of_agent(row[1:3], row[3] ** 2, walls, spread, slots, int(row[0])))
        length.append(at[:, 2]), std.append(at[:, 3]), loss.append(at[:, 4])
        epoch.append(at[:, 0].astype(np.int64))
    centres = Centres(*(np.concatenate(columns) for columns in zip(*(vars(part).values() for part in parts), strict=True)))
    batch = PathBatch(
        np.concatenate(length),
        np.maximum(np.concatenate(std), config.range_std_m) ** 2,
        np.concatenate(epoch),
        np.concatenate(loss),
    )
    found = locate(centres, batch, dict(zip(slots.tolist(), walls, strict=True)), config, np.array([state.epoch]))
    now = centres.epoch == state.epoch
    fresh = np.sum((found.label >= 0) & now & (centres.bounces < 2), axis=1)
    enough = (found.matches >= config.start_matches * (1 if len(parts) == 1 else 2)) & (fresh >= 2)
    return Candidates(*(column[enough] for column in vars(found).values())), centres


def _fork_anchor(
    state: GaussianState, paths: _Paths, k: int, found: Candidates, centres: Centres, config: GaussianConfig
) -> GaussianState:
    """Rows without anchor ``k`` split into one row per candidate and one that waits on."""
    layout = state.layout
    waiting = np.flatnonzero(~state.located[:, k])
    settled = np.flatnonzero(state.located[:, k])
    count = len(found.mean_m)
    rows = take_rows(state, np.concatenate([settled, waiting, np.repeat(waiting, count)]))
    new = slice(len(settled) + len(waiting), None)
    place = layout.anchor(k)
    candidate = np.tile(np.arange(count), len(waiting))
    rows["located"][new, k] = True
    rows["log_weight"][new] += found.log_evidence[candidate]
    rows["mean"][new, place.start : place.start + 2] = found.mean_m[candidate]
    epochs = np.unique(centres.epoch).size
    prior = 100.0 * np.eye(2) if epochs == 1 else None
    xy = slice(place.start, place.start + 2)
    rows["covariance"][new, xy, xy] = (
        prior if prior is not None else 9.0 * found.covariance_m2[candidate] + 0.25 * np.eye(2)
    )
    rows["visibility"][new, k] = _fresh_visibility(layout)

    # the labels found say which paths are the anchor's: take this epoch's into the joint Gaussian
    now = np.flatnonzero((centres.epoch == state.epoch) & (centres.bounces < 2))
    feature = np.where(centres.bounces[now] == 0, 0, 1 + centres.wall[now])
    label = found.label[candidate][:, now]  # (new, C), this epoch's paths come first in the batch
    prediction = predict_paths(rows["mean"][new], layout)
    known = label >= 0
    length = paths.length[k][np.maximum(label, 0)]
    std = np.maximum(paths.std[k][np.maximum(label, 0)], config.range_std_m)
    mean, covariance, _ = kalman(
        rows["mean"][new],
        rows["covariance"][new],
        np.where(known[..., None], prediction.jacobian[:, k, feature], 0.0),
        np.where(known, length - prediction.length_m[:, k, feature], 0.0),
        np.where(known, std**2, 0.5 / np.pi),
    )
    rows["mean"][new], rows["covariance"][new] = mean, covariance
    return replace(state, **rows)


def _fresh_visibility(layout: Layout) -> Array:
    """Prior visibility (F,) of an anchor's features."""
    visibility = np.empty(layout.features)
    slots = layout.slots
    visibility[0], visibility[1 : 1 + slots], visibility[1 + slots :] = _FRESH
    return visibility


def _note(state: GaussianState, paths: _Paths, explained: Array, config: GaussianConfig) -> GaussianState:
    """Remember where the agent was and what nothing explained."""
    layout, best = state.layout, _best(state)
    mean, covariance = state.mean[best], state.covariance[best]
    std = float(np.sqrt(0.5 * np.trace(covariance[:2, :2])))
    trail = np.concatenate([state.trail, [[state.epoch, mean[0], mean[1], std, mean[2], mean[3]]]])
    prediction = predict_paths(mean[None], layout)
    active = (_active(state)[best] & prediction.possible[0])[..., None]  # (K, F, 1)
    spread = predicted_variance(prediction, covariance[None])[0][..., None]
    distance = np.abs(paths.length[:, None, :] - prediction.length_m[0][..., None])
    near = distance < np.minimum(config.pair_radius_m + 2.0 * np.sqrt(spread), 3.0)
    taken = np.any(active & near, axis=1) | (explained > 0.3)
    loose = paths.valid & ~np.where(state.located[best][:, None], taken, False)
    k, j = np.nonzero(loose)
    rows = np.stack(
        [np.full(k.size, float(state.epoch)), k.astype(float), paths.length[k, j], paths.std[k, j], paths.loss[k, j]],
        axis=1,
    )
    oldest = state.epoch - max(config.birth_window, config.start_window)
    kept = np.concatenate([state.loose, rows])
    return replace(state, trail=trail[trail[:, 0] > oldest], loose=kept[kept[:, 0] > oldest])


def _bear(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Start a wall where recent unexplained paths ask for one."""
    if np.any((state.wall_id >= 0) & ~state.confirmed):
        return state
    line = find_line(state.loose, state.epoch, config)
    best = _best(state)
    if line is None or not state.located[best, line.anchor]:
        return state
    mean = state.mean[best]
    present = state.present[best]
    anchor = mean[state.layout.anchor(line.anchor)]
    at = np.searchsorted(state.trail[:, 0], line.epoch)
    walls = mean[state.layout.walls].reshape(-1, 2)[present]
    bank = wall_bank(line, state.trail[at, 1:3], anchor[:2], float(anchor[2]), walls, state.span_m[present], config)
    if bank is None:
        return state
    state, slot = _open_slot(state)
    rows = take_rows(state, np.concatenate([np.arange(len(state.mean)), np.full(len(bank.mean_m), best)]))
    new = slice(len(state.mean), None)
    columns = state.layout.wall(slot)
    rows["mean"][new, columns] = bank.mean_m
    rows["covariance"][new, columns, columns] = bank.covariance_m2
    rows["present"][new, slot] = True
    log_share = bank.log_weight - np.log(np.sum(np.exp(bank.log_weight)))
    rows["log_weight"][new] += config.birth_log_prior + log_share
    ids = state.wall_id.copy()
    ids[slot] = int(max(state.wall_id.max(), state.loose.shape[0] * 0 + state.wall_id.max())) + 1
    born = state.wall_epoch.copy()
    born[slot] = state.epoch
    gone = (state.loose[:, 1] == line.anchor) & np.isin(state.loose[:, 2], line.length_m)
    return replace(state, **rows, wall_id=ids, wall_epoch=born, loose=state.loose[~gone])


def _open_slot(state: GaussianState) -> tuple[GaussianState, int]:
    """A state with an empty wall slot, and its number."""
    empty = np.flatnonzero(state.wall_id < 0)
    if empty.size:
        return state, int(empty[0])
    old, rows = state.layout, len(state.mean)
    new = Layout(old.anchors, old.slots + 1)
    mean = np.full((rows, new.size), _NOWHERE)
    mean[:, : old.size] = state.mean
    covariance = np.zeros((rows, new.size, new.size))
    covariance[:, : old.size, : old.size] = state.covariance
    visibility = np.broadcast_to(_fresh_visibility(new), (rows, new.anchors, new.features)).copy()
    visibility[..., : 1 + old.slots] = state.visibility[..., : 1 + old.slots]
    pairs = visibility[..., 1 + new.slots :].reshape(rows, new.anchors, new.slots, new.slots)
    pairs[..., : old.slots, : old.slots] = state.visibility[..., 1 + old.slots :].reshape(
        rows, new.anchors, old.slots, old.slots
    )

    def pad(values: NDArray[np.generic], fill: object) -> NDArray[np.generic]:
        return np.concatenate([values, np.full((*values.shape[:-1], 1), fill, dtype=values.dtype)], axis=-1)

    grown = replace(
        state,
        mean=mean,
        covariance=covariance,
        visibility=visibility,
        present=pad(state.present, False),
        support=pad(state.support, 0),
        wall_id=pad(state.wall_id, -1),
        wall_epoch=pad(state.wall_epoch, -1),
        confirmed=pad(state.confirmed, False),
        span_m=np.concatenate([state.span_m, [[np.inf, -np.inf]]]),
    )
    return grown, old.slots


def _judge(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Confirm the pending wall, or give it up."""
    pending = np.flatnonzero((state.wall_id >= 0) & ~state.confirmed)
    for slot in pending:
        weight = np.exp(state.log_weight)
        have = state.present[:, slot]
        share = float(weight[have].sum())
        if have.any():
            best = int(np.flatnonzero(have)[np.argmax(weight[have])])
            vrps = state.mean[:, state.layout.wall(int(slot))]
            alike = have & (np.linalg.norm(vrps - vrps[best], axis=1) < config.confirm_radius_m)
            agreed = float(weight[alike].sum())
            if agreed > config.confirm_weight and state.support[best, slot] >= config.confirm_support:
                confirmed = state.confirmed.copy()
                confirmed[slot] = True
                state = _keep_rows(replace(state, confirmed=confirmed), alike)
                continue
        if share < 1e-5 or state.epoch - state.wall_epoch[slot] > config.pending_epochs:
            state = _close_slot(state, int(slot))
    return state


def _keep_rows(state: GaussianState, keep: NDArray[np.bool_]) -> GaussianState:
    rows = take_rows(state, np.flatnonzero(keep))
    rows["log_weight"] = rows["log_weight"] - np.log(np.sum(np.exp(rows["log_weight"])))
    return replace(state, **rows)


def _close_slot(state: GaussianState, slot: int) -> GaussianState:
    """Give a wall up: the rows without it stay; if all have it, it is removed from them."""
    without = ~state.present[:, slot]
    if without.any():
        state = _keep_rows(state, without)
    columns = state.layout.wall(slot)
    mean, covariance = state.mean.copy(), state.covariance.copy()
    mean[:, columns] = _NOWHERE
    covariance[:, columns, :] = 0.0
    covariance[:, :, columns] = 0.0
    present, support = state.present.copy(), state.support.copy()
    present[:, slot], support[:, slot] = False, 0
    ids, born, span = state.wall_id.copy(), state.wall_epoch.copy(), state.span_m.copy()
    ids[slot], born[slot], span[slot] = -1, -1, (np.inf, -np.inf)
    visibility = np.broadcast_to(_fresh_visibility(state.layout), state.visibility.shape).copy()
    slots = state.layout.slots
    keep = np.ones(state.layout.features, dtype=bool)
    keep[1 + slot] = False
    keep[1 + slots :] = (~((np.arange(slots) == slot)[:, None] | (np.arange(slots) == slot)[None, :])).ravel()
    visibility[..., keep] = state.visibility[..., keep]
    return replace(
        state,
        mean=mean,
        covariance=covariance,
        present=present,
        support=support,
        visibility=visibility,
        wall_id=ids,
        wall_epoch=born,
        span_m=span,
    )
