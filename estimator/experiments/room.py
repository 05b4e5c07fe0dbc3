"""The room of an experiment: walls, anchors and track, and the walls that the first sweep sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.geometry import vrp_of_line
from estimator.measurements import MeasurementSet
from estimator.simulate import SimulationConfig, measure_scene, walls_in_view
from estimator.slam.bounds.scenario import Scenario

__all__ = ["Room", "make_room"]

Array = NDArray[np.float64]

_PAPER_VRPS_M = np.array([[-10.0, 15.0], [10.0, 65.0], [150.0, 15.0], [10.0, -15.0]])  # Section V-E1
_PAPER_VARIANCES_M2 = (0.08, 0.7, 4.0, 0.2)
_LEAST_EPOCHS = 20  # a wall that reflects in fewer need not be found


@dataclass(frozen=True, eq=False)
class Room:
    """What is true in an experiment.

    Parameters
    ----------
    name : str
        Name of the scene.
    scenario : Scenario
        Walls, anchors and track; the walls sensed at the start come first.
    sensed_variances_m2 : tuple of float
        Variance per axis of the VRPs sensed at the start, square metres: those of the first walls.
    carrier_hz : float
        Carrier frequency, hertz.
    """

    name: str
    scenario: Scenario
    sensed_variances_m2: tuple[float, ...]
    carrier_hz: float

    @property
    def steps(self) -> int:
        """Number of epochs."""
        return len(self.scenario.track_m)

    @property
    def sensed(self) -> dict[int, float]:
        """Walls sensed at the start and their variances."""
        return dict(enumerate(self.sensed_variances_m2))

    @cached_property
    def track_m(self) -> Array:
        """Positions relative to RP, shape (T, 2), metres."""
        return np.asarray(self.scenario.track_m - self.scenario.track_m[0])

    @cached_property
    def anchors_m(self) -> Array:
        """Anchors relative to RP, shape (K, 2), metres."""
        return np.asarray(self.scenario.anchors_m - self.scenario.track_m[0])

    @cached_property
    def reflects(self) -> NDArray[np.bool_]:
        """Whether a path over one bounce on the wall reaches the agent from any anchor, shape (T, L)."""
        walls = len(self.scenario.start_m)
        return np.asarray(np.any(self.scenario.visible(1)[:, :, 1 : 1 + walls], axis=1))

    @cached_property
    def walls_due(self) -> NDArray[np.bool_]:
        """Walls that a map should have, shape (T, L): sensed at the start, or reflecting by then.

        Walls that reflect in passing only (fewer than 20 epochs) do not count.
        """
        walls = self.reflects.shape[1]
        often = self.reflects.sum(axis=0) >= _LEAST_EPOCHS
        sensed = np.arange(walls) < len(self.sensed_variances_m2)
        return np.asarray((np.logical_or.accumulate(self.reflects) & often) | sensed)

    def measure(self, config: SimulationConfig, seed: int, know_anchors: bool = False) -> MeasurementSet:
        """Simulated measurements of a run; equal seeds give equal paths and walls."""
        truth = self.scenario
        return measure_scene(
            truth.start_m,
            truth.end_m,
            truth.anchors_m,
            truth.track_m,
            self.sensed_variances_m2,
            self.carrier_hz,
            config,
            np.random.default_rng(seed),
            know_anchors=know_anchors,
            paths=truth.paths(config.order),
        )


def make_room(
    name: str,
    start_m: ArrayLike,
    end_m: ArrayLike,
    anchors_m: ArrayLike,
    track_m: ArrayLike,
    carrier_hz: float = 28e9,
    step_s: float = 1.0,
) -> Room:
    """A room whose first sweep sees the walls in view of the start.

    If these are the paper's four, told by their VRPs, they get the variances of Section V-E1;
    otherwise a variance per axis of 8.9e-4 of the wall's squared distance, the law that those follow.

    Parameters
    ----------
    name : str
        Name of the scene.
    start_m, end_m : array_like, shape (L, 2)
        End points of the walls, metres.
    anchors_m : array_like, shape (K, 2)
        Anchors, metres.
    track_m : array_like, shape (T, 2)
        The agent at every epoch, metres; the first is RP.
    carrier_hz : float
        Carrier frequency, hertz.
    step_s : float
        Time between epochs, seconds.

    Raises
    ------
    InputError
        If an array is empty, not finite or of another shape.
    """
    start, end, anchors, track = (
        np.asarray(points, dtype=np.float64) for points in (start_m, end_m, anchors_m, track_m)
    )
    plan = Scenario(start, end, anchors, track, step_s)
    reference = plan.track_m[0]
    vrps = vrp_of_line(plan.start_m, plan.end_m, reference)
    seen = walls_in_view(plan.start_m, plan.end_m, reference)
    variances = [
        SimulationConfig().sweep_variance * 0.25 * float(np.sum((vrps[wall] - reference) ** 2))
        for wall in seen
    ]
    if len(seen) == len(_PAPER_VRPS_M):
        gap = np.linalg.norm(vrps[seen][:, None] - _PAPER_VRPS_M, axis=-1)
        paper = np.argmin(gap, axis=0)
        if np.all(gap[paper, np.arange(len(seen))] < 1e-6):
            seen, variances = [seen[i] for i in paper], list(_PAPER_VARIANCES_M2)
    order = [*seen, *(wall for wall in range(len(vrps)) if wall not in seen)]
    scenario = Scenario(plan.start_m[order], plan.end_m[order], plan.anchors_m, plan.track_m, step_s)
    return Room(name, scenario, tuple(variances), carrier_hz)
