"""The state of the particle engine: a value that can be saved and loaded bit for bit."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from estimator.slam.archive import Columns, pack, unpack
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.particle.cloud import Cloud

__all__ = ["Features", "ParticleState", "load_particle_state", "save_particle_state"]

FORMAT = "hapslam-particle-state/2"
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Features:
    """Walls (or virtual anchors) and the probabilities that they exist.

    Parameters
    ----------
    points_m : tuple of L ndarray of float32, shape (2, N)
        Particles: VRPs, or virtual anchors where ``owner`` names an anchor.
    existence : ndarray, shape (L,)
        Probability of existence, (35).
    visibility : ndarray, shape (L, K)
        Probability that each anchor can be heard over the feature at present.
    owner : ndarray of int64, shape (L,)
        The anchor that a virtual anchor belongs to; -1 for a wall, common to all.
    wall_id : ndarray of int64, shape (L,)
        Identity.
    born : ndarray of int64, shape (L,)
        Epoch of its first path, -1 if known from the start.
    """

    points_m: tuple[Cloud, ...]
    existence: Array
    visibility: Array
    owner: NDArray[np.int64]
    wall_id: NDArray[np.int64]
    born: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.existence)

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Features:
        """The features at ``index``."""
        chosen = np.arange(len(self))[index]
        columns = {name: getattr(self, name)[chosen] for name in COLUMNS}
        return Features(tuple(self.points_m[j] for j in chosen.tolist()), **columns)

    def joined(self, other: Features) -> Features:
        """These features and then those of ``other``."""
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in COLUMNS}
        columns = {name: np.concatenate(pair) for name, pair in pairs.items()}
        return Features(self.points_m + other.points_m, **columns)


COLUMNS = tuple(entry.name for entry in fields(Features) if entry.name != "points_m")
"""What :class:`Features` has beside the particles."""


@dataclass(frozen=True, eq=False)
class ParticleState:
    """Marginal beliefs of agent, anchors and features.

    Parameters
    ----------
    method : str
        The method that the state belongs to.
    anchor_names : tuple of str
        The K anchors.
    epoch : int
        Last epoch taken in, -1 before the first.
    time_s : float
        Its time, seconds.
    log_evidence : float
        Log of the evidence of all epochs over "all is clutter".
    next_wall_id : int
        Identity that the next new feature gets.
    agent : ndarray of float32, shape (4, N)
        Position and velocity, estimator's frame.
    anchors_m : tuple of K ndarray of float32, shape (2, N)
        Anchors; meaningless where not located.
    located : ndarray of bool, shape (K,)
        Whether the anchor has been located.
    sight : ndarray, shape (K,)
        Probability that the anchor is in sight at present.
    features : Features
        Walls or virtual anchors.
    buffer : PathBuffer
        Recent paths of anchors that are not located, and where the agent was.
    """

    method: str
    anchor_names: tuple[str, ...]
    epoch: int
    time_s: float
    log_evidence: float
    next_wall_id: int
    agent: Cloud
    anchors_m: tuple[Cloud, ...]
    located: NDArray[np.bool_]
    sight: Array
    features: Features
    buffer: PathBuffer

    @property
    def particles(self) -> int:
        """Particles of each node, N."""
        return int(self.agent.shape[1])


_SCALARS = ("method", "epoch", "time_s", "log_evidence", "next_wall_id")
_ARRAYS = ("agent", "located", "sight")


def save_particle_state(state: ParticleState) -> bytes:
    """The state as bytes (without pickles); equal states give equal bytes."""
    features = state.features
    columns = {name: getattr(state, name) for name in (*_SCALARS, *_ARRAYS, "anchor_names")}
    columns |= {f"features.{name}": getattr(features, name) for name in COLUMNS}
    columns["anchors_m"] = np.stack(state.anchors_m)
    columns["features.points_m"] = np.array(features.points_m).reshape(len(features), 2, state.particles)
    return pack(FORMAT, columns | state.buffer.columns("buffer"))


def load_particle_state(data: bytes) -> ParticleState:
    """The state that :func:`save_particle_state` made ``data`` from.

    Raises
    ------
    FileFormatError
        If ``data`` is truncated or something else.
    """

    def build(columns: Columns) -> ParticleState:
        return ParticleState(
            anchor_names=tuple(str(name) for name in columns["anchor_names"]),
            anchors_m=tuple(columns["anchors_m"]),
            features=Features(
                tuple(columns["features.points_m"]), **{name: columns[f"features.{name}"] for name in COLUMNS}
            ),
            buffer=PathBuffer.of_columns(columns, "buffer"),
            **{name: columns[name].item() for name in _SCALARS},
            **{name: columns[name] for name in _ARRAYS},
        )

    return unpack(FORMAT, data, build)
