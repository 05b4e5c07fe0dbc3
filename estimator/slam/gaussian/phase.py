"""The phase of a run: first epochs, no wall known, settled. Computed once an epoch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

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
        Epochs in which unlikely hypotheses are merged no earlier than alike ones.
    blind_support : int
        While no wall is known, one needs as many times the support,
    blind_patience : float
        and hypotheses are dropped as many times as late: the first wall decides on all others.
    """

    first_epochs: int = positive(8)
    blind_support: int = positive(2)
    blind_patience: float = positive(3.0)


class Phase(NamedTuple):
    """Limits of an epoch.

    Parameters
    ----------
    prune_nats, unlikely_sigma : float
        Those of :class:`estimator.slam.mixture_reduction.Reduction`.
    confirm_support : int
        That of :class:`estimator.slam.gaussian.lifecycle.Lifecycle`.
    """

    prune_nats: float
    unlikely_sigma: float
    confirm_support: int


def phase_of(
    epochs: int,
    blind: bool,
    phases: Phases,
    reduction: Reduction,
    lifecycle: Lifecycle,
) -> Phase:
    """The phase of a run after so many epochs, ``blind`` while no wall is known."""
    first = epochs < phases.first_epochs
    return Phase(
        reduction.prune_nats * (phases.blind_patience if blind else 1.0),
        reduction.alike_sigma if first else reduction.unlikely_sigma,
        lifecycle.confirm_support * (phases.blind_support if blind else 1),
    )
