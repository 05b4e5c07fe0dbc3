"""Pictures of a dataset: power over delay along the trajectory, and over range and angle of a sweep.

Both are inverse Fourier transforms of what the radios measured, noise included, with a
Hann window over the tones so that a strong path does not hide its neighbours.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.dataset import Dataset
from estimator.errors import InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.pictures.plans import style

__all__ = ["delay_profile", "draw_delay_profile", "draw_range_angle", "range_angle"]

Array = NDArray[np.float64]

_SPAN_DB = 50.0


def delay_profile(response: NDArray[np.complex128], spacing_hz: float) -> tuple[Array, Array]:
    """Power over path length of frequency responses.

    Parameters
    ----------
    response : ndarray of complex, shape (..., tones)
        Responses at tones ``spacing_hz`` apart.
    spacing_hz : float
        Distance of neighbouring tones, hertz.

    Returns
    -------
    length_m : ndarray, shape (bins,)
        Path length (delay times the speed of light), metres.
    power_db : ndarray, shape (..., bins)
        A path of amplitude ``a`` on a bin has ``20 log10 |a|``, whatever the window.
    """
    tones = response.shape[-1]
    window = np.hanning(tones + 2)[1:-1]
    bins = 2 * tones
    taps = np.fft.ifft(response * window, bins, axis=-1) * (bins / window.sum())
    length = np.arange(bins) * (SPEED_OF_LIGHT_M_S / (bins * spacing_hz))
    return length, 20.0 * np.log10(np.maximum(np.abs(taps), 1e-15))


def range_angle(dataset: Dataset, sweep: int = 0) -> tuple[Array, Array, Array]:
    """Power of one sweep over beam and range.

    Returns
    -------
    azimuth_rad : ndarray, shape (beams,)
        Azimuths of the beams, agent's frame, ascending, radians.
    range_m : ndarray, shape (bins,)
        Half the path length, metres.
    power_db : ndarray, shape (beams, bins)

    Raises
    ------
    InputError
        If the dataset has no such sweep.
    """
    count = 0
    for shard in dataset.shards("echo"):
        sweeps = int(shard.sizes["sweep"])
        if 0 <= sweep - count < sweeps:
            row = shard.isel(sweep=sweep - count)
            response = row["echo_re"].to_numpy().astype(np.float64) + 1j * row["echo_im"].to_numpy()
            azimuth = row["beam_azimuth_rad"].to_numpy().astype(np.float64)
            order = np.argsort(azimuth)
            length, power = delay_profile(response[order], _spacing_hz(row["tone_offset_hz"].to_numpy()))
            return azimuth[order], 0.5 * length, power
        count += sweeps
    raise InputError(f"sweep: expected 0 to {count - 1}, got {sweep}")


def _spacing_hz(offsets_hz: Array) -> float:
    return float(offsets_hz[1] - offsets_hz[0])


def draw_delay_profile(dataset: Dataset) -> Figure:
    """Draw power over path length along the trajectory, a panel for each anchor."""
    profiles, epochs = [], []
    length = np.zeros(1)
    for shard in dataset.shards("passive"):
        spacing_hz = _spacing_hz(shard["tone_offset_hz"].to_numpy())
        for index in range(int(shard.sizes["epoch"])):
            row = shard.isel(epoch=index)
            response = row["cfr_re"].to_numpy().astype(np.float64) + 1j * row["cfr_im"].to_numpy()
            length, power = delay_profile(response, spacing_hz)
            over = tuple(range(1, power.ndim - 1))  # antennas, and snapshots
            profiles.append(np.mean(10.0 ** (power / 10.0), axis=over).astype(np.float32))
            epochs.append(int(row["epoch"]))
    power_db = 10.0 * np.log10(np.stack(profiles))  # (epoch, anchor, bin)
    heard = power_db.max(axis=(0, 1)) > power_db.max() - _SPAN_DB
    last = min(int(np.flatnonzero(heard).max()) + 20, len(length))
    names = list(dataset.manifest["anchors"])
    with style():
        figure = Figure(
            figsize=(9.5, 1.0 + 2.6 * len(names)), dpi=150, facecolor="white", layout="constrained"
        )
        panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        top = float(power_db.max())
        for index, (axes, name) in enumerate(zip(panels, names, strict=True)):
            image = axes.pcolormesh(
                epochs,
                length[:last],
                power_db[:, index, :last].T,
                cmap="magma",
                vmin=top - _SPAN_DB,
                vmax=top,
                shading="nearest",
                rasterized=True,
            )
            heading = f"{dataset.manifest['name']}: {name}"
            axes.set_title(heading, loc="left", fontweight="bold", parse_math=False)
            axes.set_ylabel("path length, m")
            axes.tick_params(length=0)
        panels[-1].set_xlabel("epoch")
        figure.colorbar(image, ax=list(panels), label="path gain, dB", shrink=0.8)
        figure.draw_without_rendering()
    return figure


def draw_range_angle(dataset: Dataset, sweep: int = 0) -> Figure:
    """Draw one sweep as seen from the agent, in its frame.

    Raises
    ------
    InputError
        If the dataset has no such sweep.
    """
    azimuth, ranges, power = range_angle(dataset, sweep)
    top = float(power.max())
    heard = (power > top - _SPAN_DB).any(axis=0)
    last = min(int(np.flatnonzero(heard).max()) + 20, len(ranges))
    edges = np.concatenate([azimuth, azimuth[:1] + 2.0 * np.pi])
    width = np.diff(edges)
    limits = np.concatenate([edges[:1] - 0.5 * width[-1], 0.5 * (edges[1:] + edges[:-1])])
    reach = np.concatenate([ranges[:last], ranges[last - 1 : last] + ranges[1]])
    x = reach * np.cos(limits)[:, None]
    y = reach * np.sin(limits)[:, None]
    with style():
        figure = Figure(figsize=(8.5, 7.5), dpi=150, facecolor="white", layout="constrained")
        axes = figure.subplots()
        image = axes.pcolormesh(
            x, y, power[:, :last], cmap="magma", vmin=top - _SPAN_DB, vmax=top, rasterized=True
        )
        axes.plot(0.0, 0.0, marker="o", color="white", markeredgecolor="black", markersize=6.0)
        axes.set(aspect="equal", xlabel="along the heading, m", ylabel="to the left, m")
        axes.tick_params(length=0)
        title = f"{dataset.manifest['name']}: echo of sweep {sweep}"
        axes.set_title(title, loc="left", fontweight="bold", parse_math=False)
        figure.colorbar(image, ax=axes, label="two-way gain with beams, dB", shrink=0.8)
        figure.draw_without_rendering()
    return figure
