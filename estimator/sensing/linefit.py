"""The maximum-likelihood wall through ranges measured along known beam directions.

A wall at the distance ``rho`` whose normal points to ``alpha`` is met by the beam towards ``phi`` at

    d(phi) = rho sec(phi - alpha).

The errors of measured ranges lie along the beams, are independent and Gaussian; so the likeliest
wall minimises ``sum_m (d_m - rho S_m(alpha))^2 / sigma_m^2``, and its covariance is the inverse of
the Fisher information at the minimum. ``S_m`` is the secant of a pencil beam. A *wide* beam that
meets a wall at a slant receives a spread of ranges, of which it measures the centroid: there

    S_m(alpha) = sum_q P_mq cos^(k-1)(phi_mq - alpha) / sum_q P_mq cos^k(phi_mq - alpha)

is the secant's mean over the beam, weighted by the beam's two-way power pattern ``P``, by the power
law ``d^-p`` and by the cross section ``cos^(2 eta)`` of the wall, ``k = p + 2 eta``, over the directions
that meet it. Taking the range of a wide beam for that of its axis is wrong by metres at slants of 60
degrees and more, always towards the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.arrays import BeamSet
from estimator.errors import ConfigurationError, InputError
from estimator.geometry import vrp_by_image, vrp_of_image
from estimator.measurements import GaussianVrp
from estimator.sensing.uncertainty import checked_ranges

__all__ = ["BeamFan", "LineFit", "fit_lines", "fit_wall"]

Array = NDArray[np.float64]

_ITERATIONS = 25
_LARGEST_TURN_RAD = 0.1  # of a step
_CONVERGED_RAD = 1e-10
_DETERMINED = 1e-12  # least determinant of the information, relative to its diagonal's product
_MISSED_M = 1e6  # range of a beam that does not meet the wall
_GRAZING = 1e-3  # cosine below which a beam does not meet the wall


@dataclass(frozen=True, eq=False)
class BeamFan:
    """Directions that beams look into, with weights; what a range is an average over.

    Parameters
    ----------
    azimuth_rad : ndarray, shape (..., M, Q)
        Directions, radians.
    power : ndarray, shape (..., M, Q)
        Two-way power pattern of each beam, 0 or more, on any scale.
    falloff : float
        ``p + 2 eta``: exponent of the cosine in the power that a flat wall returns.
    """

    azimuth_rad: Array
    power: Array
    falloff: float = 4.4

    def __post_init__(self) -> None:
        if self.azimuth_rad.ndim < 2 or self.azimuth_rad.shape != self.power.shape:
            raise ConfigurationError(
                f"BeamFan: expected azimuth_rad and power of one shape (..., M, Q), got "
                f"{self.azimuth_rad.shape} and {self.power.shape}"
            )
        if not np.all(self.power >= 0.0) or not np.all(self.power.sum(axis=-1) > 0.0):
            raise ConfigurationError(
                "BeamFan.power: expected numbers of 0 or more and some power in each beam"
            )
        if not 1.0 <= self.falloff < np.inf:
            raise ConfigurationError(f"BeamFan.falloff: expected at least 1, got {self.falloff}")

    @classmethod
    def of(cls, beams: BeamSet, directions: int = 720, exponent: float = 4.0, eta: float = 0.2) -> BeamFan:
        """The fan of real beams: ``directions`` all around, weighted by the two-way power patterns."""
        azimuth = 2.0 * np.pi * np.arange(directions) / directions - np.pi
        power = np.abs(beams.two_way(azimuth).T) ** 2
        return cls(np.broadcast_to(azimuth, power.shape), power, exponent + 2.0 * eta)

    def take(self, beams: NDArray[np.int64]) -> BeamFan:
        """The fan of some of M beams, which may be several in rows: shape (..., m) gives (..., m, Q)."""
        return BeamFan(self.azimuth_rad[beams], self.power[beams], self.falloff)

    def secant(self, normal_rad: Array) -> tuple[Array, Array]:
        """Mean secants and their derivatives by the normal's direction.

        Parameters
        ----------
        normal_rad : ndarray, shape (...)
            Directions of walls' normals, radians.

        Returns
        -------
        secant, derivative : ndarray, shape (..., M)
            Infinite and 0 where no direction of the beam meets the wall.
        """
        shift = self.azimuth_rad - normal_rad[..., None, None]
        cosine, sine = np.cos(shift), np.sin(shift)
        meets = cosine > _GRAZING
        cosine = np.where(meets, cosine, 1.0)
        k = self.falloff
        weight = np.where(meets, self.power, 0.0) * cosine ** (k - 2.0)
        upper = np.sum(weight * cosine, axis=-1)
        lower = np.sum(weight * cosine**2, axis=-1)
        upper_slope = (k - 1.0) * np.sum(
            weight * sine, axis=-1
        )  # d cos(phi - alpha) / d alpha = sin(phi - alpha)
        lower_slope = k * np.sum(weight * cosine * sine, axis=-1)
        lit = lower > 0.0
        safe = np.where(lit, lower, 1.0)
        secant = np.where(lit, upper / safe, np.inf)
        return secant, np.where(lit, (upper_slope - upper / safe * lower_slope) / safe, 0.0)


def _pencil(azimuth: Array, normal: Array) -> tuple[Array, Array]:
    """Secants (..., M) of pencil beams and their derivatives; as :meth:`BeamFan.secant`."""
    shift = azimuth - normal[..., None]
    cosine = np.cos(shift)
    meets = cosine > _GRAZING
    safe = np.where(meets, cosine, 1.0)
    return np.where(meets, 1.0 / safe, np.inf), np.where(meets, -np.sin(shift) / safe**2, 0.0)


@dataclass(frozen=True, eq=False)
class LineFit:
    """Walls fitted to ranges.

    Parameters
    ----------
    mean_m : ndarray, shape (..., 2)
        VRPs relative to the agent, metres.
    covariance_m2 : ndarray, shape (..., 2, 2)
        Their covariances, square metres; NaN where the ranges do not determine the wall.
    cost : ndarray, shape (...)
        Sum of squared residuals over their variances: chi-square with M - 2 degrees of freedom.
    """

    mean_m: Array
    covariance_m2: Array
    cost: Array


def fit_lines(
    distance_m: ArrayLike,
    range_std_m: ArrayLike,
    azimuth_rad: ArrayLike,
    weight: ArrayLike = 1.0,
    fan: BeamFan | None = None,
) -> LineFit:
    """Maximum-likelihood walls, many at once.

    Starts at the weighted least squares of ``w . u_m = 1 / d_m``, linear in ``w = n / rho``, and
    iterates damped Gauss-Newton steps in ``(rho, alpha)``.

    Parameters
    ----------
    distance_m, range_std_m, azimuth_rad : array_like, shape (..., M)
        Ranges and standard deviations (metres), and directions of the beams (radians).
    weight : array_like, shape (..., M)
        1 for a range to use, 0 for one to leave out.
    fan : BeamFan, optional
        The wide beams, of shape (M, Q) or (..., M, Q), in place of the pencils at ``azimuth_rad``.

    Returns
    -------
    LineFit

    Raises
    ------
    InputError
        If ranges are fewer than two, or not positive.
    """
    distance, std, azimuth = checked_ranges(distance_m, range_std_m, azimuth_rad)
    precision = np.broadcast_to(np.asarray(weight, dtype=np.float64), distance.shape) / std**2
    if fan is not None and fan.azimuth_rad.shape[-2] != distance.shape[-1]:
        raise InputError(f"fan: expected {distance.shape[-1]} beams, got {fan.azimuth_rad.shape[-2]}")

    def secant(normal: Array) -> tuple[Array, Array]:
        return _pencil(azimuth, normal) if fan is None else fan.secant(normal)

    def cost_of(rho: Array, secants: Array) -> Array:
        lit = np.isfinite(secants)
        model = np.where(lit, rho[..., None] * np.where(lit, secants, 0.0), _MISSED_M)
        return np.asarray(np.sum(precision * (distance - model) ** 2, axis=-1))

    rho, alpha = _start(distance, azimuth, precision)
    cost, damping = cost_of(rho, secant(alpha)[0]), np.full(rho.shape, 1e-6)
    for _ in range(_ITERATIONS):
        information, gradient = _normal_equations(distance, precision, rho, *secant(alpha))
        step_rho, step_alpha = _damped(information, gradient, damping)
        trial_alpha = alpha + np.clip(step_alpha, -_LARGEST_TURN_RAD, _LARGEST_TURN_RAD)
        trial_rho = np.maximum(rho + step_rho, 0.1 * rho)
        trial = cost_of(trial_rho, secant(trial_alpha)[0])
        accept = trial <= cost
        cost = np.where(accept, trial, cost)
        alpha, rho = np.where(accept, trial_alpha, alpha), np.where(accept, trial_rho, rho)
        damping = np.where(accept, 0.1 * damping, np.minimum(10.0 * damping + 1e-9, 1e9))
        if np.all(np.abs(step_alpha) < _CONVERGED_RAD):
            break
    information, _ = _normal_equations(distance, precision, rho, *secant(alpha))
    cosine, sine = np.cos(alpha), np.sin(alpha)
    determinant = information[0] * information[2] - information[1] ** 2
    sure = determinant > _DETERMINED * information[0] * information[2]
    adjoint = np.stack(
        [
            np.stack([information[2], -information[1]], axis=-1),
            np.stack([-information[1], information[0]], axis=-1),
        ],
        axis=-2,
    )
    inverse = np.where(
        sure[..., None, None], adjoint / np.where(sure, determinant, 1.0)[..., None, None], np.nan
    )
    linear = 2.0 * np.stack(  # d VRP / d (rho, alpha)
        [np.stack([cosine, -rho * sine], axis=-1), np.stack([sine, rho * cosine], axis=-1)], axis=-2
    )
    covariance = linear @ inverse @ np.swapaxes(linear, -1, -2)
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    return LineFit(2.0 * rho[..., None] * np.stack([cosine, sine], axis=-1), covariance, cost)


def _start(distance: Array, azimuth: Array, precision: Array) -> tuple[Array, Array]:
    """Distances and normals (...) by linear least squares on inverse ranges."""
    u = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    weight = (precision * distance**4)[..., None]  # the variance of 1 / d is sigma^2 / d^4
    matrix = np.swapaxes(u * weight, -1, -2) @ u
    scale = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
    right = np.sum(u * weight / distance[..., None], axis=-2)
    w = np.linalg.solve(matrix + 1e-12 * scale * np.eye(2) + 1e-300 * np.eye(2), right[..., None])[..., 0]
    length = np.maximum(np.linalg.norm(w, axis=-1), 1e-9)
    return np.asarray(1.0 / length), np.asarray(np.arctan2(w[..., 1], w[..., 0]))


def _normal_equations(
    distance: Array, precision: Array, rho: Array, secant: Array, slope: Array
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Information on (rho, alpha) as (rr, ra, aa), and minus half the cost's gradient."""
    lit = np.isfinite(secant)
    by_rho, by_alpha = np.where(lit, secant, 0.0), rho[..., None] * slope
    residual = np.where(lit, distance - rho[..., None] * by_rho, 0.0)

    def total(left: Array, right: Array) -> Array:
        return np.asarray(np.sum(precision * left * right, axis=-1))

    information = (total(by_rho, by_rho), total(by_rho, by_alpha), total(by_alpha, by_alpha))
    return information, (total(by_rho, residual), total(by_alpha, residual))


def _damped(
    information: tuple[Array, Array, Array], gradient: tuple[Array, Array], damping: Array
) -> tuple[Array, Array]:
    """Levenberg-Marquardt step of two unknowns."""
    rr, ra, aa = information
    rr, aa = rr * (1.0 + damping) + 1e-12, aa * (1.0 + damping) + 1e-12
    determinant = rr * aa - ra**2
    safe = np.where(determinant > 0.0, determinant, 1.0)
    move = np.where(determinant > 0.0, 1.0, 0.0)
    return (
        np.asarray(move * (aa * gradient[0] - ra * gradient[1]) / safe),
        np.asarray(move * (rr * gradient[1] - ra * gradient[0]) / safe),
    )


def fit_wall(
    distance_m: ArrayLike,
    range_std_m: ArrayLike,
    azimuth_rad: ArrayLike,
    position_m: ArrayLike = (0.0, 0.0),
    fan: BeamFan | None = None,
) -> GaussianVrp:
    """The likeliest wall through the RSPs of one sweep.

    Parameters
    ----------
    distance_m, range_std_m, azimuth_rad, fan
        As in :func:`fit_lines`, shape (M,).
    position_m : array_like, shape (2,)
        Where the agent stands, relative to RP, metres; known.

    Returns
    -------
    GaussianVrp
        The mirror image of RP; its covariance is that of the wall's line.

    Raises
    ------
    InputError
        If the ranges are unusable or do not determine a wall.
    """
    fit = fit_lines(distance_m, range_std_m, azimuth_rad, fan=fan)
    if not np.all(np.isfinite(fit.covariance_m2)):
        raise InputError(
            "azimuth_rad: expected at least two directions that meet the wall, got coinciding ones"
        )
    return seen_from_reference(fit.mean_m, fit.covariance_m2, np.asarray(position_m, dtype=np.float64))


def seen_from_reference(image_m: Array, covariance_m2: Array, position_m: Array) -> GaussianVrp:
    """VRP, with covariance, of a wall known by the image of the agent at ``position_m`` relative to it."""
    image = position_m + image_m
    by_image = vrp_by_image(image, position_m)
    covariance = by_image @ covariance_m2 @ by_image.T
    return GaussianVrp(vrp_of_image(image, position_m), 0.5 * (covariance + covariance.T))
