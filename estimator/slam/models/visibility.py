"""Visibility: the probability that a feature can be heard at present, a two-state Markov chain of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.models.settings import Settings, probability
from estimator.slam.models.state_vector import Layout

__all__ = ["Visibility", "prior_visibility"]


@dataclass(frozen=True)
class Visibility(Settings):
    """How features appear and vanish.

    Parameters
    ----------
    appear_probability, vanish_probability : float
        Per epoch, that an invisible feature becomes visible and the reverse.
    prior_sight, prior_wall, prior_pair : float
        That a line of sight, a bounce off a wall, and a double bounce is visible when it is first asked for.
    """

    appear_probability: float = probability(0.01)
    vanish_probability: float = probability(0.01)
    prior_sight: float = probability(0.9)
    prior_wall: float = probability(0.6)
    prior_pair: float = probability(0.1)


def prior_visibility(layout: Layout, model: Visibility) -> NDArray[np.float64]:
    """Prior visibility (F,) of an anchor's features."""
    prior = [model.prior_sight, model.prior_wall, model.prior_pair]
    return np.repeat(prior, [1, layout.slots, layout.pairs])
