"""The diffuse tail of a channel: an exponential power-delay profile over a noise floor.

Diffuse multipath is the sum of more paths than can be told apart: Gaussian, uncorrelated over delay, its
power decaying from an onset on. Over the tones it is noise with a Toeplitz covariance of which the profile is
the Fourier transform,

    c_k = s2 delta_k + p exp(-j 2 pi k x_b) / (1 + j 2 pi k t),

``p`` the tail's power per tone, ``x_b`` its onset and ``t`` its decay, both in turns, and ``s2`` the variance
of the noise floor (A. Richter, "Estimation of radio channel parameters: models and algorithms", TU Ilmenau
2005, section 2.5). :mod:`estimator.channel.tail_fit` estimates it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import ConfigurationError

__all__ = ["DiffuseTail", "TailConfig", "TailProfile", "tail_column"]

Complex = NDArray[np.complex128]


class TailProfile(NamedTuple):
    """A tail over a noise floor.

    Parameters
    ----------
    noise : float
        Variance of the noise per tone.
    power : float
        Power of the tail per tone; 0 for none.
    onset : float
        Where it begins, turns.
    decay : float
        In which its power falls to 1 / e, turns.
    """

    noise: float
    power: float = 0.0
    onset: float = 0.0
    decay: float = 1.0


@dataclass(frozen=True)
class DiffuseTail:
    """The tail and the noise floor of a channel, as they are reported.

    Parameters
    ----------
    power : float
        Power of the tail per tone, dimensionless like squared gains; 0 where there is none.
    onset_s : float
        Where it begins, seconds, in [0, 1 / tone spacing).
    decay_s : float
        In which its power falls to 1 / e, seconds.
    noise_variance : float
        Of the noise floor per tone.
    """

    power: float
    onset_s: float
    decay_s: float
    noise_variance: float


@dataclass(frozen=True)
class TailConfig:
    """Settings of the fit.

    Parameters
    ----------
    evidence : float
        Log-likelihood, nats, that a tail gains over noise alone to be believed: its three parameters gain 1.5
        by chance, and more than 10 once in some thousand channels.
    onset_evidence : float
        Log-likelihood, nats, that a tail gains by beginning later than the first path to be believed so: one
        parameter more gains 6 by chance once in two thousand channels.
    shortest_cells : float
        Shortest decay, resolution cells: a shorter tail is a path.
    longest_turns : float
        Longest decay, turns: a longer tail is noise.
    steps : int
        Largest number of likelihoods of a fit.
    tolerance : float
        Of logarithms of power and decay, and of the onset in resolution cells, where the search ends: a
        tenth of what their deviations are at best.
    """

    evidence: float = 10.0
    onset_evidence: float = 6.0
    shortest_cells: float = 1.0
    longest_turns: float = 0.5
    steps: int = 150
    tolerance: float = 0.02

    def __post_init__(self) -> None:
        for name in ("evidence", "onset_evidence", "shortest_cells", "longest_turns", "tolerance"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"TailConfig.{name}: expected a positive number, got {getattr(self, name)}"
                )
        if self.steps < 1:
            raise ConfigurationError(f"TailConfig.steps: expected at least 1, got {self.steps}")


def tail_column(profile: TailProfile, tones: int) -> Complex:
    """First column (tones,) of the covariance of a tail and its noise floor over equally spaced tones."""
    lag = 2j * np.pi * np.arange(tones)
    column = profile.power * np.exp(-lag * profile.onset) / (1.0 + lag * profile.decay)
    column[0] += profile.noise
    return np.asarray(column)
