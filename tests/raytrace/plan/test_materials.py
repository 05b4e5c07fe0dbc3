"""The table of materials, and the reflection of a slab against textbook cases."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.materials import ITU_MATERIALS, frequency_ranges_hz, permittivity, slab_reflection
from raytrace.propagation.backend import prepare


def test_table_is_that_of_the_ray_tracer() -> None:
    """Names, ranges and coefficients equal Sionna's, so a validated plan can be traced."""
    prepare()
    from sionna.rt.radio_materials.itu import ITU_MATERIALS_PROPERTIES

    assert set(ITU_MATERIALS) == set(ITU_MATERIALS_PROPERTIES)
    for name, ranges in ITU_MATERIALS.items():
        theirs = [(tuple(limits), tuple(values)) for limits, values in ITU_MATERIALS_PROPERTIES[name].items()]
        assert list(ranges) == theirs


def test_concrete_at_28_ghz() -> None:
    """eps_r = 5.24 and sigma = 0.0462 * 28^0.7822 = 0.626 S/m give the loss by hand."""
    sigma = 0.0462 * 28.0**0.7822
    loss = sigma / (2 * np.pi * 28e9 * 8.8541878128e-12)
    assert permittivity("concrete", 28e9) == pytest.approx(5.24 - 1j * loss, rel=1e-12)


def test_range_and_name_are_checked() -> None:
    """A frequency between two ranges and a material that does not exist are told."""
    assert frequency_ranges_hz("concrete") == [(1e9, 100e9), (110e9, 330e9)]
    with pytest.raises(InputError, match="concrete: expected a frequency of 1 to 100 GHz or 110 to 330 GHz"):
        permittivity("concrete", 105e9)
    with pytest.raises(InputError, match="material: expected one of vacuum"):
        permittivity("cheese", 1e9)


def test_metal_reflects_everything() -> None:
    """A perfect conductor: -1 across the plane of incidence, +1 in it, at any angle."""
    te, tm = slab_reflection(np.linspace(0.05, 1.0, 20), permittivity("metal", 28e9), 0.01, 28e9)
    np.testing.assert_allclose(te, -1.0, atol=1e-2)
    np.testing.assert_allclose(tm, 1.0, atol=2e-2)


def test_half_wave_slab_is_transparent() -> None:
    """A lossless slab half a wavelength thick (inside) reflects nothing at normal incidence."""
    eta, frequency_hz = 4.0 + 0j, 28e9
    half_wave_m = 0.5 * SPEED_OF_LIGHT_M_S / frequency_hz / 2.0
    te, tm = slab_reflection(1.0, eta, half_wave_m, frequency_hz)
    assert abs(te) < 1e-12
    assert abs(tm) < 1e-12
    te, _ = slab_reflection(1.0, eta, 0.5 * half_wave_m, frequency_hz)
    assert abs(te) == pytest.approx((4.0 - 1.0) / (4.0 + 1.0))  # a quarter wave: (eta - 1) / (eta + 1)


def test_brewster_angle() -> None:
    """In the plane of incidence a lossless dielectric reflects nothing at tan(theta) = sqrt(eta)."""
    eta = 5.24 + 0j
    cosine = np.cos(np.arctan(np.sqrt(eta.real)))
    te, tm = slab_reflection(cosine, eta, 0.2, 28e9)
    assert abs(tm) < 1e-12
    assert abs(te) > 0.3


def test_thick_lossy_slab_is_a_half_space() -> None:
    """Nothing comes back from the far side of 20 cm of concrete: the slab is Fresnel's half-space."""
    eta = permittivity("concrete", 28e9)
    cosine = np.linspace(0.1, 1.0, 10)
    root = np.sqrt(eta - 1.0 + cosine**2)
    te, tm = slab_reflection(cosine, eta, 0.2, 28e9)
    np.testing.assert_allclose(te, (cosine - root) / (cosine + root), rtol=1e-6)
    np.testing.assert_allclose(tm, (eta * cosine - root) / (eta * cosine + root), rtol=1e-6)
