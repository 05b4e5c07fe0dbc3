"""All of a session given all of its measurements: the run smoothed, in a worker process."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimator.errors import InputError
from estimator.result import SlamResult
from estimator.threads import one_blas_thread
from service.documents import dump, read_epoch, read_sweep
from service.fold import StateCache, measurement_set
from service.results import map_document

__all__ = ["SmoothTask"]


@dataclass(frozen=True)
class SmoothTask:
    """Smooth a run; see :func:`estimator.slam.smoothing.refine.refine`.

    Parameters
    ----------
    config : str
        The session's configuration, JSON.
    sweeps, epochs : tuple of str
        Its log.
    result : SlamResult
        What its engine made of it.
    lag : int
        Epochs that the smoother looks ahead; 0 for the whole run.
    """

    config: str
    sweeps: tuple[str, ...]
    epochs: tuple[str, ...]
    result: SlamResult
    lag: int

    @one_blas_thread()
    def run(self, cache: StateCache) -> str:
        """The smoothed run as a JSON document.

        Raises
        ------
        InputError
            If it cannot be smoothed: no wall was sensed at the start, or the measurements do not
            determine everything.
        """
        del cache
        from estimator.slam.smoothing.refine import RefineConfig, refine

        config = json.loads(self.config)
        walls = [wall for text in self.sweeps for wall in read_sweep(text)]
        measurements = replace(
            measurement_set(config, walls), epochs=tuple(read_epoch(text) for text in self.epochs)
        )
        with _explained():
            smoothed = refine(measurements, self.result, config=RefineConfig(lag=self.lag))
            return dump(_document(smoothed, config["start_frame"]))


@contextmanager
def _explained() -> Iterator[None]:
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
