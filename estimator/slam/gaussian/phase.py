"""The phase of a run: first epochs, no wall known, settled. Computed once an epoch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.gaussian.lifecycle import Lifecycle
from estimator.slam.mixture_reduction import Reduction
from estimator.slam.models.settings import Settings, positive

__all__ = ["Phase", "Phases", "phase_of"]


@dataclass(frozen=True)
class Phases(Settings):
    """What is different in the first epochs, and while no wall is known.

    Parameters
    ----------
    first_epochs : int
        Epochs in which more places of the anchors are kept:
    first_room : int
        as many times as many places and hypotheses.
    blind_support : int
        While no wall is known, one needs as many times the support,
    blind_patience : float
        and hypotheses are dropped as many times as late: the first wall decides on all others.
    """

    first_epochs: int = positive(8)
    first_room: int = positive(2)
    blind_support: int = positive(2)
    blind_patience: float = positive(3.0)


class Phase(NamedTuple):
    """Limits of an epoch.

    Parameters
    ----------
    prune_nats, unlikely_sigma, max_hypotheses
        Those of :class:`estimator.slam.mixture_reduction.Reduction`.
    confirm_support : int
        That of :class:`estimator.slam.gaussian.lifecycle.Lifecycle`.
    anchors : AnchorSearchConfig
        Limits of the search for anchors.
    """

    prune_nats: float
    unlikely_sigma: float
    max_hypotheses: int
    confirm_support: int
    anchors: AnchorSearchConfig


def phase_of(
    epochs: int,
    blind: bool,
    phases: Phases,
    reduction: Reduction,
    lifecycle: Lifecycle,
    anchors: AnchorSearchConfig,
) -> Phase:
    """The phase of a run after so many epochs, ``blind`` while no wall is known."""
    first = epochs < phases.first_epochs
    return Phase(
        reduction.prune_nats * (phases.blind_patience if blind else 1.0),
        reduction.alike_sigma if first else reduction.unlikely_sigma,
        reduction.max_hypotheses * (phases.first_room if first else 1),
        lifecycle.confirm_support * (phases.blind_support if blind else 1),
        anchors.widened() if first else anchors,
    )
