"""What real radios add to channels besides noise: clocks that are wrong, jitter, uncalibrated beams.

Ideal channels at high SNR give delays to a tenth of a millimetre and flashes to a
thousandth of a degree, which no hardware delivers. The plan states the errors, a
stream of the dataset's seed draws them, and the estimator does not know the draws.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["jitter", "miscalibrate"]

Complex = NDArray[np.complex128]


def jitter(
    response: Complex,
    grid: OfdmGrid,
    std_s: float,
    rng: np.random.Generator,
    clock_error_s: ArrayLike = 0.0,
) -> Complex:
    """Shift every epoch of every anchor by a timing error of its own, and by what the clocks are wrong.

    The carrier's phase stays: the receiver tracks it.

    Parameters
    ----------
    response : ndarray of complex128, shape (epochs, anchors, ..., tones)
        Channel frequency responses.
    grid : OfdmGrid
        Their tones.
    std_s : float
        Standard deviation of the error, seconds; all paths of the CFR share it.
    rng : Generator
        Source of the errors.
    clock_error_s : array_like, shape (epochs, anchors)
        Added to the error, seconds.
    """
    error_s = (
        rng.normal(scale=std_s, size=response.shape[:2]) if std_s > 0.0 else np.zeros(response.shape[:2])
    )
    error_s = error_s + np.asarray(clock_error_s, dtype=np.float64)
    turns = error_s.reshape(*error_s.shape, *(1,) * (response.ndim - 2)) * grid.offsets_hz()
    return np.asarray(response * np.exp(-2j * np.pi * turns))


def miscalibrate(
    response: Complex,
    grid: OfdmGrid,
    gain_db: float,
    phase_rad: float,
    range_m: float,
    rng: np.random.Generator,
) -> Complex:
    """Give every beam a gain and phase error, and the whole front end a delay error.

    Parameters
    ----------
    response : ndarray of complex128, shape (sweeps, beams, tones)
        Two-way responses of the beams.
    grid : OfdmGrid
        Their tones.
    gain_db, phase_rad : float
        Standard deviations of a beam's errors, the same in every sweep.
    range_m : float
        Standard deviation of the front end's delay error as a one-way range, metres.
    rng : Generator
        Source of the errors.
    """
    gain, phase, shift = rng.standard_normal((3, response.shape[1]))
    beams = 10.0 ** (gain_db * gain / 20.0) * np.exp(1j * phase_rad * phase)
    delay_s = 2.0 * range_m * shift[0] / SPEED_OF_LIGHT_M_S
    ramp = np.exp(-2j * np.pi * delay_s * grid.offsets_hz())
    return np.asarray(response * beams[:, None] * ramp)
