"""The step protocol: what every engine offers, and every caller uses.

A run is a fold: ``state = start(prior)``, then ``state = step(state, epoch, rng)`` for
each epoch, with ``estimate(state)`` whenever someone asks. States are values, which
``save`` and ``load`` keep bit for bit. The generator of an epoch's randomness depends on
the seed and the epoch's index alone (:func:`epoch_rng`), so that a run may be broken
off and taken up anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.slam.config import GaussianConfig
from estimator.slam.estimate import Estimate, estimate
from estimator.slam.gaussian.filter import step_many
from estimator.slam.gaussian.start import start
from estimator.slam.gaussian.state import GaussianState, load_state, save_state
from estimator.slam.methods import METHODS, Method

__all__ = ["Engine", "GaussianEngine", "Prior", "epoch_rng"]


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
    """

    anchor_names: tuple[str, ...]
    walls: tuple[GaussianVrp, ...]
    carrier_hz: float
    anchors_m: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, measurements: MeasurementSet) -> Prior:
        """The prior that a measurement set brings."""
        return cls(
            measurements.anchors, measurements.walls, measurements.carrier_hz, measurements.known_anchors_m
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


@dataclass(frozen=True)
class GaussianEngine:
    """The joint, gauge-separated Gaussian filter with hypotheses; draws no random numbers.

    Parameters
    ----------
    config : GaussianConfig
        Models and limits.
    method : Method
        What is known and sensed.
    """

    config: GaussianConfig
    method: Method = METHODS["hybrid"]
    name: str = "gaussian"

    @property
    def models(self) -> GaussianConfig:
        """The configuration; where no wall is sensed at the start, walls are confirmed later.

        The first walls are born from a track that only lines of sight have told, of which a
        mirror image explains most paths nearly as well.
        """
        if self.method.walls:
            return self.config
        return replace(
            self.config,
            birth_trust=0.5 * self.config.birth_trust,
            confirm_support=2 * self.config.confirm_support,
            confirm_weight=1.0 - 0.25 * (1.0 - self.config.confirm_weight),
        )

    def start(self, prior: Prior, rng: np.random.Generator) -> GaussianState:
        """See :func:`estimator.slam.gaussian.start.start`; raises InputError if known anchors are lacking."""
        known = self.method.anchors == "known"
        if known and prior.anchors_m is None:
            raise InputError(f"method {self.method.name}: expected known anchors, the measurements have none")
        return start(
            prior.walls if self.method.walls else (),
            prior.anchor_names,
            prior.carrier_hz,
            self.models,
            prior.anchors_m if known else None,
            self.method.shared,
        )

    def step(self, state: GaussianState, epoch: Epoch, rng: np.random.Generator) -> GaussianState:
        """See :func:`estimator.slam.gaussian.filter.step`; a method that hears no paths gets none."""
        return self.step_many([state], [epoch])[0]

    def step_many(self, states: Sequence[GaussianState], epochs: Sequence[Epoch]) -> list[GaussianState]:
        """The next epoch of each of several runs; see :func:`estimator.slam.gaussian.filter.step_many`."""
        if not self.method.paths:
            epochs = [replace(epoch, paths=(AnchorPaths.none(),) * len(epoch.paths)) for epoch in epochs]
        return step_many(states, epochs, self.models)

    def estimate(self, state: GaussianState) -> Estimate:
        """See :func:`estimator.slam.estimate.estimate`."""
        return estimate(state, self.models)

    def save(self, state: GaussianState) -> bytes:
        """See :func:`estimator.slam.gaussian.state.save_state`."""
        return save_state(state)

    def load(self, data: bytes) -> GaussianState:
        """See :func:`estimator.slam.gaussian.state.load_state`."""
        return load_state(data)


def epoch_rng(seed: int, index: int) -> np.random.Generator:
    """The generator of epoch ``index`` (-1 for the start) of the run with ``seed``."""
    return np.random.default_rng(np.random.SeedSequence([seed, index + 1]))
