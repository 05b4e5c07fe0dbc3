"""The state of the Gaussian engine: a value that can be saved and loaded bit for bit."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from estimator.slam.layout import Layout

__all__ = ["GaussianState", "load_state", "save_state"]

FORMAT = "hapslam-gaussian-state/1"


@dataclass(frozen=True, eq=False)
class GaussianState:
    """Hypotheses (rows) on associations and walls, each with one joint Gaussian.

    Shapes: R rows, K anchors, L wall slots, F features per anchor, n the length of
    the state vector (:class:`estimator.slam.layout.Layout`). Positions are metres in
    the gauge frame.

    Parameters
    ----------
    anchor_names : tuple of str
        The K anchors.
    bearing_rad : float
        Expected direction of the gauge frame's x axis in the estimator's frame.
    epoch : int
        Last epoch taken in, -1 before the first.
    time_s : float
        Its time, seconds.
    carrier_hz : float
        Carrier frequency, hertz.
    log_evidence : float
        Log of the evidence of all epochs.
    log_weight : ndarray, shape (R,)
        Normalised log weights of the hypotheses, descending.
    mean : ndarray, shape (R, n)
        Means.
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
    wall_id : ndarray of int64, shape (L,)
        Identity of the wall in each slot, -1 for an empty slot.
    wall_epoch : ndarray of int64, shape (L,)
        Epoch at which it entered, -1 for the walls known from the start.
    confirmed : ndarray of bool, shape (L,)
        Whether it counts as found.
    span_m : ndarray, shape (L, 2)
        Stretch along the wall on which reflections were heard: signed distances from
        the foot of RP, metres; empty is (inf, -inf).
    trail : ndarray, shape (W, 6)
        Recent epochs of the best row: epoch, x, y, position standard deviation, vx, vy.
    loose : ndarray, shape (N, 5)
        Recent unexplained paths: epoch, anchor, length, its standard deviation, loss
        in excess of free space in dB (NaN if powers are unknown).
    """

    anchor_names: tuple[str, ...]
    bearing_rad: float
    epoch: int
    time_s: float
    carrier_hz: float
    log_evidence: float
    log_weight: NDArray[np.float64]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    located: NDArray[np.bool_]
    present: NDArray[np.bool_]
    visibility: NDArray[np.float64]
    support: NDArray[np.int64]
    wall_id: NDArray[np.int64]
    wall_epoch: NDArray[np.int64]
    confirmed: NDArray[np.bool_]
    span_m: NDArray[np.float64]
    trail: NDArray[np.float64]
    loose: NDArray[np.float64]

    @property
    def layout(self) -> Layout:
        """Positions in the state vector."""
        return Layout(len(self.anchor_names), len(self.wall_id))


_ROWS = ("log_weight", "mean", "covariance", "located", "present", "visibility", "support")


def take_rows(state: GaussianState, rows: NDArray[np.int64]) -> dict[str, NDArray[np.generic]]:
    """The row arrays of ``state`` at ``rows``, by name."""
    return {name: getattr(state, name)[rows] for name in _ROWS}


def save_state(state: GaussianState) -> bytes:
    """The state as bytes (an npz archive without pickles); equal states give equal bytes."""
    columns = {}
    for entry in fields(state):
        value = getattr(state, entry.name)
        columns[entry.name] = np.asarray(value)
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, format=np.array(FORMAT), **columns)
    return stream.getvalue()


def load_state(data: bytes) -> GaussianState:
    """The state that :func:`save_state` made ``data`` from.

    Raises
    ------
    FileFormatError
        If ``data`` is truncated or something else.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            columns = {name: archive[name] for name in archive.files}
    except (ValueError, OSError, zipfile.BadZipFile, EOFError) as error:
        raise FileFormatError(f"state: expected {FORMAT}, could not read {len(data)} bytes: {error}") from error
    found = str(columns.pop("format", "nothing"))
    names = {entry.name for entry in fields(GaussianState)}
    if found != FORMAT or set(columns) != names:
        raise FileFormatError(f"state: expected {FORMAT} with {sorted(names)}, got {found} with {sorted(columns)}")
    return GaussianState(
        anchor_names=tuple(str(name) for name in columns.pop("anchor_names")),
        bearing_rad=float(columns.pop("bearing_rad")),
        epoch=int(columns.pop("epoch")),
        time_s=float(columns.pop("time_s")),
        carrier_hz=float(columns.pop("carrier_hz")),
        log_evidence=float(columns.pop("log_evidence")),
        **columns,
    )
