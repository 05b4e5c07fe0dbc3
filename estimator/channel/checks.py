"""What estimators of paths take: channels and the variance of their noise, checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError

__all__ = ["checked_channels", "checked_noise"]


def checked_channels(cfr: ArrayLike, tail: tuple[int, ...]) -> tuple[NDArray[np.complex128], bool]:
    """Channels (C, [S,] *tail), and whether they have the axis S of snapshots.

    Raises
    ------
    InputError
        If shapes do not fit or a number is not finite.
    """
    channels = np.asarray(cfr, dtype=np.complex128)
    snapshots = channels.ndim == len(tail) + 2
    if channels.shape[1 + snapshots :] != tail or 0 in channels.shape[1:]:
        wanted = ", ".join(str(size) for size in ("n", *tail))
        raise InputError(f"cfr: expected shape ({wanted}), got {channels.shape}")
    if not np.all(np.isfinite(channels)):
        place = np.argwhere(~np.isfinite(channels))[0]
        value, row, tone = channels[tuple(place)], place[0], place[-1]
        raise InputError(f"cfr: expected finite numbers, got {value} in row {row}, tone {tone}")
    return channels, snapshots


def checked_noise(noise_variance: ArrayLike, count: int) -> list[float]:
    """The variance of the noise of each of ``count`` channels, from one number or one of each.

    Raises
    ------
    InputError
        If the shape does not fit or a variance is not positive.
    """
    noise = np.asarray(noise_variance, dtype=np.float64)
    if noise.shape not in ((), (count,)):
        raise InputError(f"noise_variance: expected a number or shape {(count,)}, got {noise.shape}")
    if not np.all((noise > 0.0) & np.isfinite(noise)):
        raise InputError(f"noise_variance: expected positive numbers, got {noise.min()}")
    found: list[float] = np.broadcast_to(noise, (count,)).tolist()
    return found
