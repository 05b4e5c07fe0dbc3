"""All of a session given all of its measurements: the run smoothed, as a document."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from estimator.errors import InputError
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.threads import one_blas_thread
from service.messages.documents import dump
from service.session.results import map_document

__all__ = ["explained", "smoothed_document"]


@one_blas_thread()
def smoothed_document(
    measurements: MeasurementSet, result: SlamResult, start_frame: dict[str, Any] | None, lag: int
) -> str:
    """A run smoothed, as JSON; see :func:`estimator.slam.smoothing.refine.refine`.

    Parameters
    ----------
    measurements : MeasurementSet
        What a session has been sent.
    result : SlamResult
        What its engine made of it.
    start_frame : dict or None
        Where its agent starts in a floor plan, if it says so.
    lag : int
        Epochs that the smoother looks ahead; 0 for the whole run.

    Raises
    ------
    InputError
        If it cannot be smoothed: no wall was sensed at the start, or the measurements do not
        determine everything.
    """
    from estimator.slam.smoothing.refine import RefineConfig, refine

    with explained():
        smoothed = refine(measurements, result, config=RefineConfig(lag=lag))
        return dump(_document(smoothed, start_frame))


@contextmanager
def explained() -> Iterator[None]:
    """Numerical failures as what they are to a client: measurements that do not suffice."""
    try:
        yield
    except (ArithmeticError, np.linalg.LinAlgError, IndexError, ValueError) as error:
        raise InputError(f"expected measurements that determine the whole run: {error}") from error


def _document(result: SlamResult, start_frame: dict[str, Any] | None) -> dict[str, Any]:
    """The track as columns in the estimator's frame, and the map as ``GET .../map`` gives it."""
    mean, covariance = result.agent_mean, result.agent_covariance
    return {
        "trajectory": {
            "epoch": result.epoch.tolist(),
            "time_s": result.time_s.tolist(),
            "x_m": mean[:, 0].tolist(),
            "y_m": mean[:, 1].tolist(),
            "vx_m_s": mean[:, 2].tolist(),
            "vy_m_s": mean[:, 3].tolist(),
            "variance_x_m2": covariance[:, 0, 0].tolist(),
            "covariance_xy_m2": covariance[:, 0, 1].tolist(),
            "variance_y_m2": covariance[:, 1, 1].tolist(),
            "rotation_std_rad": result.rotation_std_rad.tolist(),
        },
        "map": map_document(result, start_frame),
    }
