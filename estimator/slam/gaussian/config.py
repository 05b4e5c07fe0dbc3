"""Configuration of the Gaussian engine: groups of settings, each beside the algorithm that it is for."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import NamedTuple

from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.association.gating import GateModel, Gating
from estimator.slam.gaussian.births.config import Births, VirtualBirths
from estimator.slam.gaussian.branching import Branching, BranchModel
from estimator.slam.gaussian.clock_guesses import ClockGuesses
from estimator.slam.gaussian.clutter import Clutter
from estimator.slam.gaussian.integrity import IntegrityModel
from estimator.slam.gaussian.lifecycle import Lifecycle
from estimator.slam.gaussian.map_search import Relocation
from estimator.slam.gaussian.phase import Phase, Phases
from estimator.slam.gaussian.reclassification import Reclassification
from estimator.slam.gaussian.sweep_update import SweepMatching
from estimator.slam.gaussian.update import Corrections, UpdateModel
from estimator.slam.mixture_reduction import ReduceModel, Reduction, reduction_model
from estimator.slam.models.clocks import Clocks
from estimator.slam.models.directions import Directions
from estimator.slam.models.motion import Motion
from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.models.noise_level import NoiseLevel
from estimator.slam.models.path_loss import PathLoss
from estimator.slam.models.settings import SettingGroups
from estimator.slam.models.state_vector import Layout
from estimator.slam.models.visibility import Visibility

__all__ = ["GaussianConfig", "Kernels"]


class Kernels(NamedTuple):
    """What compiled functions take of the configuration."""

    update: UpdateModel
    gates: GateModel
    branching: BranchModel


@dataclass(frozen=True)
class GaussianConfig(SettingGroups):
    """Models and limits of the Gaussian engine, in groups.

    Parameters
    ----------
    noise : MeasurementNoise
        Noise of path lengths, misses, clutter, heights and gains.
    clocks : Clocks
        Biases and scales of path lengths.
    clock_guesses : ClockGuesses
        Guesses of a bias that is new in every epoch.
    noise_level : NoiseLevel
        How far claimed deviations are believed.
    motion : Motion
        How the agent moves.
    visibility : Visibility
        How features appear and vanish.
    directions : Directions
        Directions of arrival.
    path_loss : PathLoss
        Powers of paths.
    gating : Gating
        Which features and measurements are looked at together.
    branching : Branching
        When hypotheses branch.
    corrections : Corrections
        How corrections are taken.
    sweeps : SweepMatching
        Flashes and walls.
    relocation : Relocation
        When the agent is looked for in the map.
    clutter : Clutter
        Intensity of unassociated paths.
    reclassification : Reclassification
        Which paths count as explained.
    anchors : AnchorSearchConfig
        The search for anchors.
    births : Births
        New walls.
    virtual_births : VirtualBirths
        New virtual anchors.
    reduction : Reduction
        Which hypotheses are kept.
    lifecycle : Lifecycle
        When walls are confirmed and deleted.
    phases : Phases
        What is different in the first epochs, and while no wall is known.
    integrity : IntegrityModel
        When a run is doubtful or lost.
    """

    noise: MeasurementNoise = field(default_factory=MeasurementNoise)
    clocks: Clocks = field(default_factory=Clocks)
    clock_guesses: ClockGuesses = field(default_factory=ClockGuesses)
    noise_level: NoiseLevel = field(default_factory=NoiseLevel)
    motion: Motion = field(default_factory=Motion)
    visibility: Visibility = field(default_factory=Visibility)
    directions: Directions = field(default_factory=Directions)
    path_loss: PathLoss = field(default_factory=PathLoss)
    gating: Gating = field(default_factory=Gating)
    branching: Branching = field(default_factory=Branching)
    corrections: Corrections = field(default_factory=Corrections)
    sweeps: SweepMatching = field(default_factory=SweepMatching)
    relocation: Relocation = field(default_factory=Relocation)
    clutter: Clutter = field(default_factory=Clutter)
    reclassification: Reclassification = field(default_factory=Reclassification)
    anchors: AnchorSearchConfig = field(default_factory=AnchorSearchConfig)
    births: Births = field(default_factory=Births)
    virtual_births: VirtualBirths = field(default_factory=VirtualBirths)
    reduction: Reduction = field(default_factory=Reduction)
    lifecycle: Lifecycle = field(default_factory=Lifecycle)
    phases: Phases = field(default_factory=Phases)
    integrity: IntegrityModel = field(default_factory=IntegrityModel)

    @cached_property
    def search(self) -> AnchorSearchConfig:
        """The search for anchors.

        In the plane, where heights are known to be none. Without patience, and from a place that one path
        tells for sure, where the clock of another epoch is another: what an epoch tells is lost if no anchor
        starts from it.
        """
        search = self.anchors
        if self.noise.height2_std_m2 == 0.0:
            search = replace(search, height_cells=0)
        if self.clocks.clock_free_std_m > 0.0:
            search = replace(search, start_patience=0, start_fresh=1)
        return search

    @cached_property
    def heard(self) -> MeasurementNoise:
        """Noise of paths whose deviations are those that are believed: a level may be below 1."""
        level = self.noise_level
        least = min(level.least_level, 1.0) if level.level_memory > 0.0 else 1.0
        return replace(self.noise, range_std_m=self.noise.range_std_m * least**0.5)

    @cached_property
    def kernels(self) -> Kernels:
        """The same as compiled functions take it."""
        branching = {entry.name: getattr(self.branching, entry.name) for entry in fields(self.branching)}
        return Kernels(
            UpdateModel(
                self.noise.detection_probability,
                self.directions.agree_rad,
                self.directions.direction_gate_sigma,
                self.corrections.most_turn_rad,
            ),
            GateModel(
                self.gating.gate_sigma,
                self.gating.pair_gate_std_m,
                self.gating.pair_margin,
                self.gating.bent_share,
                self.heard.range_std_m,
            ),
            BranchModel(**branching, pair_std_m=self.gating.pair_std_m),
        )

    def reduce_model(self, phase: Phase, layout: Layout) -> ReduceModel:
        """What mixture reduction takes, in a phase of a run."""
        return reduction_model(
            self.reduction, layout, phase.prune_nats, phase.unlikely_sigma, self.reduction.max_hypotheses
        )
