"""Estimates as bytes of equal meaning, which a whole run of is read at once, without a loop over epochs.

An epoch is a row of doubles (little endian, exact): a head, each anchor, each wall, each candidate, and the
walls of the candidates one after the other. Whole numbers are doubles, too; what is not known is NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.result import SlamResult
from estimator.slam.protocol import INTEGRITY_STATES, Estimate

__all__ = ["RunTerms", "pack_estimate", "unpack_run"]

Array = NDArray[np.float64]
_DOUBLE = "<f8"
# Epoch, time, walls, candidates, hypotheses, rotation, evidence, integrity (3), mean, covariance.
_HEAD = 10 + 4 + 16
_ANCHOR = 8  # located, place (2), covariance (4), existence
_WALL = 8  # id, VRP (2), covariance (4), existence
_CANDIDATE = 4  # weight, place (2), walls
_ITS_WALL = 3  # id, VRP (2)
_STATES = {name: number for number, name in enumerate(INTEGRITY_STATES)}


@dataclass(frozen=True)
class RunTerms:
    """What a run's estimates do not say of it.

    Parameters
    ----------
    method, engine, seed
        As in :class:`estimator.result.SlamResult`.
    anchors : tuple of str
        Names, in the order of the estimates.
    settings : mapping
        Configuration of the run, JSON types.
    """

    method: str
    engine: str
    seed: int
    anchors: tuple[str, ...]
    settings: Mapping[str, Any]


def pack_estimate(epoch: int, time_s: float, estimate: Estimate) -> bytes:
    """An epoch's estimate as bytes; see the head of this module."""
    told, integrity = estimate.candidates, estimate.integrity
    values: list[float] = [
        epoch,
        time_s,
        len(estimate.wall_id),
        len(told),
        estimate.hypotheses,
        estimate.rotation_std_rad,
        estimate.log_evidence,
        _STATES.get(integrity.state, -1),
        integrity.probability,
        integrity.protection_level_m,
    ]
    values += estimate.agent_mean.tolist() + estimate.agent_covariance.ravel().tolist()
    for name, first in (("anchor", estimate.anchor_valid), ("wall", estimate.wall_id)):
        places = getattr(estimate, f"{name}_mean_m").tolist()
        spreads = getattr(estimate, f"{name}_covariance_m2").reshape(-1, 4).tolist()
        existence = getattr(estimate, f"{name}_existence").tolist()
        for row in zip(first.tolist(), places, spreads, existence, strict=True):
            values += row[0], *row[1], *row[2], row[3]
    for one in told:
        values += one.weight, *one.agent_m.tolist(), len(one.wall_id)
    for one in told:
        for number, place in zip(one.wall_id.tolist(), one.wall_mean_m.tolist(), strict=True):
            values += number, *place
    return np.array(values, dtype=_DOUBLE).tobytes()


def unpack_run(packed: Sequence[bytes], terms: RunTerms) -> SlamResult:
    """The result of a run from its epochs' estimates, in order; no epoch makes an empty one.

    Parameters
    ----------
    packed : sequence of bytes
        As :func:`pack_estimate` wrote them.
    terms : RunTerms
        What they do not say.
    """
    epochs, count = len(packed), len(terms.anchors)
    values = np.frombuffer(b"".join(packed), dtype=_DOUBLE).astype(np.float64, copy=False)
    sizes = np.array([len(row) // 8 for row in packed], dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    head = _taken(values, starts, np.ones(epochs, dtype=np.int64), _HEAD)
    anchors = _taken(values, starts + _HEAD, np.full(epochs, count), _ANCHOR).reshape(epochs, count, _ANCHOR)
    whole = head[:, [0, 2, 3, 4, 7]].astype(np.int64)
    walls_at = starts + _HEAD + count * _ANCHOR
    candidates_at = walls_at + whole[:, 1] * _WALL
    return SlamResult(
        method=terms.method,
        engine=terms.engine,
        seed=terms.seed,
        anchors=terms.anchors,
        epoch=whole[:, 0],
        time_s=head[:, 1],
        agent_mean=head[:, 10:14],
        agent_covariance=head[:, 14:30].reshape(epochs, 4, 4),
        rotation_std_rad=head[:, 5],
        anchor_valid=anchors[..., 0] > 0.0,
        anchor_mean_m=anchors[..., 1:3],
        anchor_covariance_m2=anchors[..., 3:7].reshape(epochs, count, 2, 2),
        anchor_existence=anchors[..., 7],
        hypotheses=whole[:, 3],
        log_evidence=head[:, 6],
        **_walls(_taken(values, walls_at, whole[:, 1], _WALL), whole[:, 1]),
        **_candidates(values, candidates_at, whole[:, 2]),
        settings=dict(terms.settings),
        integrity_state=whole[:, 4],
        integrity_probability=head[:, 8],
        protection_level_m=head[:, 9],
    )


def _taken(values: Array, starts: NDArray[np.int64], rows: NDArray[np.int64], width: int) -> Array:
    """Rows of a table that begins at each start, those of all tables one after the other."""
    at = np.repeat(starts, rows) + width * _within(rows)
    rows_at: NDArray[np.int64] = at[:, None] + np.arange(width)
    return np.take(values, rows_at)


def _within(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, 1, ... within each of so many, one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _walls(rows: Array, counts: NDArray[np.int64]) -> dict[str, Any]:
    """Walls by epoch and identity; NaN where there is none."""
    epochs = len(counts)
    ids, column = np.unique(rows[:, 0].astype(np.int64), return_inverse=True)
    at = np.repeat(np.arange(epochs), counts), column
    spread = np.full((epochs, ids.size, _WALL), np.nan)
    spread[at] = rows
    return {
        "wall_id": ids,
        "wall_valid": ~np.isnan(spread[..., 0]),
        "wall_mean_m": spread[..., 1:3],
        "wall_covariance_m2": spread[..., 3:7].reshape(epochs, ids.size, 2, 2),
        "wall_existence": spread[..., 7],
    }


def _candidates(values: Array, starts: NDArray[np.int64], counts: NDArray[np.int64]) -> dict[str, Any]:
    """Candidates by epoch and rank, and their walls by identity; NaN where there is none."""
    epochs, most = len(counts), int(counts.max(initial=0))
    epoch, rank = np.repeat(np.arange(epochs), counts), _within(counts)
    told = _taken(values, starts, counts, _CANDIDATE)
    spread = np.full((epochs, most, 3), np.nan)
    spread[epoch, rank] = told[:, :3]
    have = told[:, 3].astype(np.int64)
    of_epoch = np.bincount(epoch, weights=have, minlength=epochs).astype(np.int64)
    rows = _taken(values, starts + counts * _CANDIDATE, of_epoch, _ITS_WALL)
    ids, column = np.unique(rows[:, 0].astype(np.int64), return_inverse=True)
    walls = np.full((epochs, most, ids.size, 2), np.nan)
    walls[np.repeat(epoch, have), np.repeat(rank, have), column] = rows[:, 1:]
    return {
        "candidate_weight": spread[..., 0],
        "candidate_agent_m": spread[..., 1:],
        "candidate_wall_id": ids,
        "candidate_wall_mean_m": walls,
    }
