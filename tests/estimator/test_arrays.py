"""Arrays and beams against phases from geometry and power from integration."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.arrays import BeamSet, UniformLinearArray, UniformPlanarArray, element_gain
from estimator.errors import ConfigurationError


@pytest.mark.parametrize("boresight", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("azimuth", [0.1, 1.2, -2.0, 3.0])
@pytest.mark.parametrize("elevation", [0.0, -0.4])
def test_steering_is_the_phase_of_a_plane_wave(boresight: float, azimuth: float, elevation: float) -> None:
    """Element m leads by the projection of its place on the direction that the wave comes from."""
    array = UniformLinearArray(5, 0.4, boresight)
    axis = np.array([np.cos(boresight + np.pi / 2), np.sin(boresight + np.pi / 2), 0.0])
    places = (np.arange(5) - 2.0)[:, None] * 0.4 * axis  # wavelengths
    towards = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    np.testing.assert_allclose(
        array.steering(azimuth, elevation), np.exp(2j * np.pi * places @ towards), atol=1e-12
    )


def test_steering_broadcasts() -> None:
    """Shapes of azimuth and elevation broadcast; elements are the last axis."""
    array = UniformLinearArray(4)
    assert array.steering(np.zeros((3, 1)), np.zeros(2)).shape == (3, 2, 4)
    assert array.steering(0.0).shape == (4,)
    np.testing.assert_allclose(UniformLinearArray().steering([0.3, 1.0]), 1.0)


def test_element_pattern_is_that_of_the_standard() -> None:
    """8 dBi ahead, 3 dB less at half the 65 degree beam width, -22 dBi behind, in all branches."""

    def level(offset_deg: float, elevation_deg: float = 0.0) -> float:
        return float(20.0 * np.log10(element_gain(np.deg2rad(offset_deg), np.deg2rad(elevation_deg))))

    assert level(0.0) == pytest.approx(8.0)
    assert level(32.5) == pytest.approx(5.0)
    assert level(0.0, -32.5) == pytest.approx(5.0)
    assert level(180.0) == pytest.approx(-22.0)
    assert level(180.0, 80.0) == pytest.approx(-22.0)
    assert level(350.0) == pytest.approx(level(-10.0))


@pytest.mark.parametrize("panels", [1, 3, 4])
def test_beams_look_all_around(panels: int) -> None:
    """Beam directions lie inside their panel's sector and are uniform in sine."""
    beams = BeamSet(panels=panels, elements=16, beams=16 * panels, heading_rad=0.4)
    azimuths = beams.azimuths().reshape(panels, 16)
    offsets = azimuths - beams.panel_boresights()[:, None]
    np.testing.assert_allclose(offsets, np.tile(beams.beam_offsets(), (panels, 1)), atol=1e-12)
    assert np.all(np.abs(offsets) < min(np.pi / panels, np.pi / 2))
    steps = np.diff(np.sin(beams.beam_offsets()))
    np.testing.assert_allclose(steps, steps[0])


def test_every_direction_has_a_beam() -> None:
    """The best of 64 beams is nowhere more than 8 dB below the best direction."""
    response = np.abs(BeamSet().one_way(np.linspace(-np.pi, np.pi, 2000)))
    best = 20.0 * np.log10(response.max(axis=1))
    assert best.max() - best.min() < 8.0


def test_gain_at_the_centre_of_a_beam() -> None:
    """Unit-norm weights add up in voltage: the two-way amplitude is elements times gain squared."""
    beams = BeamSet(panels=4, elements=16, beams=64, heading_rad=-0.2)
    response = beams.two_way(beams.azimuths())
    offset = np.tile(beams.beam_offsets(), 4)
    np.testing.assert_allclose(np.diag(response), 16.0 * element_gain(offset) ** 2, rtol=1e-9)
    strongest = np.abs(response).argmax(axis=1)
    np.testing.assert_array_equal(strongest, np.arange(64))


def test_beams_of_a_panel_are_orthonormal_where_spacing_allows() -> None:
    """Weights have unit norm: power summed over a full set of orthogonal beams is conserved."""
    array = UniformLinearArray(16, 0.5)
    beams = BeamSet(panels=1, elements=16, beams=16)
    weights = array.steering(beams.beam_offsets()) / 4.0
    np.testing.assert_allclose(weights @ weights.conj().T, np.eye(16), atol=1e-12)


def test_one_way_broadcasts() -> None:
    """Directions of any shape; beams are the last axis."""
    beams = BeamSet(panels=2, elements=4, beams=8)
    assert beams.one_way(0.1).shape == (8,)
    assert beams.one_way(np.zeros((3, 1)), np.zeros(5)).shape == (3, 5, 8)
    np.testing.assert_allclose(beams.two_way([0.3]), beams.one_way([0.3]) ** 2)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: UniformLinearArray(0), "elements: expected at least 1, got 0"),
        (lambda: UniformLinearArray(2, 0.0), "spacing_wavelengths: expected a positive number, got 0"),
        (lambda: UniformLinearArray(2, float("nan")), "spacing_wavelengths: .* got nan"),
        (lambda: BeamSet(panels=0), "panels: expected at least 1, got 0"),
        (lambda: BeamSet(panels=3, beams=64), r"beams: expected a multiple of panels \(3\), got 64"),
        (lambda: BeamSet(spacing_wavelengths=-1.0), "spacing_wavelengths: .* got -1"),
    ],
)
def test_bad_arrays_are_refused(make: type[object], message: str) -> None:
    """The field, what was expected and what came are named."""
    with pytest.raises(ConfigurationError, match=message):
        make()


def test_planar_array_is_rows_of_linear_ones() -> None:
    """Element ``r C + c`` has the phase of its place: across by its column, up by its row."""
    rng = np.random.default_rng(5)
    azimuth, elevation = rng.uniform(-3, 3, 20), rng.uniform(-1.5, 1.5, 20)
    array = UniformPlanarArray(3, 4, 0.7, 0.5, 0.3)
    assert array.elements == 12
    steering = array.steering(azimuth, elevation)
    for row in range(3):
        for column in range(4):
            across = 0.5 * (column - 1.5) * np.cos(elevation) * np.sin(azimuth - 0.3)
            phase = 2 * np.pi * (across + 0.7 * (row - 1.0) * np.sin(elevation))
            np.testing.assert_allclose(steering[:, 4 * row + column], np.exp(1j * phase), atol=1e-12)
    flat = UniformPlanarArray(1, 4, 0.5, 0.5, 0.3).steering(azimuth, elevation)
    np.testing.assert_allclose(flat, UniformLinearArray(4, 0.5, 0.3).steering(azimuth, elevation), atol=1e-15)


@pytest.mark.parametrize("wrong", [{"rows": 0}, {"columns": 0}, {"row_spacing_wavelengths": 0.0}])
def test_impossible_planar_arrays(wrong: dict[str, float]) -> None:
    """Numbers that make no array are refused with what was expected."""
    with pytest.raises(ConfigurationError, match="expected"):
        UniformPlanarArray(**wrong)  # type: ignore[arg-type]
