"""What the estimator costs: SLAM steps, channel estimation and active sensing, CPU time on one core.

The room is the L-shaped one of the paper's Section V-E with its synthetic measurements: 236 epochs, two
anchors, everything unknown unless a row says otherwise.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from estimator.arrays import BeamSet
from estimator.channel.model import delay_atoms
from estimator.channel.nomp import NompPlan
from estimator.experiments.room import Room, make_room
from estimator.sensing.flash import find_flashes
from estimator.sensing.linefit import fit_lines
from estimator.sensing.ranges import sweep_response
from estimator.simulate import SimulationConfig
from estimator.slam import GaussianConfig, GaussianEngine, Prior, epoch_rng
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.run import config_for, engine_for
from estimator.threads import one_blas_thread
from estimator.waveform import OfdmGrid
from service.bench.rows import Row, cpu_s

__all__ = ["rows"]

_CORNERS_M = ((0, 0), (0, 40), (50, 40), (50, 60), (80, 60), (80, 0))
_ANCHORS_M = ((68.0, 6.0), (42.0, 36.0))
_WAYPOINTS_M = np.array([(10, 15), (70, 9), (73.5, 12), (70, 48), (66, 52.5), (54, 55)], dtype=np.float64)
_EPOCHS = 236
_PARTICLES, _BATCH, _PATHS, _FITS = 100_000, 64, 15, 1000
_RUNS = 50
_STEP_BAR_MS, _BATCH_BAR_MS, _NOMP_BAR_MS = 2.0, 0.25, 15.0
_PEER = "belief propagation SLAM of its authors, 1e5 particles (as stated)"
_PEER_MS, _PEER_FEATURES = 293.0, 11  # a step with two anchors
_GRID = OfdmGrid(28e9, 120e3, 3276, comb=4, symbols=14)


def rows(quick: bool) -> Iterator[Row]:
    """Measure row by row.

    Parameters
    ----------
    quick : bool
        Fewer repetitions: seconds rather than a minute.
    """
    with one_blas_thread():
        alone = _gaussian_step(40 if quick else _EPOCHS)
        yield alone
        if not quick:  # fifty runs, whose first epochs are the dearest
            yield from _gaussian_batch(_EPOCHS, alone)
        for method in ("hybrid", "va"):
            yield _particle_step(method, 6 if quick else 40)
        repeats = 1 if quick else 7
        yield _nomp(repeats)
        yield _flash(repeats)
        yield _line_fit(repeats)


def _room() -> Room:
    """The paper's room."""
    corners = np.array(_CORNERS_M, dtype=np.float64)
    legs = np.linalg.norm(np.diff(_WAYPOINTS_M, axis=0), axis=1)
    reached = np.concatenate([[0.0], np.cumsum(legs)])
    walked = np.linspace(0.0, reached[-1], _EPOCHS)
    track = np.stack([np.interp(walked, reached, axis) for axis in _WAYPOINTS_M.T], axis=1)
    return make_room("paper", corners, np.roll(corners, -1, axis=0), _ANCHORS_M, track)


def _gaussian_step(epochs: int) -> Row:
    """A run alone, hypotheses of the first epochs included."""
    measurements = _room().measure(SimulationConfig(), 1)
    engine = engine_for("hybrid", "gaussian", config_for(measurements))

    def run() -> None:
        state = engine.start(Prior.of(measurements), epoch_rng(1, -1))
        for epoch in measurements.epochs[:epochs]:
            state = engine.step(state, epoch, epoch_rng(1, epoch.index))

    milliseconds = 1e3 * cpu_s(run, 1) / epochs
    return Row(f"gaussian engine, hybrid, alone: step (mean of {epochs})", milliseconds, "ms", _STEP_BAR_MS)


def _gaussian_batch(epochs: int, alone: Row) -> Iterator[Row]:
    """Runs stepped together: the usual step, and the mean, the first epochs' many hypotheses included."""
    room = _room()
    measured = [room.measure(SimulationConfig(), 1 + i) for i in range(_RUNS)]
    config = config_for(measured[0])
    assert isinstance(config, GaussianConfig)
    engine = GaussianEngine(config)
    states = [engine.start(Prior.of(each), epoch_rng(1, -1)) for each in measured]
    taken = []
    for t in range(epochs):
        begin = time.process_time()
        states = engine.step_many(states, [each.epochs[t] for each in measured])
        taken.append(1e3 * (time.process_time() - begin) / _RUNS)
    name = f"gaussian engine, hybrid, {_RUNS} runs together: step of one"
    yield Row(f"{name} (median of {epochs})", float(np.median(taken)), "ms", _BATCH_BAR_MS)
    mean = float(np.mean(taken))
    yield Row(f"{name} (mean)", mean, "ms", None, "the same engine, a run alone (mean)", alone.value)


def _particle_step(method: str, epochs: int) -> Row:
    """Steps of the particle engine, beside what its peer would take for as many features.

    A feature is what one anchor may be heard over: the anchor itself, and each wall or virtual anchor.
    """
    measurements = _room().measure(SimulationConfig(), 1, know_anchors=True)
    config = config_for(measurements, ParticleConfig(particles=_PARTICLES))
    engine = engine_for(method, "particle", config)
    state = engine.start(Prior.of(measurements), epoch_rng(1, -1))
    taken: list[tuple[float, int]] = []
    for epoch in measurements.epochs[:epochs]:
        begin = time.process_time()
        state = engine.step(state, epoch, epoch_rng(1, epoch.index))
        owners = state.features.owner
        taken.append(
            (time.process_time() - begin, int(np.sum(np.where(owners < 0, len(epoch.paths), 1))) + 2)
        )
    seconds, features = np.median(taken[epochs // 2 :], axis=0).tolist()
    return Row(
        f"particle engine, {method}, {_PARTICLES:.0e} particles, {features:.0f} features: step",
        1e3 * seconds,
        "ms",
        0.5 * _PEER_MS * features / _PEER_FEATURES,
        _PEER,
        _PEER_MS * features / _PEER_FEATURES,
    )


def _nomp(repeats: int) -> Row:
    """Delays of channels with 15 paths over 28 dB, in a batch."""
    rng = np.random.default_rng(1)
    shape = (_BATCH, _PATHS)
    cells = np.sort(rng.uniform(10.0, 200.0, shape), axis=1) + 1.5 * np.arange(_PATHS)
    amplitude = rng.permuted(np.tile(10.0 ** (-0.1 * np.arange(_PATHS)), (_BATCH, 1)), axis=1)
    gain = amplitude * np.exp(2j * np.pi * rng.uniform(size=shape))
    cfr = np.einsum("ck,ckn->cn", gain, delay_atoms(_GRID, cells * _GRID.resolution_s))
    cfr += np.sqrt(0.5e-4) * (rng.normal(size=cfr.shape) + 1j * rng.normal(size=cfr.shape))
    plan = NompPlan(_GRID)
    taken = cpu_s(lambda: plan.estimate(cfr, 1e-4), repeats)
    name = f"NOMP, {_GRID.tones} tones, {_PATHS} paths, batches of {_BATCH}: channel"
    return Row(name, 1e3 * taken / _BATCH, "ms", _NOMP_BAR_MS)


def _flash(repeats: int) -> Row:
    """Walls from the flashes of a sweep of 64 beams in a room of four walls."""
    rng = np.random.default_rng(1)
    beams = BeamSet(panels=4, elements=16, beams=64)
    azimuth, distance = np.deg2rad([180.0, -90.0, 90.0, 0.0]), np.array([10.0, 15.0, 25.0, 70.0])
    noise = _GRID.noise_variance(10.0, 7.0)
    amplitude = 0.4 * _GRID.wavelength_m / (8.0 * np.pi * distance)
    echo = sweep_response(_GRID, beams, azimuth, distance, amplitude)
    echo = echo + np.sqrt(0.5 * noise) * (rng.normal(size=echo.shape) + 1j * rng.normal(size=echo.shape))
    taken = cpu_s(lambda: find_flashes(echo, noise, _GRID, beams), repeats)
    return Row(f"flashes, 64 beams, {_GRID.tones} tones, 4 walls: sweep", 1e3 * taken, "ms")


def _line_fit(repeats: int) -> Row:
    """Maximum-likelihood walls through 16 ranges each."""
    rng = np.random.default_rng(1)
    azimuth = np.linspace(-0.9, 0.9, 16)
    distance = 10.0 / np.cos(azimuth) + 0.2 * rng.normal(size=(_FITS, 16))
    taken = cpu_s(lambda: fit_lines(distance, 0.2, azimuth), repeats)
    return Row(f"line fit, 16 ranges, batches of {_FITS}: wall", 1e6 * taken / _FITS, "us")
