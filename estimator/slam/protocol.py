"""The step protocol: what every engine offers, and every caller uses.

A run is a fold: ``state = start(prior)``, then ``state = step(state, epoch, rng)`` for
each epoch, with ``estimate(state)`` whenever someone asks. States are values, which
``save`` and ``load`` keep bit for bit. The generator of an epoch's randomness depends on
the seed and the epoch's index alone (:func:`epoch_rng`), so that a run may be broken
off and taken up anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import Epoch, GaussianVrp, MeasurementSet

__all__ = [
    "INTEGRITY_STATES",
    "LEAST_WEIGHT",
    "MOST",
    "Candidate",
    "Engine",
    "Estimate",
    "Integrity",
    "Prior",
    "epoch_rng",
    "stacked_candidates",
]

Array = NDArray[np.float64]
INTEGRITY_STATES = ("ok", "doubtful", "lost")  # as numbers in files; unknown is -1
MOST = 8  # candidates told of an estimate
LEAST_WEIGHT = 1e-3  # of a candidate worth telling


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way that things may be.

    Parameters
    ----------
    weight : float
        Its probability.
    agent_m : ndarray, shape (2,)
        The agent, metres, estimator's frame.
    wall_id : ndarray of int64, shape (J,)
        The walls that it has, those not found yet included.
    wall_mean_m : ndarray, shape (J, 2)
        Their VRPs.
    """

    weight: float
    agent_m: NDArray[np.float64]
    wall_id: NDArray[np.int64]
    wall_mean_m: NDArray[np.float64]


@dataclass(frozen=True)
class Integrity:
    """Whether the estimate may be relied on.

    Parameters
    ----------
    state : str
        ``ok``, ``doubtful``, ``lost``, or ``unknown`` where the engine does not tell.
    probability : float
        Probability that the agent is within a metre of where it is thought to be; NaN if unknown.
    protection_level_m : float
        The error of the position is smaller with 99.9 % probability, metres; NaN if unknown.
    reasons : tuple of str
        What speaks against it.
    """

    state: str = "unknown"
    probability: float = float("nan")
    protection_level_m: float = float("nan")
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Estimate:
    """Agent, anchors and walls after an epoch.

    Parameters
    ----------
    agent_mean : ndarray, shape (4,)
        Position and velocity, estimator's frame.
    agent_covariance : ndarray, shape (4, 4)
        Covariance, the rotation of the map included.
    rotation_std_rad : float
        Standard deviation of the rotation of the map about RP.
    anchor_valid : ndarray of bool, shape (K,)
        Whether the anchor has been located in the likeliest hypothesis.
    anchor_mean_m, anchor_covariance_m2 : ndarray, shapes (K, 2) and (K, 2, 2)
        Anchors; NaN where not located.
    wall_id : ndarray of int64, shape (J,)
        Walls that count as found.
    wall_mean_m, wall_covariance_m2 : ndarray, shapes (J, 2) and (J, 2, 2)
        Their VRPs.
    hypotheses : int
        Number of hypotheses (or particles) behind the estimate.
    log_evidence : float
        Log of the evidence of all epochs so far.
    anchor_existence : ndarray, shape (K,)
        Probability that the anchor stands where it is said to, 0 where not located.
    wall_existence : ndarray, shape (J,)
        Probability that the wall exists, (35).
    candidates : tuple of Candidate
        The likeliest hypotheses one by one, the likeliest first; of engines that keep marginals
        alone, the walls not found yet, each with its probability of existence.
    integrity : Integrity
        Whether all this may be relied on.
    anchor_clock_m, anchor_height_m : ndarray, shape (K, 2), optional
        Each anchor's clock bias as a path length, and how far it stands above or below the agent, with
        standard deviations, metres; NaN where not located, None where the engine takes them as known.
    """

    agent_mean: Array
    agent_covariance: Array
    rotation_std_rad: float
    anchor_valid: NDArray[np.bool_]
    anchor_mean_m: Array
    anchor_covariance_m2: Array
    wall_id: NDArray[np.int64]
    wall_mean_m: Array
    wall_covariance_m2: Array
    hypotheses: int
    log_evidence: float
    anchor_existence: Array
    wall_existence: Array
    candidates: tuple[Candidate, ...]
    integrity: Integrity = Integrity()
    anchor_clock_m: Array | None = None
    anchor_height_m: Array | None = None


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known before the first epoch.

    Parameters
    ----------
    anchor_names : tuple of str
        The anchors that epochs report on, in order.
    walls : tuple of GaussianVrp
        Walls sensed at the start, estimator's frame (RP at the origin).
    carrier_hz : float
        Carrier frequency, hertz.
    anchors_m : ndarray, shape (K, 2), optional
        Anchor positions, estimator's frame, where the method knows them.
    walls_known : bool
        Whether the walls are known, from a floor plan, and not sensed.
    sweeps : bool
        Whether sweeps come on the way: then a wall at the start is not needed.
    """

    anchor_names: tuple[str, ...]
    walls: tuple[GaussianVrp, ...]
    carrier_hz: float
    anchors_m: NDArray[np.float64] | None = None
    walls_known: bool = False
    sweeps: bool = False

    @classmethod
    def of(cls, measurements: MeasurementSet, walls: Sequence[GaussianVrp] | None = None) -> Prior:
        """The prior that a measurement set brings, with ``walls`` of a floor plan instead of sensed ones."""
        return cls(
            measurements.anchors,
            measurements.walls if walls is None else tuple(walls),
            measurements.carrier_hz,
            measurements.known_anchors_m,
            walls is not None,
            any(epoch.sweep for epoch in measurements.epochs),
        )


@runtime_checkable
class Engine(Protocol):
    """One way of doing inference, configured; holds no state of its own."""

    @property
    def name(self) -> str:
        """The engine's name."""
        ...

    def start(self, prior: Prior, rng: np.random.Generator) -> Any:
        """The state before the first epoch."""
        ...

    def step(self, state: Any, epoch: Epoch, rng: np.random.Generator) -> Any:
        """The state after one more epoch; the given state is not changed."""
        ...

    def estimate(self, state: Any) -> Estimate:
        """Agent, anchors and walls with covariances, estimator's frame."""
        ...

    def save(self, state: Any) -> bytes:
        """The state as bytes."""
        ...

    def load(self, data: bytes) -> Any:
        """The state that was saved, bit for bit."""
        ...


def epoch_rng(seed: int, index: int) -> np.random.Generator:
    """The generator of epoch ``index`` (-1 for the start) of the run with ``seed``."""
    return np.random.default_rng(np.random.SeedSequence([seed, index + 1]))


def stacked_candidates(told: Sequence[tuple[Candidate, ...]]) -> dict[str, NDArray[Any]]:
    """The candidates of all epochs as the arrays of a :class:`estimator.result.SlamResult`, by name."""
    epochs, most = len(told), max(map(len, told), default=0)
    ids = np.unique(np.concatenate([[], *(one.wall_id for found in told for one in found)])).astype(np.int64)
    weight, agent = np.full((epochs, most), np.nan), np.full((epochs, most, 2), np.nan)
    walls = np.full((epochs, most, ids.size, 2), np.nan)
    for t, found in enumerate(told):
        for c, one in enumerate(found):
            weight[t, c], agent[t, c] = one.weight, one.agent_m
            walls[t, c, np.searchsorted(ids, one.wall_id)] = one.wall_mean_m
    return {
        "candidate_weight": weight,
        "candidate_agent_m": agent,
        "candidate_wall_id": ids,
        "candidate_wall_mean_m": walls,
    }
