"""A run of a measured set: what was measured, and the truth beside."""

from __future__ import annotations

from dataclasses import dataclass

from estimator.measurements import MeasurementSet
from estimator.readers.trajectories import Track

__all__ = ["MeasuredRun"]


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One run of a set.

    Parameters
    ----------
    key : str
        Its name; runs of one name are told together, by their medians.
    measurements : MeasurementSet
        What was measured.
    truth : Track
        The true track; its times are those of the measurements' epochs, but for an offset of clocks.
    clocks_differ : bool
        Whether that offset is unknown: then it is fitted, on the places of least squares.
    plain : MeasurementSet, optional
        What plain methods take instead.
    heading_rad : float
        Direction of the estimator's x axis in the frame of the truth.
    """

    key: str
    measurements: MeasurementSet
    truth: Track
    clocks_differ: bool = False
    plain: MeasurementSet | None = None
    heading_rad: float = 0.0
