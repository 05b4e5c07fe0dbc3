"""Shards of channels and echoes, and what a manifest says of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from estimator.arrays import BeamSet
from estimator.dataset import Dataset
from estimator.waveform import OfdmGrid
from raytrace.propagation.paths import PathSet

JITTER_S = 1e-10
GATE_M = 0.5  # how far a measured path may be from the one that it is, metres


@dataclass(frozen=True)
class Room:
    """Every sixth epoch of the L-shaped room, by the image method, as a dataset."""

    dataset: Dataset
    paths: PathSet
    vrps_m: np.ndarray


def signal(grid: OfdmGrid, noise_variance: float) -> dict[str, Any]:
    return {
        "carrier_hz": grid.carrier_hz,
        "subcarrier_spacing_hz": grid.subcarrier_spacing_hz,
        "subcarriers": grid.subcarriers,
        "comb": grid.comb,
        "symbols": grid.symbols,
        "noise_variance": noise_variance,
    }


def passive_shard(cfr: np.ndarray, anchors: list[str], first: int = 0) -> xr.Dataset:
    dims = ("epoch", "anchor", "antenna", "tone")
    epochs = np.arange(first, first + len(cfr))
    return xr.Dataset(
        {
            "cfr_re": (dims, cfr.real.astype(np.float32)),
            "cfr_im": (dims, cfr.imag.astype(np.float32)),
            "time_s": ("epoch", 0.5 * epochs),
        },
        coords={"epoch": epochs, "anchor": anchors},
    )


def echo_shard(echo: np.ndarray, *epochs: int) -> xr.Dataset:
    dims = ("sweep", "beam", "tone")
    return xr.Dataset(
        {
            "echo_re": (dims, echo.real.astype(np.float32)),
            "echo_im": (dims, echo.imag.astype(np.float32)),
            "sweep_epoch": ("sweep", np.array(epochs or [0])),
        }
    )


def beams_of(beams: BeamSet) -> dict[str, Any]:
    names = ("panels", "elements", "beams", "spacing_wavelengths", "heading_rad")
    return {name: getattr(beams, name) for name in names}
