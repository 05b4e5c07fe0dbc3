"""The state of the Gaussian engine: a value that can be saved and loaded bit for bit."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.slam.archive import Columns, pack, unpack
from estimator.slam.gaussian.integrity import Indicators
from estimator.slam.gaussian.recalled_track import RecalledTrack
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.noise_level import Levels
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.models.state_vector import Layout

__all__ = ["GaussianState", "Slots", "load_state", "save_state"]

Array = NDArray[np.float64]
FORMAT = "hapslam-gaussian-state/12"


class Slots(NamedTuple):
    """What all hypotheses agree on about the slots of walls or virtual anchors.

    Parameters
    ----------
    wall_id : ndarray of int64, shape (L,)
        Identity of the wall in each slot, -1 for an empty slot.
    born : ndarray of int64, shape (L,)
        Epoch at which it entered, -1 for the walls known from the start.
    confirmed : ndarray of bool, shape (L,)
        Whether it counts as found; else it is tentative.
    extent_m : ndarray, shape (L, 2)
        Stretch along the wall on which reflections were detected: signed distances from
        the foot of RP, metres; empty is (inf, -inf).
    owner : ndarray of int64, shape (L,)
        The anchor whose virtual anchor the slot holds; -1 for a wall, common to all.
    detected_from_m : ndarray, shape (L, K, 2, 2)
        Where the agent was when each anchor was first and last detected over the wall, gauge frame,
        metres; NaN before.
    log_odds : ndarray, shape (L,)
        Log odds that it exists, of detections and misses where it should have been detected.
    swept : ndarray of int64, shape (L,)
        Sweeps that showed it.
    flash_m : ndarray, shape (L, 2, 2, 2)
        Where the agent and its mirror image in the wall were when a sweep first showed it, and when one last
        did, gauge frame, metres; NaN if none did.
    """

    wall_id: NDArray[np.int64]
    born: NDArray[np.int64]
    confirmed: NDArray[np.bool_]
    extent_m: Array
    owner: NDArray[np.int64]
    detected_from_m: Array
    log_odds: Array
    swept: NDArray[np.int64]
    flash_m: Array

    @property
    def tentative(self) -> NDArray[np.int64]:
        """Slots with a wall that is not confirmed."""
        return np.flatnonzero((self.wall_id >= 0) & ~self.confirmed)

    def copy(self) -> Slots:
        """A copy whose arrays may be changed."""
        return Slots._make([column.copy() for column in self])


class Outset(NamedTuple):
    """The Gaussian that a run began with, until it is known whether something tells its way.

    Parameters
    ----------
    mean, covariance : ndarray, shape (n,), (n, n)
        The Gaussian; empty once it is of no more use.
    located : ndarray of bool, shape (K,)
        Anchors that were known.
    """

    mean: Array
    covariance: Array
    located: NDArray[np.bool_]

    @classmethod
    def gone(cls, anchors: int) -> Outset:
        """None any more."""
        return cls(np.empty(0), np.empty((0, 0)), np.zeros(anchors, dtype=np.bool_))


class GaussianState(NamedTuple):
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
    hypotheses : Hypotheses
        Hypotheses on associations and walls.
    slots : Slots
        What they agree on about walls.
    buffer : PathBuffer
        The recent track and its paths.
    surveyed : PathBuffer
        Places of the track as far as it is known, and their paths, for surveys of anchors.
    recalled : RecalledTrack
        The same places as they are known by now.
    swept_epoch : int
        The last epoch with a sweep, the first of the run where there was none since.
    tracked_epoch : int
        The last epoch on the way whose motion sweeps or odometry told, -1 if none was.
    echo_residuals : ndarray, shape (2, 2)
        Sum of the squared residuals of flashes over what is claimed of them, and what it should be: in range,
        then in direction, of the recent sweeps.
    indicators : Indicators
        Signs of whether the run is right (:mod:`estimator.slam.gaussian.integrity`).
    first_time_s : float
        Time of the first epoch, seconds.
    outset : Outset
        What the run began with.
    losses_db : ndarray, shape (K, 2, 2)
        Losses of each anchor's paths (:mod:`estimator.slam.models.path_loss`).
    levels : Levels
        What is believed of each anchor's noise.
    """

    anchor_names: tuple[str, ...]
    carrier_hz: float
    bearing_rad: float
    epoch: int
    time_s: float
    log_evidence: float
    next_wall_id: int
    shared: bool
    hypotheses: Hypotheses
    slots: Slots
    buffer: PathBuffer
    surveyed: PathBuffer
    recalled: RecalledTrack
    swept_epoch: int
    tracked_epoch: int
    echo_residuals: Array
    indicators: Indicators
    first_time_s: float
    outset: Outset
    losses_db: Array
    levels: Levels

    @property
    def layout(self) -> Layout:
        """Positions in the state vector."""
        return Layout(len(self.anchor_names), len(self.slots.wall_id), self.shared)

    @property
    def blind(self) -> bool:
        """Whether no wall is known yet."""
        return not self.slots.confirmed.any()

    def swept_within(self, epochs: int) -> bool:
        """Whether the latest sweep, or the start, is no more than so many epochs ago."""
        return self.epoch - self.swept_epoch <= epochs

    def but(self, **changes: Any) -> GaussianState:
        """The same with some fields changed."""
        return self._replace(**changes)


_SCALARS = (
    "carrier_hz",
    "bearing_rad",
    "epoch",
    "time_s",
    "log_evidence",
    "next_wall_id",
    "shared",
    "swept_epoch",
    "tracked_epoch",
    "first_time_s",
)


def save_state(state: GaussianState) -> bytes:
    """The state as bytes (without pickles); equal states give equal bytes."""
    columns: dict[str, Any] = {
        name: getattr(state, name) for name in (*_SCALARS, "echo_residuals", "losses_db", "anchor_names")
    }
    columns["indicators"] = np.array(state.indicators)
    columns |= {f"hypotheses.{name}": getattr(state.hypotheses, name) for name in Hypotheses._fields}
    columns |= {f"slots.{name}": getattr(state.slots, name) for name in Slots._fields}
    columns |= {f"levels.{name}": getattr(state.levels, name) for name in Levels._fields}
    columns |= {f"outset.{name}": getattr(state.outset, name) for name in Outset._fields}
    columns |= {f"recalled.{name}": getattr(state.recalled, name) for name in RecalledTrack._fields}
    columns |= state.buffer.columns("buffer") | state.surveyed.columns("surveyed")
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
            hypotheses=Hypotheses(*(columns[f"hypotheses.{name}"] for name in Hypotheses._fields)),
            slots=Slots(*(columns[f"slots.{name}"] for name in Slots._fields)),
            buffer=PathBuffer.of_columns(columns, "buffer"),
            surveyed=PathBuffer.of_columns(columns, "surveyed"),
            recalled=RecalledTrack(*(columns[f"recalled.{name}"] for name in RecalledTrack._fields)),
            outset=Outset(*(columns[f"outset.{name}"] for name in Outset._fields)),
            losses_db=columns["losses_db"],
            echo_residuals=columns["echo_residuals"],
            indicators=Indicators(*columns["indicators"].tolist()),
            levels=Levels(*(columns[f"levels.{name}"] for name in Levels._fields)),
            **{name: columns[name].item() for name in _SCALARS},
        )

    return unpack(FORMAT, data, build)
