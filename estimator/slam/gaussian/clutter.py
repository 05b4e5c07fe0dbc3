"""Clutter: how many paths are heard that no known feature gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.models.settings import Settings, not_negative, positive

__all__ = ["Clutter", "clutter_density"]


@dataclass(frozen=True)
class Clutter(Settings):
    """How the intensity of unassociated paths is learnt.

    Parameters
    ----------
    unknown_paths : float
        Paths expected of an anchor beyond clutter, an epoch, before any wall is known: most paths
        must not be taken for the line of sight.
    prior_epochs : float
        Epochs that the expectation weighs.
    least_density : float
        Smallest intensity, per metre.
    """

    unknown_paths: float = not_negative(6.0)
    prior_epochs: float = positive(4.0)
    least_density: float = positive(1e-12)


def clutter_density(
    buffer: PathBuffer, anchors: int, blind: bool, noise: MeasurementNoise, model: Clutter
) -> NDArray[np.float64]:
    """Intensity (K,) per metre of paths that no known feature gives: clutter, and walls not yet found.

    Parameters
    ----------
    buffer : PathBuffer
        Recent epochs tell how many there are.
    anchors : int
        Number of anchors K.
    blind : bool
        Whether no wall is known.
    noise : MeasurementNoise
        The expectation without a past.
    model : Clutter
        How it is learnt.
    """
    counts = np.bincount(buffer.anchor[buffer.unassociated], minlength=anchors)
    expected = noise.clutter_mean + (model.unknown_paths if blind else 0.0)
    rate = (counts + model.prior_epochs * expected) / (buffer.epochs + model.prior_epochs)
    return np.asarray(np.maximum(rate, noise.clutter_mean) / noise.region_m + model.least_density)
