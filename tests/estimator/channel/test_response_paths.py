"""Responses from files become ranges: of taps and of tones, with a pulse, a calibration and an alignment."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from estimator.channel.response_paths import ResponseConfig, ranges_of
from estimator.channel.taps import tones_of_taps
from estimator.errors import ConfigurationError, InputError
from estimator.readers.response_files import read_responses
from estimator.waveform import SPEED_OF_LIGHT_M_S

TAP_S, TAPS, BAND_HZ = 1e-9, 256, 500e6
TAP_M = TAP_S * SPEED_OF_LIGHT_M_S


def pulse_at(late_taps: np.ndarray, echo: float) -> np.ndarray:
    """A pulse whose top is 4 taps after its beginning, with an echo of the device two taps later."""
    wide = 0.9
    return np.exp(-0.5 * ((late_taps - 4.0) / wide) ** 2) + echo * np.exp(
        -0.5 * ((late_taps - 6.0) / wide) ** 2
    )


def responses(delay_taps: np.ndarray, echo: float) -> np.ndarray:
    """CIRs (N, taps) of one path each, in a little noise."""
    cir = pulse_at(np.arange(TAPS) - delay_taps[:, None], echo)
    rng = np.random.default_rng(3)
    return cir + 1e-3 * (rng.normal(size=cir.shape) + 1j * rng.normal(size=cir.shape))


def of(delay_taps: np.ndarray, echo: float = 0.0) -> dict[str, np.ndarray]:
    """A log of two anchors that has what must be there."""
    return {
        "cir": responses(delay_taps, echo),
        "tap_s": np.array(TAP_S),
        "time_s": 0.1 * np.arange(len(delay_taps)),
        "anchor": 1 + np.arange(len(delay_taps)) % 2,
    }


DELAY = 60.0 + np.array([0.0, 0.3, 0.5, 0.9])


@pytest.mark.parametrize("suffix", ["npz", "mat", "h5"])
def test_taps_of_any_file_become_ranges(tmp_path: Path, suffix: str) -> None:
    """A path alone, in each kind of file: its length is its delay's, within what is claimed."""
    data, file = of(DELAY), tmp_path / f"log.{suffix}"
    data["pulse"] = pulse_at(np.arange(16.0), 0.0).astype(complex)
    parts = {}
    for name in ("cir", "pulse") if suffix != "npz" else ():
        whole = data.pop(name)
        parts |= {f"{name}_re": whole.real, f"{name}_im": whole.imag}
    if suffix == "npz":
        np.savez(file, **data)
    elif suffix == "mat":
        savemat(file, data | parts)
    else:
        with h5py.File(file, "w") as written:
            for name, array in (data | parts).items():
                written[name] = array
    log = ranges_of(read_responses(file), config=ResponseConfig(first_only=True))
    assert log.names == ("a1", "a2")
    np.testing.assert_array_equal(log.anchor, [0, 1, 0, 1])
    np.testing.assert_allclose(log.range_m, DELAY * TAP_M, atol=0.015)


def test_a_known_pulse_takes_the_echo_out(tmp_path: Path) -> None:
    """With the pulse, every response is one path where it is; the last axis may be the parts of numbers."""
    data = of(DELAY, echo=0.8)
    whole = np.stack([data["cir"].real, data["cir"].imag], axis=-1)
    pulse = pulse_at(np.arange(16.0), 0.8).astype(complex)
    np.savez(tmp_path / "log.npz", **(data | {"cir": whole, "pulse": pulse}))
    log = read_responses(tmp_path / "log.npz", ("east", "west"))
    found = ranges_of(log)
    assert found.names == ("east", "west")
    assert len(found.range_m) == len(DELAY)
    np.testing.assert_allclose(found.range_m, DELAY * TAP_M, atol=0.015)


def test_an_unknown_pulse_is_a_bias_of_all_ranges(tmp_path: Path) -> None:
    """Of a band that is not flat the first path is off by a constant of the device, wherever it is."""
    np.savez(tmp_path / "log.npz", bandwidth_hz=BAND_HZ, **of(DELAY, echo=0.3))
    found = ranges_of(read_responses(tmp_path / "log.npz"), config=ResponseConfig(first_only=True))
    bias = found.range_m - DELAY * TAP_M
    assert np.all(np.abs(bias - bias.mean()) < 0.1)
    assert 2.0 * TAP_M < bias.mean() < 6.0 * TAP_M


def test_a_device_that_tells_its_first_path_is_followed(tmp_path: Path) -> None:
    """The range logged belongs to the tap logged, wherever in the accumulator that was."""
    data = of(DELAY + 100.0)
    told = DELAY + 100.0 + np.array([0.5, -1.0, 0.2, 2.0])
    length = np.array([3.0, 4.0, 5.0, 6.0])
    data["pulse"] = pulse_at(np.arange(16.0), 0.0).astype(complex)
    np.savez(tmp_path / "log.npz", first_path_tap=told, range_m=length, **data)
    found = ranges_of(read_responses(tmp_path / "log.npz"), config=ResponseConfig(first_only=True))
    off = (DELAY + 100.0 - told) * TAP_M
    np.testing.assert_allclose(found.range_m, length + off, atol=0.015)


def test_tones_are_taken_with_their_calibration(tmp_path: Path) -> None:
    """Frequency responses of two paths through a filter with delay: calibrated, both are where they are."""
    tones, spacing = 128, 4e6
    offset = spacing * (np.arange(tones) - 0.5 * (tones - 1))
    device = (1.0 + 0.4 * np.cos(offset / 60e6)) * np.exp(-2j * np.pi * offset * 20e-9)
    delay = np.array([40e-9, 70e-9])
    rng = np.random.default_rng(4)
    cfr = device * (np.array([1.0, 0.5j]) @ np.exp(-2j * np.pi * delay[:, None] * offset))
    cfr = cfr + 1e-3 * (rng.normal(size=tones) + 1j * rng.normal(size=tones))
    file = tmp_path / "log.npz"
    common = {"cfr": cfr[None], "tone_spacing_hz": spacing, "time_s": [0.0], "anchor": [1]}
    np.savez(file, calibration=device, noise_variance=4e-6, **common)
    found = ranges_of(read_responses(file))
    np.testing.assert_allclose(found.range_m, delay * SPEED_OF_LIGHT_M_S, atol=0.02)
    assert found.range_std_m is not None
    assert np.all(found.range_std_m < 0.05)
    assert found.gain_db is not None
    assert found.gain_db[1] - found.gain_db[0] == pytest.approx(-6.0, abs=0.2)


def test_an_anchor_whose_response_is_noise_was_not_heard(tmp_path: Path) -> None:
    """Its row has no range; the anchor was asked."""
    data = of(DELAY)
    rng = np.random.default_rng(5)
    data["cir"][2] = 1e-4 * (rng.normal(size=TAPS) + 1j * rng.normal(size=TAPS))
    np.savez(tmp_path / "log.npz", bandwidth_hz=BAND_HZ, **data)
    found = ranges_of(read_responses(tmp_path / "log.npz"), config=ResponseConfig(first_only=True))
    np.testing.assert_array_equal(np.isfinite(found.range_m), [True, True, False, True])


def test_windows_and_pulses_that_cannot_be_meant() -> None:
    """A band without tones, a pulse longer than the window, a window that has no lead."""
    cir, first = responses(DELAY, 0.0), np.zeros(4, dtype=np.int64)
    with pytest.raises(InputError, match="expected two tones"):
        tones_of_taps(cir, TAP_S, first, 128, bandwidth_hz=1.0)
    with pytest.raises(InputError, match="at most the 16 taps"):
        tones_of_taps(cir, TAP_S, first, 16, pulse=np.ones(17, dtype=complex))
    with pytest.raises(ConfigurationError, match="a window and a part of it"):
        ResponseConfig(window_taps=8, lead_taps=8)
