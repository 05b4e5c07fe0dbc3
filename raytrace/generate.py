"""A dataset from a floor plan: trace, sum, add noise, write.

The noise of the passive channels and of the echo, timing jitter and calibration errors
come from separate streams of one seed; everything else has no chance in it. Equal plans
and seeds give equal bytes. What the estimator may read (channels, beams) and the truth
(plan, anchors, track) go to different files; see :mod:`estimator.dataset` for the layout.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from estimator.dataset import Dataset, DatasetWriter, open_dataset, require_absent
from estimator.errors import ConfigurationError, FileFormatError
from estimator.waveform import free_space_loss_db
from raytrace.backend import prepare
from raytrace.channel import add_noise, channel_response
from raytrace.echo import EchoSweep, sweep_echo
from raytrace.floorplan import FloorPlan
from raytrace.impairments import jitter, miscalibrate
from raytrace.links import Echo, Radio
from raytrace.passive import TraceReport, trace_passive
from raytrace.scattering import diffuse_response
from raytrace.scene import build_scene
from raytrace.shards import echo_shard, passive_shard, paths_shard, truth_shard

__all__ = ["Generated", "generate"]

Progress = Callable[[int, int, str], None]

_STAGES = ("starting the ray tracer", "tracing paths", "summing channels", "sweeping beams", "writing")


@dataclass(frozen=True)
class Generated:
    """What :func:`generate` made.

    Parameters
    ----------
    dataset : Dataset
        The dataset, opened.
    seconds : mapping of str to float
        Wall-clock seconds of each stage (never written to the dataset).
    report : TraceReport
        How the passive paths compare with the image method.
    """

    dataset: Dataset
    seconds: Mapping[str, float]
    report: TraceReport


def generate(plan: FloorPlan, out: Path, seed: int, progress: Progress | None = None) -> Generated:
    """Trace a plan and write the dataset.

    Parameters
    ----------
    plan : FloorPlan
        What to trace.
    out : Path
        Directory to create.
    seed : int
        Seed of the noise, not negative.
    progress : callable, optional
        Called with (stages done, stages in all, what comes next).

    Raises
    ------
    OutputExistsError
        If ``out`` exists; nothing is traced then.
    BackendError
        If the ray tracer cannot run on this machine.
    """
    out = Path(out)
    require_absent(out)
    if not out.parent.is_dir():
        raise FileFormatError(f"{out}: expected an existing folder {out.parent}, there is none")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ConfigurationError(f"seed: expected an integer of at least 0, got {seed!r}")
    streams = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4))
    passive_rng, echo_rng, timing_rng, calibration_rng = streams
    stages = _Stages(progress)

    with stages("scene"):
        choice = prepare()
        radio = build_scene(plan, plan.radio.carrier_hz)
    with stages("passive"):
        paths, report = trace_passive(plan, radio)
    with stages("channels"):
        array = plan.radio.agent_array.array()
        response = channel_response(paths, plan.radio.grid(), array, plan.agent.heading_rad)
        diffuse_paths = 0
        if plan.scatters:
            diffuse, diffuse_paths = diffuse_response(plan, radio)
            response = response + diffuse
        response = jitter(response, plan.radio.grid(), plan.radio.timing_jitter_s, timing_rng)
        received = add_noise(response, plan.radio.noise_variance(), passive_rng)
    with stages("echo"):
        same = plan.echo.carrier_hz == plan.radio.carrier_hz
        sweep = sweep_echo(plan, radio if same else None)
        response = miscalibrate(
            sweep.response,
            plan.echo.grid(),
            plan.echo.gain_error_db,
            float(np.deg2rad(plan.echo.phase_error_deg)),
            plan.echo.range_error_m,
            calibration_rng,
        )
        heard = add_noise(response, plan.echo.noise_variance(), echo_rng)
    with stages("write"):
        writer = DatasetWriter(out, _manifest(plan, seed, choice.version))
        writer.write("passive", "passive-00000.nc", passive_shard(plan, received))
        writer.write("echo", "echo-00000.nc", echo_shard(plan, heard))
        writer.write("paths", "paths-00000.nc", paths_shard(plan, paths))
        writer.write("truth", "truth.nc", truth_shard(plan, paths))
        line_of_sight = paths.delay_s[paths.valid & (paths.order == 0)]
        writer.finish(statistics=_statistics(plan, report, diffuse_paths, sweep, line_of_sight))
    return Generated(open_dataset(out), stages.seconds, report)


class _Stages:
    """Times the stages and tells the progress."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        done = len(self.seconds)
        if self._progress is not None:
            self._progress(done, len(_STAGES), _STAGES[done])
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start
        if self._progress is not None and done + 1 == len(_STAGES):
            self._progress(len(_STAGES), len(_STAGES), "done")


def _manifest(plan: FloorPlan, seed: int, llvm: str) -> dict[str, Any]:
    """What the estimator may know: the links, not the plan."""
    agent_array, beams = plan.radio.agent_array.array(), plan.echo.beams.beam_set()
    packages = ("sionna-rt", "mitsuba", "drjit", "numpy")
    return {
        "name": plan.name,
        "seed": seed,
        "scene": {"name": plan.name, "sha256": plan.sha256()},
        "anchors": [anchor.name for anchor in plan.anchors],
        "epochs": plan.agent.epochs,
        "frame": "origin: agent's start (RP); axes: the agent's arrays at the start; metres, radians",
        "versions": {**{name: metadata.version(name) for name in packages}, "llvm": llvm},
        "radio": {
            **_signal(plan.radio),
            "eirp_dbm": plan.radio.eirp_dbm,
            "agent_array": {
                "elements": agent_array.elements,
                "spacing_wavelengths": agent_array.spacing_wavelengths,
                "boresight_rad": agent_array.boresight_rad,
            },
        },
        "echo": {
            **_signal(plan.echo),
            "tx_power_dbm": plan.echo.tx_power_dbm,
            "model": plan.echo.model,
            "beams": {
                "panels": beams.panels,
                "elements": beams.elements,
                "beams": beams.beams,
                "spacing_wavelengths": beams.spacing_wavelengths,
                "heading_rad": beams.heading_rad,
            },
        },
        "tracing": plan.tracing.model_dump(mode="json"),
    }


def _signal(link: Radio | Echo) -> dict[str, Any]:
    return {
        "carrier_hz": link.carrier_hz,
        "subcarrier_spacing_hz": link.subcarrier_spacing_hz,
        "subcarriers": link.subcarriers,
        "comb": link.comb,
        "symbols": link.symbols,
        "noise_figure_db": link.noise_figure_db,
        "noise_variance": link.noise_variance(),
    }


def _statistics(
    plan: FloorPlan,
    report: TraceReport,
    diffuse_paths: int,
    sweep: EchoSweep,
    line_of_sight_s: np.ndarray[Any, np.dtype[np.float64]],
) -> dict[str, Any]:
    """What came out: paths found and lost, and the SNR of the line of sight over all tones."""
    grid = plan.radio.grid()
    snr_db = None
    if line_of_sight_s.size:
        loss_db = free_space_loss_db(line_of_sight_s * 299_792_458.0, grid.carrier_hz)
        noise_db = 10.0 * np.log10(plan.radio.noise_variance() / grid.tones)
        snr_db = round(float(np.median(-loss_db - noise_db)), 2)
    return {
        "passive": {**report.as_dict(), "diffuse": diffuse_paths, "los_snr_db_median": snr_db},
        "echo": {
            "specular": sweep.specular,
            "diffuse": sweep.diffuse,
            **({} if sweep.report is None else sweep.report.as_dict()),
        },
    }
