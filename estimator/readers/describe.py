"""What was understood of a file of measurements, for people."""

from __future__ import annotations

import numpy as np

from estimator.measurements import MeasurementSet

__all__ = ["described"]


def described(measurements: MeasurementSet) -> dict[str, str]:
    """Facts of a measurement set, by their names, in the order in which they are told.

    Parameters
    ----------
    measurements : MeasurementSet
        What a reader made of a file.
    """
    epochs = measurements.epochs
    time = np.array([epoch.time_s for epoch in epochs])
    step = np.diff(time)
    stated = measurements.settings.get("measurement_model", {})
    start = measurements.settings.get("start_m")
    facts = {
        "epochs": f"{len(epochs)} in {time[-1] - time[0]:.1f} s"
        + (f", median step {np.median(step):.4g} s, longest {step.max():.4g} s" if step.size else "")
    }
    for k, name in enumerate(measurements.anchors):
        own = [epoch.paths[k] for epoch in epochs if epoch.was_asked[k]]
        lengths = np.concatenate([np.zeros(0), *(paths.range_m for paths in own)])
        heard = sum(len(paths) > 0 for paths in own)
        text = f"asked {len(own)} times, heard {heard} times"
        if lengths.size:
            std = np.concatenate([paths.range_std_m for paths in own])
            text += (
                f", {lengths.min():.2f} to {lengths.max():.2f} m, standard deviation {np.median(std):.3f} m"
            )
        if any(paths.azimuth_rad is not None for paths in own):
            text += ", with directions"
        if any(paths.gain_db is not None for paths in own):
            text += ", with gains"
        facts[f"anchor {name}"] = text
    if start is not None:
        std = stated.get("start_std_m", 0.0)
        facts["start"] = f"({start[0]:.2f}, {start[1]:.2f}) m, known to {std:.2f} m"
    facts["settings"] = ", ".join(f"{name}={value:.4g}" for name, value in sorted(stated.items()))
    return facts
