"""Powers that were measured along a track: the sum of an anchor's paths in each epoch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import MeasurementSet

__all__ = ["measured_powers_db"]


def measured_powers_db(measurements: MeasurementSet) -> NDArray[np.float64]:
    """Sum of the powers of all measured paths, shape (T, K), dB over the EIRP; NaN where none has a gain."""
    power = np.full((len(measurements.epochs), len(measurements.anchors)), np.nan)
    for t, epoch in enumerate(measurements.epochs):
        for k, paths in enumerate(epoch.paths):
            if paths.gain_db is not None and len(paths):
                power[t, k] = 10.0 * np.log10(np.sum(10.0 ** (paths.gain_db / 10.0)))
    return power
