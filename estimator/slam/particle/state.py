"""The state of the particle engine: a value that can be saved and loaded bit for bit."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.archive import Columns, pack, unpack
from estimator.slam.particle.cloud import Cloud

__all__ = ["Features", "ParticleState", "load_particle_state", "save_particle_state"]

FORMAT = "hapslam-particle-state/1"
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Features:
    """Walls (or virtual anchors) and the probabilities that they exist.

    Parameters
    ----------
    points_m : ndarray of float32, shape (L, 2, N)
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

    points_m: Cloud
    existence: Array
    visibility: Array
    owner: NDArray[np.int64]
    wall_id: NDArray[np.int64]
    born: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.existence)

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Features:
        """Copies of the features at ``index``."""
        return Features(*(getattr(self, entry.name)[index] for entry in fields(self)))

    def joined(self, other: Features) -> Features:
        """These features and then those of ``other``."""
        pairs = ((getattr(self, entry.name), getattr(other, entry.name)) for entry in fields(self))
        return Features(*(np.concatenate(pair) for pair in pairs))

    def copy(self) -> Features:
        """A copy whose arrays may be changed."""
        return Features(*(getattr(self, entry.name).copy() for entry in fields(self)))


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
    anchors_m : ndarray of float32, shape (K, 2, N)
        Anchors; meaningless where not located.
    located : ndarray of bool, shape (K,)
        Whether the anchor has been located.
    sight : ndarray, shape (K,)
        Probability that the anchor is in sight at present.
    features : Features
        Walls or virtual anchors.
    past : ndarray, shape (n, 7)
        Recent paths of anchors that are not located: epoch, agent x, y, its variance per
        axis, anchor, length, standard deviation.
    """

    method: str
    anchor_names: tuple[str, ...]
    epoch: int
    time_s: float
    log_evidence: float
    next_wall_id: int
    agent: Cloud
    anchors_m: Cloud
    located: NDArray[np.bool_]
    sight: Array
    features: Features
    past: Array

    @property
    def particles(self) -> int:
        """Particles of each node, N."""
        return int(self.agent.shape[1])

    def with_features(self, features: Features) -> ParticleState:
        """The state with other features."""
        return replace(self, features=features)


_SCALARS = ("method", "epoch", "time_s", "log_evidence", "next_wall_id")
_ARRAYS = ("agent", "anchors_m", "located", "sight", "past")


def save_particle_state(state: ParticleState) -> bytes:
    """The state as bytes (an npz archive without pickles); equal states give equal bytes."""
    columns = {name: getattr(state, name) for name in (*_SCALARS, *_ARRAYS, "anchor_names")}
    columns |= {f"features.{e.name}": getattr(state.features, e.name) for e in fields(Features)}
    return pack(FORMAT, columns)


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
            features=Features(*(columns[f"features.{entry.name}"] for entry in fields(Features))),
            **{name: columns[name].item() for name in _SCALARS},
            **{name: columns[name] for name in _ARRAYS},
        )

    return unpack(FORMAT, data, build)
