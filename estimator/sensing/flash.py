"""Walls from their specular flash: a flat wall returns what meets it at normal incidence.

A flash from range ``r`` and direction ``n`` is the foot of the perpendicular on a wall, so that the
wall's virtual reference point is ``p + 2 r n`` for an agent at ``p`` (here the reference point, the
origin; (1) to (3) of the paper named in :mod:`estimator.geometry`). No other return of the
room lies on a wall's perpendicular; what looks like a flash and is none is told by rules. Returns are
taken in order of strength, and one is rejected if

- its gain is implausible: above a perfect mirror's, or far below;
- it comes from the direction of a wall and from farther: what stands behind a wall is not seen.
  The stronger of the two is not always the nearer: over floor and ceiling a wall has images a little
  farther than itself, and over a low wall a higher one is seen. A nearer return that is not much weaker
  is the wall;
- it is a weak companion, in another direction, of a stronger one at the same range: a
  sidelobe of beams that are not quite what they should be;
- it lies on the line of a stronger wall and is much weaker: that wall's diffuse return;
- its range and direction are those of the double bounce over two walls found, with a gain of
  at most the product of theirs. Over walls ``a`` and ``b`` the double bounce has the length of
  the image of the agent over both; over a right corner it comes from the corner itself, from
  ``sqrt(r_a^2 + r_b^2)``, and between parallel walls from ``r_a + r_b``.

Returns that make one flash (floor and ceiling add images a little farther than the wall's own) are
joined by power, and their spread is added to the covariance. Not resolved, these images add up: the
way there and back over the floor, the same over the ceiling and the wall's own are five, 14 dB if all
are in phase. Floor and ceiling themselves send vertically, where the beams' gain, two ways, is tens of
decibels below a wall's; taken for returns from the horizon, they are far too weak for one.

*Covariance.* The Cramer-Rao bound is centimetres at most; errors of beams, and images not
resolved, are larger. What is claimed on top of the bound is :attr:`FlashConfig.range_std_m` and
:attr:`FlashConfig.azimuth_std_rad`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import BeamSet
from estimator.errors import ConfigurationError
from estimator.geometry import mirror
from estimator.measurements import GaussianVrp
from estimator.sensing.returns import PursuitConfig, ReturnSet, echo_pursuit
from estimator.waveform import OfdmGrid

__all__ = ["Flash", "FlashConfig", "Verdict", "find_flashes", "flash_walls"]

Real = NDArray[np.float64]

_JOINED_CELLS = 1.5  # returns of one direction closer in range are one flash


class Verdict(Enum):
    """What a return was taken for."""

    WALL = "flash of a wall"
    IMPLAUSIBLE = "gain no flat wall could have"
    BEHIND = "behind a wall, in its direction"
    SIDELOBE = "sidelobe of a stronger return at the same range"
    DIFFUSE = "diffuse return of a stronger wall"
    PAIR = "double bounce over two walls"


@dataclass(frozen=True)
class FlashConfig:
    """Settings of the search for flashes.

    Parameters
    ----------
    range_std_m, azimuth_std_rad : float
        Standard deviations of range and azimuth claimed on top of the bound, metres and radians:
        images not resolved, beams that are not quite what they should be.
    common_range_std_m : float
        Standard deviation of the delay of the front end as a one-way range, metres: an error that all flashes
        of all sweeps have in common.
    min_reflectivity_db, max_reflectivity_db : float
        Gain of a flash against a perfect mirror's, dB.
    same_direction_rad : float
        Returns closer in azimuth come from one direction, radians.
    sidelobe_db, diffuse_db : float
        How much weaker than a wall its sidelobes and its diffuse returns are at least, dB; a return from
        before a wall that is no weaker than that is a wall in front of it.
    rule_range_m, rule_azimuth_rad : float
        Tolerance of the rules of diffuse returns and double bounces, metres and radians.
    pair_margin_db : float
        A double bounce may exceed the product of the walls' reflectivities by this, dB (two paths,
        there and back, add up to 6 dB).
    pursuit : PursuitConfig
        Settings of the pursuit of returns.
    """

    range_std_m: float = 0.02
    common_range_std_m: float = 0.04
    azimuth_std_rad: float = float(np.deg2rad(0.12))
    min_reflectivity_db: float = -20.0
    max_reflectivity_db: float = 14.0
    same_direction_rad: float = float(np.deg2rad(4.0))
    sidelobe_db: float = 15.0
    diffuse_db: float = 10.0
    rule_range_m: float = 0.5
    rule_azimuth_rad: float = float(np.deg2rad(3.0))
    pair_margin_db: float = 9.0
    pursuit: PursuitConfig = field(default_factory=PursuitConfig)

    def __post_init__(self) -> None:
        for name in ("range_std_m", "azimuth_std_rad", "rule_range_m", "rule_azimuth_rad"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")
        for name in (
            "common_range_std_m",
            "same_direction_rad",
            "sidelobe_db",
            "diffuse_db",
            "pair_margin_db",
        ):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"{name}: expected 0 or a positive number, got {getattr(self, name)}"
                )
        if not self.min_reflectivity_db < self.max_reflectivity_db:
            raise ConfigurationError(
                "min_reflectivity_db, max_reflectivity_db: expected min < max, "
                f"got {self.min_reflectivity_db} and {self.max_reflectivity_db}"
            )


@dataclass(frozen=True, eq=False)
class Flash:
    """A return and what it was taken for.

    Parameters
    ----------
    range_m, azimuth_rad : float
        One-way range, metres, and azimuth in the agent's frame, radians.
    reflectivity_db : float
        Gain against a perfect mirror's at this range, dB.
    covariance : ndarray, shape (2, 2)
        Covariance of (range, azimuth), m^2, m rad, rad^2.
    verdict : Verdict
        What it was taken for.
    """

    range_m: float
    azimuth_rad: float
    reflectivity_db: float
    covariance: Real
    verdict: Verdict

    @property
    def direction(self) -> Real:
        """Unit vector towards the return, shape (2,)."""
        return np.array([np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)])

    def vrp(self) -> GaussianVrp:
        """The wall as a Gaussian virtual reference point: (2) with the foot at ``r n``."""
        along = self.direction
        across = np.array([-along[1], along[0]])
        jacobian = 2.0 * np.stack([along, self.range_m * across], axis=1)
        covariance = jacobian @ self.covariance @ jacobian.T
        return GaussianVrp(2.0 * self.range_m * along, 0.5 * (covariance + covariance.T))


def find_flashes(
    echo: NDArray[np.complex128],
    noise_variance: float,
    grid: OfdmGrid,
    beams: BeamSet,
    config: FlashConfig | None = None,
) -> list[Flash]:
    """Find and judge the returns of one sweep.

    Parameters
    ----------
    echo : ndarray of complex, shape (beams, tones)
        Response of every beam, sending and receiving.
    noise_variance : float
        Variance of its noise per tone.
    grid : OfdmGrid
        Tones of the echo.
    beams : BeamSet
        The beams, in the order of the sweep.
    config : FlashConfig, optional
        Settings.

    Returns
    -------
    list of Flash
        The strongest first, rejected ones included.

    Raises
    ------
    InputError
        If the echo does not fit grid and beams, or is not finite.
    """
    settings = FlashConfig() if config is None else config
    pursuit = echo_pursuit(grid, beams, settings.pursuit)
    flashes: list[Flash] = []
    for candidate in _candidates(pursuit.find(echo, noise_variance), settings, pursuit.range_cell_m):
        walls = [flash for flash in flashes if flash.verdict is Verdict.WALL]
        beyond = [wall for wall in walls if _hides(candidate, wall, settings)]
        others = [wall for wall in walls if wall not in beyond]
        judged = replace(candidate, verdict=_judge(candidate, others, settings, pursuit.range_cell_m))
        if judged.verdict is Verdict.WALL:
            flashes = [
                replace(flash, verdict=Verdict.BEHIND) if flash in beyond else flash for flash in flashes
            ]
        flashes.append(judged)
    return flashes


def flash_walls(flashes: list[Flash]) -> tuple[GaussianVrp, ...]:
    """The walls among judged returns, in the order given."""
    return tuple(flash.vrp() for flash in flashes if flash.verdict is Verdict.WALL)


def _candidates(returns: ReturnSet, config: FlashConfig, range_cell_m: float) -> list[Flash]:
    """Returns joined to flashes, with the covariance claimed, none judged yet."""
    claimed = np.diag([config.range_std_m**2 + config.common_range_std_m**2, config.azimuth_std_rad**2])
    free = np.ones(len(returns), dtype=bool)
    flashes: list[Flash] = []
    for strongest in range(len(returns)):
        if not free[strongest]:
            continue
        turned = np.angle(np.exp(1j * (returns.azimuth_rad - returns.azimuth_rad[strongest])))
        near = np.abs(returns.range_m - returns.range_m[strongest]) < _JOINED_CELLS * range_cell_m
        members = free & near & (np.abs(turned) < config.same_direction_rad)
        free &= ~members
        weight = members * 10.0 ** (0.1 * (returns.power_db - returns.power_db[strongest]))
        weight = weight / np.sum(weight)
        places = np.stack([returns.range_m, turned], axis=1)
        center = weight @ places
        spread = (weight[:, None] * (places - center)).T @ (places - center)
        flashes.append(
            Flash(
                float(center[0]),
                float(np.angle(np.exp(1j * (returns.azimuth_rad[strongest] + center[1])))),
                float(returns.reflectivity_db[strongest]),
                returns.covariance[strongest] + spread + claimed,
                Verdict.WALL,
            )
        )
    return flashes


def _hides(candidate: Flash, wall: Flash, config: FlashConfig) -> bool:
    """Whether a candidate, if it is a wall, stands before a stronger return in the same direction."""
    return (
        candidate.range_m < wall.range_m
        and wall.reflectivity_db - candidate.reflectivity_db <= config.diffuse_db
        and _azimuth_between(candidate.azimuth_rad, wall.azimuth_rad) < config.same_direction_rad
    )


def _judge(candidate: Flash, walls: list[Flash], config: FlashConfig, range_cell_m: float) -> Verdict:
    """What a candidate is, given the stronger walls."""
    low, high = config.min_reflectivity_db, config.max_reflectivity_db
    if not low <= candidate.reflectivity_db <= high:
        return Verdict.IMPLAUSIBLE
    for wall in walls:
        weaker_db = wall.reflectivity_db - candidate.reflectivity_db
        if _azimuth_between(candidate.azimuth_rad, wall.azimuth_rad) < config.same_direction_rad:
            return Verdict.BEHIND
        same_range = abs(candidate.range_m - wall.range_m) < range_cell_m
        if same_range and weaker_db > config.sidelobe_db:
            return Verdict.SIDELOBE
        height = candidate.range_m * float(candidate.direction @ wall.direction) - wall.range_m
        if abs(height) < config.rule_range_m and weaker_db > config.diffuse_db:
            return Verdict.DIFFUSE
    for a, first in enumerate(walls):
        for second in walls[a + 1 :]:
            if _is_pair(candidate, first, second, config):
                return Verdict.PAIR
    return Verdict.WALL


def _is_pair(candidate: Flash, first: Flash, second: Flash, config: FlashConfig) -> bool:
    """Whether a candidate is the double bounce over two walls, in either order."""
    strongest_db = first.reflectivity_db + second.reflectivity_db + config.pair_margin_db
    if candidate.reflectivity_db > strongest_db:
        return False
    vrps = [2.0 * wall.range_m * wall.direction for wall in (first, second)]
    # The image over a then b: where the return over both arrives from; it leaves to the reverse one.
    arrival, departure = mirror(vrps[0], vrps[1]), mirror(vrps[1], vrps[0])
    if abs(candidate.range_m - 0.5 * float(np.linalg.norm(arrival))) > config.rule_range_m:
        return False
    azimuths = [float(np.arctan2(image[1], image[0])) for image in (arrival, departure)]
    half_opening = 0.5 * _azimuth_between(*azimuths)
    middle = float(np.angle(np.sum(np.exp(1j * np.array(azimuths)))))
    if half_opening > 0.25 * np.pi:  # e.g. parallel walls: two separate directions
        return min(_azimuth_between(candidate.azimuth_rad, a) for a in azimuths) < config.rule_azimuth_rad
    return _azimuth_between(candidate.azimuth_rad, middle) < half_opening + config.rule_azimuth_rad


def _azimuth_between(a: float, b: float) -> float:
    """Angle between two azimuths, in [0, pi]."""
    return abs(float(np.angle(np.exp(1j * (a - b)))))
