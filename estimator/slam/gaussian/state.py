"""The state of the Gaussian engine: a value that can be saved and loaded bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from estimator.slam.archive import Columns, pack, unpack
from estimator.slam.layout import Layout

__all__ = [
    "NOWHERE_M",
    "GaussianState",
    "Rows",
    "Slots",
    "active_features",
    "load_state",
    "log_sum_exp",
    "save_state",
]

FORMAT = "hapslam-gaussian-state/3"
NOWHERE_M = 1e4  # coordinates of unknown anchors and of the VRPs of empty slots


class _Value:
    """A frozen dataclass of which many copies are made."""

    @classmethod
    def of(cls, columns: dict[str, Any]) -> Self:
        """An instance with all of these fields."""
        value = object.__new__(cls)
        value.__dict__.update(columns)
        return value

    def but(self, **changes: Any) -> Self:
        """The same with some fields changed: :func:`dataclasses.replace` at a fraction of its cost."""
        return self.of(self.__dict__ | changes)


@dataclass(frozen=True, eq=False)
class Rows(_Value):
    """Hypotheses, one per row, each with one joint Gaussian.

    Shapes: R rows, K anchors, L wall slots, F features per anchor, n the length of
    the state vector (:class:`estimator.slam.layout.Layout`).

    Parameters
    ----------
    log_weight : ndarray, shape (R,)
        Log weights; normalised between epochs, the likeliest row first.
    mean : ndarray, shape (R, n)
        Means, metres in the gauge frame.
    covariance : ndarray, shape (R, n, n)
        Covariances.
    located : ndarray of bool, shape (R, K)
        Anchors that have been located.
    present : ndarray of bool, shape (R, L)
        Walls that the hypothesis has.
    visibility : ndarray, shape (R, K, F)
        Probability that a feature can be heard at present.
    support : ndarray of int64, shape (R, L)
        Epochs in which each wall was heard since it entered.
    """

    log_weight: NDArray[np.float64]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    located: NDArray[np.bool_]
    present: NDArray[np.bool_]
    visibility: NDArray[np.float64]
    support: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.log_weight)

    @property
    def best(self) -> int:
        """Index of the likeliest row."""
        return int(np.argmax(self.log_weight))

    def take(self, index: NDArray[np.int64] | list[int]) -> Rows:
        """Copies of the rows at ``index``, in that order."""
        return Rows(*(getattr(self, entry.name)[index] for entry in fields(self)))

    def parts(self, bounds: Sequence[tuple[int, int]]) -> list[Rows]:
        """Rows from each begin to each end, as views."""
        columns = [[column[i:j] for i, j in bounds] for column in self.__dict__.values()]
        return [Rows.of(dict(zip(self.__dict__, each, strict=True))) for each in zip(*columns, strict=True)]

    def joined(self, other: Rows) -> Rows:
        """These rows and then those of ``other``."""
        pairs = ((getattr(self, entry.name), getattr(other, entry.name)) for entry in fields(self))
        return Rows(*(np.concatenate(pair) for pair in pairs))

    def keep(self, mask: NDArray[np.bool_]) -> Rows:
        """The marked rows, weights normalised."""
        rows = self.take(np.flatnonzero(mask))
        rows.log_weight[...] -= log_sum_exp(rows.log_weight)
        return rows


def log_sum_exp(values: NDArray[np.float64]) -> float:
    """``log(sum(exp(values)))`` of a vector, without overflow; SciPy's takes ten times as long on a few."""
    largest = float(values.max())
    return largest + float(np.log(np.exp(values - largest).sum()))


@dataclass(frozen=True, eq=False)
class Slots(_Value):
    """What all rows agree on about the wall slots.

    Parameters
    ----------
    wall_id : ndarray of int64, shape (L,)
        Identity of the wall in each slot, -1 for an empty slot.
    born : ndarray of int64, shape (L,)
        Epoch at which it entered, -1 for the walls known from the start.
    confirmed : ndarray of bool, shape (L,)
        Whether it counts as found.
    span_m : ndarray, shape (L, 2)
        Stretch along the wall on which reflections were heard: signed distances from
        the foot of RP, metres; empty is (inf, -inf).
    owner : ndarray of int64, shape (L,)
        The anchor whose virtual anchor the slot holds; -1 for a wall, common to all.
    heard_from_m : ndarray, shape (L, K, 2, 2)
        Where the agent was when it first and when it last heard each anchor over the wall, gauge frame,
        metres; NaN before.
    """

    wall_id: NDArray[np.int64]
    born: NDArray[np.int64]
    confirmed: NDArray[np.bool_]
    span_m: NDArray[np.float64]
    owner: NDArray[np.int64]
    heard_from_m: NDArray[np.float64]

    @property
    def pending(self) -> NDArray[np.int64]:
        """Slots with a wall that is not confirmed."""
        return np.flatnonzero((self.wall_id >= 0) & ~self.confirmed)

    def copy(self) -> Slots:
        """A copy whose arrays may be changed."""
        return Slots(*(getattr(self, entry.name).copy() for entry in fields(self)))


@dataclass(frozen=True, eq=False)
class GaussianState(_Value):
    """Hypotheses and what the next steps need of the past.

    Parameters
    ----------
    anchor_names : tuple of str
        The K anchors.
    carrier_hz : float
        Carrier frequency, hertz.
    bearing_rad : float
        Expected direction of the gauge frame's x axis in the estimator's frame.
    epoch : int
        Last epoch taken in, -1 before the first.
    time_s : float
        Its time, seconds.
    log_evidence : float
        Log of the evidence of all epochs over "all is clutter".
    next_wall_id : int
        Identity that the next new wall gets.
    shared : bool
        Whether features are walls common to all anchors, or else virtual anchors of each.
    rows : Rows
        Hypotheses on associations and walls.
    slots : Slots
        The wall slots.
    trail : ndarray, shape (W, 4)
        Recent epochs of the best row: epoch, x, y, position standard deviation.
    heard : ndarray, shape (N, 6)
        Recent paths: epoch, anchor, length, its standard deviation, loss in excess of
        free space in dB (NaN if powers are unknown), 1 if nothing explained it or else 0.
    levels_db : ndarray, shape (K, 2, 2)
        Mean and variance of each anchor's loss beyond free space: in line of sight (not zero where its
        gain is not known), and beyond that in a bounce at normal incidence
        (:mod:`estimator.slam.gaussian.levels`).
    """

    anchor_names: tuple[str, ...]
    carrier_hz: float
    bearing_rad: float
    epoch: int
    time_s: float
    log_evidence: float
    next_wall_id: int
    shared: bool
    rows: Rows
    slots: Slots
    trail: NDArray[np.float64]
    heard: NDArray[np.float64]
    levels_db: NDArray[np.float64]

    @property
    def layout(self) -> Layout:
        """Positions in the state vector."""
        return Layout.of(len(self.anchor_names), len(self.slots.wall_id), self.shared)

    @property
    def loose(self) -> NDArray[np.float64]:
        """The rows (N, 5) of ``heard`` that nothing explained."""
        return self.heard[self.heard[:, 5] == 1.0, :5]

    @property
    def blind(self) -> bool:
        """Whether no wall is known yet."""
        return not self.slots.confirmed.any()

    def active(self) -> NDArray[np.bool_]:
        """Features (R, K, F) that each row has; pairs need two walls that count as found."""
        slots, rows = self.slots, self.rows
        return active_features(rows.located, rows.present, slots.confirmed, slots.owner, self.shared)


def active_features(
    located: NDArray[np.bool_],
    present: NDArray[np.bool_],
    confirmed: NDArray[np.bool_],
    owner: NDArray[np.int64],
    shared: bool,
) -> NDArray[np.bool_]:
    """Features (R, K, F) of rows with the anchors ``located`` (R, K) and the walls ``present`` (R, L).

    What is ``confirmed``, and the ``owner`` of slots, are (L,), or (R, L) for rows of several runs.
    """
    if not shared:
        own = owner[..., None, :] == np.arange(located.shape[1])[:, None]
        points = present[:, None, :] & own
        direct = np.ones((*points.shape[:2], 1), dtype=bool)
        return np.asarray(located[:, :, None] & np.concatenate([direct, points], axis=2))
    found = present & confirmed
    pairs = (found[:, :, None] & found[:, None, :]).reshape(len(present), -1)
    features = np.concatenate([np.ones((len(present), 1), dtype=bool), present, pairs], axis=1)
    return np.asarray(located[:, :, None] & features[:, None, :])


_SCALARS = ("carrier_hz", "bearing_rad", "epoch", "time_s", "log_evidence", "next_wall_id", "shared")
_ARRAYS = ("trail", "heard", "levels_db")


def save_state(state: GaussianState) -> bytes:
    """The state as bytes (an npz archive without pickles); equal states give equal bytes."""
    columns = {name: getattr(state, name) for name in (*_SCALARS, *_ARRAYS, "anchor_names")}
    columns |= {f"rows.{entry.name}": getattr(state.rows, entry.name) for entry in fields(Rows)}
    columns |= {f"slots.{entry.name}": getattr(state.slots, entry.name) for entry in fields(Slots)}
    return pack(FORMAT, columns)


def load_state(data: bytes) -> GaussianState:
    """The state that :func:`save_state` made ``data`` from.

    Raises
    ------
    FileFormatError
        If ``data`` is truncated or something else.
    """

    def build(columns: Columns) -> GaussianState:
        return GaussianState(
            anchor_names=tuple(str(name) for name in columns["anchor_names"]),
            rows=Rows(*(columns[f"rows.{entry.name}"] for entry in fields(Rows))),
            slots=Slots(*(columns[f"slots.{entry.name}"] for entry in fields(Slots))),
            **{name: columns[name].item() for name in _SCALARS},
            **{name: columns[name] for name in _ARRAYS},
        )

    return unpack(FORMAT, data, build)
