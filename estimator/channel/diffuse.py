"""Paths in front of a diffuse tail: what a measured channel of a room holds.

Where specular paths are followed by a tail of more paths than can be told apart, an estimator that knows
white noise alone takes the tail apart into pairs of nearly cancelling paths. Here tail, noise floor and paths
are estimated together (:mod:`estimator.channel.tail_pursuit`), of one antenna and one snapshot. A path is
reported if it stands out of the tail at the false-alarm rate of :mod:`estimator.channel.detection`, and the
first strong one always where anything stands out of the noise: the tail came after it. Variances are
Cramer-Rao bounds in the noise that the tail is, and a floor.

A path with which the tail begins is at the bound given the tail. Where the tail begins some cells later, the
gap is known only roughly, and at high SNR the error is several times a bound that is told the gap.

What the model cannot tell apart it takes for the tail: several paths of like strength and decaying may
be drawn from one. Of channels of a few paths and no tail, :mod:`estimator.channel.nomp` finds more.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.channel.checks import checked_channels, checked_noise
from estimator.channel.detection import delay_length, detection_threshold
from estimator.channel.nomp import DelayEstimate
from estimator.channel.refinement import Refinement
from estimator.channel.tail import DiffuseTail, TailConfig
from estimator.channel.tail_pursuit import TailPursuit, pursue_in_tail
from estimator.errors import ConfigurationError, InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["DiffuseConfig", "DiffusePlan"]

_FEWEST_TONES = 16  # on which four parameters of a tail and three of a path can be told


@dataclass(frozen=True)
class DiffuseConfig:
    """Settings of the estimation of paths and tail.

    Parameters
    ----------
    false_alarm : float
        Probability that tail and noise alone give a further path, per CFR over all delays.
    dynamic_range_db : float
        Paths weaker than the strongest by more are not sought.
    forerunner_db : float
        The tail begins no sooner than the first path that is weaker than the strongest by no more: what
        leaks ahead of a pulse is weaker. That path is always reported.
    max_paths : int
        Largest number of paths of a CFR.
    closest_cells : float
        Least distance of two paths, resolution cells (1 / bandwidth): in a tail, closer ones are not told
        apart.
    floor_m : float
        Standard deviation added to every path length for what the model leaves out, metres.
    oversampling : int
        Delays searched per resolution cell.
    polish_steps, final_steps : int
        Joint steps after each path, and at the end.
    tail : TailConfig
        Settings of the tail.
    """

    false_alarm: float = 0.01
    dynamic_range_db: float = 30.0
    forerunner_db: float = 20.0
    max_paths: int = 40
    closest_cells: float = 0.5
    floor_m: float = 0.03
    oversampling: int = 4
    polish_steps: int = 4
    final_steps: int = 20
    tail: TailConfig = field(default_factory=TailConfig)

    def __post_init__(self) -> None:
        if not 0.0 < self.false_alarm <= 0.5:
            raise ConfigurationError(f"false_alarm: expected a number in (0, 0.5], got {self.false_alarm}")
        for name in ("dynamic_range_db", "forerunner_db", "floor_m", "closest_cells"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ConfigurationError(f"{name}: expected 0 or a positive number, got {value}")
        least_of = {"max_paths": 1, "oversampling": 2, "polish_steps": 1, "final_steps": 0}
        for name, least in least_of.items():
            if getattr(self, name) < least:
                raise ConfigurationError(f"{name}: expected at least {least}, got {getattr(self, name)}")


class DiffusePlan:
    """Paths and diffuse tails on one grid of tones.

    Parameters
    ----------
    grid : OfdmGrid
        The tones of the CFRs.
    config : DiffuseConfig, optional
        Settings.

    Raises
    ------
    ConfigurationError
        If the grid has too few tones to tell a tail.
    """

    def __init__(self, grid: OfdmGrid, config: DiffuseConfig | None = None) -> None:
        self.grid, self.config = grid, DiffuseConfig() if config is None else config
        if grid.tones < _FEWEST_TONES:
            raise ConfigurationError(
                f"grid: expected at least {_FEWEST_TONES} tones to tell a tail, got {grid.tones}"
            )
        self._settings = TailPursuit(
            threshold=detection_threshold(self.config.false_alarm, delay_length(grid.tones)),
            range_ratio=10.0 ** (-0.1 * self.config.dynamic_range_db),
            forerunner_ratio=10.0 ** (-0.1 * self.config.forerunner_db),
            max_paths=self.config.max_paths,
            oversampling=self.config.oversampling,
            polish_steps=self.config.polish_steps,
            final_steps=self.config.final_steps,
            tail=self.config.tail,
            limits=Refinement(self.config.closest_cells),
        )

    def estimate(self, cfr: ArrayLike, noise_variance: ArrayLike | None = None) -> list[DelayEstimate]:
        """Estimate paths and tails of a batch of channels.

        Parameters
        ----------
        cfr : array_like of complex, shape (C, tones)
            Channel frequency responses of one antenna and one snapshot, dimensionless.
        noise_variance : array_like, scalar or shape (C,), optional
            Variance of their noise floor per tone, positive; by default estimated with the rest.

        Returns
        -------
        list of DelayEstimate
            One per channel, in ascending order of delay, with its tail.

        Raises
        ------
        InputError
            If shapes do not fit, a CFR is not finite or a variance not positive.
        """
        channels, snapshots = checked_channels(cfr, (self.grid.tones,))
        if snapshots:
            raise InputError(f"cfr: expected one snapshot, shape (n, tones), got {channels.shape}")
        noise: list[float] | list[None] = [None] * len(channels)
        if noise_variance is not None:
            noise = checked_noise(noise_variance, len(channels))
        return [self._one(*each) for each in zip(channels, noise, strict=True)]

    def _one(self, channel: NDArray[np.complex128], noise: float | None) -> DelayEstimate:
        """Paths and tail of a channel (tones,)."""
        found = pursue_in_tail(channel, noise, self._settings)
        spacing, profile = self.grid.tone_spacing_hz, found.profile
        turns = np.floor(found.turns)
        gain = found.gain * (1.0 - 2.0 * np.mod(turns * (self.grid.tones % 2 == 0), 2.0))  # a turn is -1
        order = np.argsort(found.turns - turns, kind="stable")
        floor = (self.config.floor_m / SPEED_OF_LIGHT_M_S) ** 2
        tail = DiffuseTail(profile.power, profile.onset / spacing, profile.decay / spacing, profile.noise)
        return DelayEstimate(
            ((found.turns - turns) / spacing)[order],
            gain[order],
            (found.variance / spacing**2 + floor)[order],
            tail=tail,
        )
