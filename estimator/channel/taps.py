"""From impulse responses in taps to frequency responses over tones, of a window and a band.

A window of taps is transformed; of its tones those are kept that the pulse fills: the band that is told, and
where the pulse itself is known, the tones on which it has enough power. Its spectrum is divided out, so that
paths are plane waves over the tones again. That raises the noise where the pulse is weak; it is taken for
white at its mean level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError

__all__ = ["ToneWindow", "tones_of_taps"]

Complex = NDArray[np.complex128]


class ToneWindow(NamedTuple):
    """Frequency responses of windows of taps.

    Parameters
    ----------
    cfr : ndarray of complex128, shape (N, tones)
        Tones in ascending order; delay 0 is the first tap of the window.
    spacing_hz : float
        From tone to tone.
    """

    cfr: Complex
    spacing_hz: float


def tones_of_taps(
    cir: Complex,
    tap_s: float,
    first: NDArray[np.int64],
    taps: int,
    bandwidth_hz: float | None = None,
    pulse: Complex | None = None,
    least_pulse_db: float = 12.0,
) -> ToneWindow:
    """Frequency responses of windows of impulse responses.

    Parameters
    ----------
    cir : ndarray of complex128, shape (N, M)
        Impulse responses; before their first and after their last tap there is nothing.
    tap_s : float
        From tap to tap, seconds.
    first : ndarray of int64, shape (N,)
        The first tap of each window.
    taps : int
        Length of the windows.
    bandwidth_hz : float, optional
        The band kept, around its middle; by default all that the taps sample.
    pulse : ndarray of complex128, shape (P,), optional
        The response of one path of delay 0, from its first tap; no longer than a window.
    least_pulse_db : float
        Tones on which the pulse is weaker than at its strongest by more end the band.

    Raises
    ------
    InputError
        If fewer than two tones are left, or the pulse is longer than a window.
    """
    place = first[:, None] + np.arange(taps)
    inside = (place >= 0) & (place < cir.shape[1])
    window = np.where(inside, np.take_along_axis(cir, np.clip(place, 0, cir.shape[1] - 1), axis=1), 0.0)
    spectrum = np.fft.fftshift(np.fft.fft(window, axis=1), axes=1)
    offset = np.fft.fftshift(np.fft.fftfreq(taps, tap_s))
    kept = np.ones(taps, dtype=bool) if bandwidth_hz is None else np.abs(offset) <= 0.5 * bandwidth_hz
    if pulse is not None:
        if len(pulse) > taps:
            raise InputError(f"pulse: expected at most the {taps} taps of a window, got {len(pulse)}")
        own = np.fft.fftshift(np.fft.fft(pulse, taps))
        power = np.where(kept, np.abs(own) ** 2, 0.0)
        weak = np.flatnonzero(power < power.max() * 10.0 ** (-0.1 * least_pulse_db))
        top = int(np.argmax(power))
        begin = int(np.max(weak[weak < top], initial=-1)) + 1
        end = int(np.min(weak[weak > top], initial=taps))
        kept = np.zeros(taps, dtype=bool)
        kept[begin:end] = True
        spectrum = spectrum / np.where(kept, own / np.sqrt(np.mean(np.abs(own[kept]) ** 2)), 1.0)
    if np.count_nonzero(kept) < 2:
        raise InputError(f"bandwidth_hz: expected two tones of {1.0 / (taps * tap_s):.4g} Hz or more in it")
    return ToneWindow(np.ascontiguousarray(spectrum[:, kept]), 1.0 / (taps * tap_s))
