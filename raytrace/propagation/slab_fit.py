"""What a wall is made of, told by what its reflections cost over the angle of incidence.

Slabs of the ITU's materials, whose thickness is free, are compared with the losses of single bounces
by their evidence: the likelihood averaged over thickness. Losses are those of fields that leave and arrive
vertically polarised, with both parts of the field where anchor and agent differ in height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.errors import ConfigurationError, InputError
from raytrace.plan.materials import permittivity, slab_reflection
from raytrace.propagation.directions import spherical_basis

__all__ = ["WALL_MATERIALS", "SlabFit", "SlabSearch", "bounce_geometry", "fit_slab"]

Array = NDArray[np.float64]
WALL_MATERIALS = ("concrete", "brick", "plasterboard", "wood", "glass", "metal")
"""Materials of which walls are built; others of the table may be asked for."""
_CLEAN_DB = 0.1
_LEAST_CLEAN = 3


@dataclass(frozen=True)
class SlabSearch:
    """How slabs are compared.

    Parameters
    ----------
    materials : tuple of str
        Candidates.
    thinnest_m, thickest_m : float
        Thickness is looked for between these.
    step_m : float
        In steps of this: a small part of the period of interference inside a slab, 1.9 mm in concrete at 28
        GHz.
    floor_db : float
        Noise of every loss that its own figure leaves out: errors of the map.
    most_samples : int
        Losses that are used at most, the least noisy ones.
    freedom : float
        Degrees of freedom of Student's law of the losses: a few bounces are another's.
    """

    materials: tuple[str, ...] = WALL_MATERIALS
    thinnest_m: float = 0.005
    thickest_m: float = 0.4
    step_m: float = 2.5e-4
    floor_db: float = 0.05
    most_samples: int = 150
    freedom: float = 4.0

    def __post_init__(self) -> None:
        if not self.materials:
            raise ConfigurationError("materials: expected at least one candidate, got none")
        if not 0.0 < self.thinnest_m < self.thickest_m or not self.step_m > 0.0:
            raise ConfigurationError(
                f"thinnest_m, thickest_m, step_m: expected positive, ascending thicknesses, got "
                f"{self.thinnest_m}, {self.thickest_m} and {self.step_m}"
            )


@dataclass(frozen=True)
class SlabFit:
    """What a wall may be made of.

    Parameters
    ----------
    material : str
        The likeliest material.
    thickness_m : float
        Its likeliest thickness.
    probabilities : dict of str to float
        Posterior probability of each candidate, all of them being as likely before.
    log_evidence : float
        Of the losses, all candidates together: what parts of a wall are compared by.
    residual_db : float
        Median absolute deviation of the losses from the fit, of the clean ones where there are some.
    samples, clean : int
        Losses that were used, and those of them whose noise is a tenth of a decibel or less.
    """

    material: str
    thickness_m: float
    probabilities: dict[str, float]
    log_evidence: float
    residual_db: float
    samples: int
    clean: int


def bounce_geometry(vertex_m: Array) -> tuple[Array, Array, Array]:
    """Cosine of incidence, and the parts of the field normal to and in the plane of incidence.

    Parameters
    ----------
    vertex_m : ndarray, shape (N, 3, 3)
        Anchor, bounce and agent.

    Returns
    -------
    cosine : ndarray, shape (N,)
        Of the angle between the ray and the wall's normal.
    electric, magnetic : ndarray, shape (N,)
        What the coefficients of transverse electric and magnetic waves are multiplied with in the gain
        between vertically polarised antennas.
    """
    legs = np.diff(vertex_m, axis=1)
    legs = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    incident, outgoing = legs[:, 0], legs[:, 1]
    normal = incident - outgoing
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    across = np.cross(incident, normal)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    upright = np.array([0.0, 0.0, 1.0])
    across = np.where(size > 1e-9, across / np.maximum(size, 1e-12), upright)
    sent, received = spherical_basis(incident)[:, 0], spherical_basis(-outgoing)[:, 0]
    electric = np.sum(sent * across, axis=1) * np.sum(received * across, axis=1)
    along_in, along_out = np.cross(across, incident), np.cross(across, outgoing)
    magnetic = np.sum(sent * along_in, axis=1) * np.sum(received * along_out, axis=1)
    return np.abs(np.sum(incident * normal, axis=1)), electric, magnetic


def fit_slab(
    vertex_m: Array,
    loss_db: Array,
    noise_db: Array,
    carrier_hz: float,
    search: SlabSearch | None = None,
    prior: dict[str, float] | None = None,
) -> SlabFit:
    """Compare slabs with the losses of single bounces off a wall.

    Parameters
    ----------
    vertex_m : ndarray, shape (N, 3, 3)
        Anchor, bounce and agent of each.
    loss_db, noise_db : ndarray, shape (N,)
        Loss beyond free space, and its standard deviation.
    carrier_hz : float
        Carrier frequency.
    search : SlabSearch, optional
        How.
    prior : dict, optional
        Probability of each material before, by default all alike.

    Raises
    ------
    InputError
        If there is no loss, or a material is not defined at this frequency.
    """
    search = search or SlabSearch()
    if not len(loss_db):
        raise InputError("loss_db: expected losses of a wall's reflections, got none")
    use = _chosen(noise_db, search.most_samples)
    cosine, electric, magnetic = bounce_geometry(vertex_m[use])
    scale = np.hypot(noise_db[use], search.floor_db)
    thickness = np.arange(search.thinnest_m, search.thickest_m, search.step_m)
    weight = np.log(1.0 / thickness)  # before anything is measured, every factor of thickness is as likely
    weight -= np.logaddexp.reduce(weight)
    evidence, best = [], []
    for name in search.materials:
        fits = _log_likelihood(
            permittivity(name, carrier_hz),
            thickness,
            (cosine, electric, magnetic),
            loss_db[use],
            scale,
            carrier_hz,
            search,
        )
        before = 0.0 if prior is None else float(np.log(max(prior.get(name, 0.0), 1e-12)))
        evidence.append(float(np.logaddexp.reduce(fits + weight)) + before)
        best.append(int(np.argmax(fits)))
    share = np.exp(np.array(evidence) - np.logaddexp.reduce(evidence))
    first = int(np.argmax(share))
    chosen = float(thickness[best[first]])
    eta = permittivity(search.materials[first], carrier_hz)
    fitted = _losses(eta, np.array([chosen]), (cosine, electric, magnetic), carrier_hz)[0]
    clean = noise_db[use] <= _CLEAN_DB
    judged = clean if clean.sum() >= _LEAST_CLEAN else np.ones(len(use), dtype=bool)
    return SlabFit(
        search.materials[first],
        chosen,
        {name: float(p) for name, p in zip(search.materials, share, strict=True)},
        float(np.logaddexp.reduce(evidence) - np.log(len(evidence)) - np.log(scale).sum()),
        float(np.median(np.abs(loss_db[use] - fitted)[judged])),
        len(use),
        int(clean.sum()),
    )


def _chosen(noise_db: Array, most: int) -> NDArray[np.int64]:
    """The least noisy samples, spread over the run."""
    order = np.argsort(noise_db, kind="stable")
    clean = order[noise_db[order] <= 2.0 * noise_db[order[0]]]
    picked = clean if len(clean) >= min(most, len(order)) else order[:most]
    step = np.linspace(0, len(picked) - 1, min(most, len(picked)))
    return np.asarray(np.sort(picked[np.unique(step.astype(np.int64))]))


def _losses(eta: complex, thickness: Array, geometry: Sequence[Array], carrier_hz: float) -> Array:
    """Losses (thicknesses, samples) of slabs, dB."""
    cosine, electric, magnetic = geometry
    te, tm = slab_reflection(cosine[None], eta, thickness[:, None], carrier_hz)  # type: ignore[arg-type]
    gain = np.abs(te * electric + tm * magnetic)
    return np.asarray(-20.0 * np.log10(np.maximum(gain, 1e-6)))


def _log_likelihood(
    eta: complex,
    thickness: Array,
    geometry: Sequence[Array],
    loss_db: Array,
    scale: Array,
    carrier_hz: float,
    search: SlabSearch,
) -> Array:
    """Log likelihood of the losses for each thickness, shape (thicknesses,)."""
    total = np.empty(len(thickness))
    for first in range(0, len(thickness), 256):  # some megabytes at a time
        part = slice(first, first + 256)
        gap = (_losses(eta, thickness[part], geometry, carrier_hz) - loss_db) / scale
        total[part] = -0.5 * (search.freedom + 1.0) * np.log1p(gap**2 / search.freedom).sum(axis=1)
    return total
