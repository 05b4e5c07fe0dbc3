"""Point targets in the echo: the radar equation, what hides them, and both models of the echo."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan, Target
from raytrace.propagation.scene import RadioScene, build_scene
from raytrace.radio.echo import sweep_echo
from raytrace.radio.targets import target_returns

PLACE = np.array([10.0, 15.0, 1.5])


def furnished(*targets: dict[str, object], **changes: object) -> FloorPlan:
    data = load_floorplan("l-room").model_dump(mode="json", exclude_none=True)
    data["targets"] = [{"name": f"t{index}", **target} for index, target in enumerate(targets)]
    return updated(parse_floorplan(data), {"agent.epochs": 1, **changes})


def at(range_m: float, azimuth_rad: float, rcs_m2: float) -> dict[str, object]:
    offset = range_m * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    return {"position_m": (PLACE + offset).tolist(), "rcs_m2": rcs_m2}


@pytest.fixture(scope="module")
def empty() -> tuple[FloorPlan, RadioScene]:
    plan = furnished()
    return plan, build_scene(plan, plan.echo.carrier_hz)


@pytest.mark.parametrize("model", ["physical", "radar-equation"])
def test_power_follows_the_radar_equation(empty: tuple[FloorPlan, RadioScene], model: str) -> None:
    """In the beam that looks at it a target returns ``lambda^2 sigma G^2 / ((4 pi)^3 d^4)`` within 0.1 dB.

    What is added to the sweep of the empty room is the target's return alone; ranges and
    sections span a factor of 16 and 1000, so the exponents of both are tested, too.
    """
    plan, radio = empty
    plan = updated(plan, {"echo.model": model})
    without = sweep_echo(plan, radio).response[0]
    beams, grid = plan.echo.beams.beam_set(), plan.echo.grid()
    beam = 5
    azimuth = float(beams.azimuths()[beam])
    gain = np.abs(beams.two_way(azimuth)[beam]) ** 2
    assert gain == pytest.approx((16 * 10**0.8) ** 2, rel=0.6)  # 16 elements, 8 dBi each, off boresight
    wavelength = SPEED_OF_LIGHT_M_S / plan.echo.carrier_hz
    for range_m, section in ((1.5, 0.01), (6.0, 1.0), (24.0, 10.0)):
        plan_with = furnished(at(range_m, azimuth, section), **{"echo.model": model})
        added = sweep_echo(plan_with, radio).response[0, beam] - without[beam]
        delay = 2.0 * np.hypot(range_m, 0.5 * plan.echo.separation_m) / SPEED_OF_LIGHT_M_S
        matched = np.mean(added * np.exp(2j * np.pi * grid.offsets_hz() * delay))
        expected = wavelength**2 * section * gain / ((4 * np.pi) ** 3 * range_m**4)
        assert abs(10 * np.log10(np.abs(matched) ** 2 / expected)) < 0.1
        phase = np.exp(-2j * np.pi * plan.echo.carrier_hz * delay)
        assert np.angle(matched * np.conj(phase * beams.two_way(azimuth)[beam])) == pytest.approx(
            0.0, abs=0.05
        )


def test_walls_hide_targets() -> None:
    """Behind the inner corner of the L a target is not heard; the count says how many are."""
    seen, hidden = (
        {"position_m": [20.0, 20.0, 1.0], "rcs_dbsm": 0.0},
        {"position_m": [60.0, 55.0, 1.0], "rcs_m2": 1.0},
    )
    plan = furnished(seen, hidden)
    returns = target_returns(plan, PLACE, PLACE)
    assert len(returns) == 1
    np.testing.assert_allclose(returns.delay_s * SPEED_OF_LIGHT_M_S, 2 * np.linalg.norm([10.0, 5.0, 0.5]))
    sweep = sweep_echo(plan)
    assert sweep.targets == 1
    assert sweep.as_dict()["targets"] == 1
    assert "targets" not in sweep_echo(furnished()).as_dict()
    assert len(target_returns(furnished(), PLACE, PLACE)) == 0


def test_decibels_over_a_square_metre() -> None:
    """``rcs_dbsm`` is ten times the logarithm of ``rcs_m2``."""
    target = Target(name="person", position_m=(1.0, 1.0, 1.0), rcs_dbsm=-3.0)
    assert target.section_m2 == pytest.approx(0.501, rel=1e-3)
    assert Target(name="chair", position_m=(1.0, 1.0, 1.0), rcs_m2=0.2).section_m2 == 0.2
