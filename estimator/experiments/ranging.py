"""Ranges of single echoes by NOMP, many at once: what Figs. 7 and 8 are made of (Sections V-A and V-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.channel.nomp import NompConfig, NompPlan
from estimator.experiments.catalogue import Request
from estimator.sensing.ranges import echo_response
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["PAPER_GRID", "range_errors"]

Array = NDArray[np.float64]

PAPER_GRID = OfdmGrid(carrier_hz=28e9, subcarrier_spacing_hz=120e3, subcarriers=200, comb=1, symbols=1)
"""The grid of Figs. 7, 8 and 10: 200 subcarriers, 120 kHz apart, at 28 GHz."""

_BATCH = 64  # runs in a task: NOMP's fastest batch
_ONE_PATH = NompConfig(false_alarm=0.5, max_paths=1, floor_m=0.0)  # there is one; it need not be detected


@dataclass(frozen=True)
class _Batch:
    distance_m: float
    snr_db: tuple[float, ...]
    seeds: range


def range_errors(request: Request, distance_m: float, snr_db: Sequence[float], runs: int) -> Array:
    """Errors of the distance of a reflection, estimated from the noisy channel (13).

    Parameters
    ----------
    request : Request
        Seed and workers. Run ``i`` has the same noise at every SNR, that of ``seed + i``.
    distance_m : float
        True distance, metres.
    snr_db : sequence of float
        Signal-to-noise ratios of one subcarrier.
    runs : int
        Runs at each.

    Returns
    -------
    ndarray, shape (S, runs)
        Metres; NaN where no path was found.
    """
    last = request.seed + runs
    tasks = [
        _Batch(distance_m, tuple(snr_db), range(first, min(first + _BATCH, last)))
        for first in range(request.seed, last, _BATCH)
    ]
    return np.concatenate(request.map(_errors, tasks), axis=1)


def _errors(batch: _Batch) -> Array:
    clean = echo_response(PAPER_GRID, batch.distance_m)
    parts = np.array([np.random.default_rng(seed).normal(size=(2, clean.size)) for seed in batch.seeds])
    noise = np.sqrt(0.5) * (parts[:, 0] + 1j * parts[:, 1])
    plan = NompPlan(PAPER_GRID, _ONE_PATH)
    metres_per_second = 0.5 * SPEED_OF_LIGHT_M_S
    reach = metres_per_second * PAPER_GRID.unambiguous_s
    result = np.full((len(batch.snr_db), len(noise)), np.nan)
    for row, snr_db in enumerate(batch.snr_db):
        variance = 10.0 ** (-0.1 * snr_db)
        for run, found in enumerate(plan.estimate(clean + np.sqrt(variance) * noise, variance)):
            if len(found):
                error = metres_per_second * found.delay_s[0] - batch.distance_m
                result[row, run] = (error + 0.5 * reach) % reach - 0.5 * reach
    return result
