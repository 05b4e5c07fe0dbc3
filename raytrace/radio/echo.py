"""The active link: what the agent hears of its own beams.

Two models, chosen by the plan. ``physical``: the path solver's specular returns (the
flash off a wall at normal incidence, and returns over corners), plus diffuse ones where
materials scatter. ``radar-equation``: the paper's (7) on traced hits. In both, the
plan's targets return what the radar equation gives them, and bodies shadow flashes in the first.
Transmitter and receiver stand a few centimetres apart, one above the other, so that no
direction in the horizontal plane is preferred. Beams follow one another after
``echo.beam_interval_s``, in which every return turns by its Doppler shift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.directions import directions_of
from raytrace.propagation.engine import Scene, scene_of, specular_paths, traced
from raytrace.propagation.passive import TraceReport
from raytrace.propagation.paths import PathList
from raytrace.propagation.shadowing import shadowed
from raytrace.propagation.solver import solve
from raytrace.radio.channel import superpose
from raytrace.radio.radar_equation import radar_sweep
from raytrace.radio.targets import target_returns

__all__ = ["EchoSweep", "sweep_echo"]


@dataclass(frozen=True, eq=False)
class EchoSweep:
    """Noiseless responses of all beams, one sweep after the other.

    Parameters
    ----------
    epochs : tuple of int
        When each sweep took place.
    response : ndarray of complex128, shape (sweeps, beams, tones)
        Response of each beam, sending and receiving (dimensionless).
    specular : int
        Specular returns in all sweeps.
    diffuse : int
        Diffuse returns in all sweeps.
    report : TraceReport or None
        How the specular returns compare with the image method (physical model).
    targets : int
        Returns of point targets in all sweeps.
    """

    epochs: tuple[int, ...]
    response: NDArray[np.complex128]
    specular: int
    diffuse: int
    report: TraceReport | None
    targets: int = 0

    def as_dict(self) -> dict[str, int]:
        """The counts by name."""
        return {
            "specular": self.specular,
            "diffuse": self.diffuse,
            **({"targets": self.targets} if self.targets else {}),
            **({} if self.report is None else self.report.as_dict()),
        }


def sweep_echo(
    plan: FloorPlan, radio: Scene | None = None, epochs: tuple[int, ...] | None = None
) -> EchoSweep:
    """Sweep the agent's beams at some epochs.

    Parameters
    ----------
    plan : FloorPlan
        The plan; ``plan.echo`` is the link.
    radio : RadioScene or ImageScene, optional
        Its scene at the carrier of ``plan.echo``; by default it is built.
    epochs : tuple of int, optional
        When to sweep, at least once; by default as ``plan.sweep_epochs`` says.

    Raises
    ------
    BackendError
        If the ray tracer cannot run on this machine.
    """
    radio = scene_of(plan, plan.echo.carrier_hz) if radio is None else radio
    epochs = plan.sweep_epochs if epochs is None else epochs
    places = plan.track()[list(epochs)]
    if plan.echo.model == "radar-equation":
        facts = zip(
            places, plan.headings_rad()[list(epochs)], plan.velocities_m_s()[list(epochs)], strict=True
        )
        responses = [radar_sweep(plan, radio, *fact) for fact in facts]
        sweep = EchoSweep(epochs, np.stack(responses), 0, 0, None)
    else:
        sweep = _physical(plan, radio, epochs, places)
    return _with_targets(plan, sweep, places) if plan.targets else sweep


def _physical(
    plan: FloorPlan, radio: Scene, epochs: tuple[int, ...], places: NDArray[np.float64]
) -> EchoSweep:
    responses, reports, specular, diffuse = [], [], 0, 0
    for epoch, place in zip(epochs, places, strict=True):
        sender, receiver = _ends(plan, place)
        paths, report = specular_paths(plan, radio, sender[None], receiver[None], plan.echo.depth)
        returns = paths.flat()
        returns = returns.select(returns.order > 0)
        reports.append(report)
        specular += len(returns)
        if plan.scatters:
            scattered = solve(
                traced(radio),
                sender,
                receiver[None],
                depth=1,
                samples=plan.echo.diffuse_samples,
                los=False,
                diffuse=True,
                most_paths=plan.echo.diffuse_samples,
            )
            diffuse += len(scattered)
            returns = PathList.concatenate([returns, scattered])
        returns = shadowed(
            plan, returns, receiver[None], plan.times_s()[[epoch]], sender[None], plan.echo.carrier_hz
        ).canonical()
        responses.append(_beams(plan, returns, epoch, _doppler_hz(plan, returns, epoch)))
    total = TraceReport(
        *(sum(values) for values in zip(*(r.as_dict().values() for r in reports), strict=True))
    )
    return EchoSweep(epochs, np.stack(responses), specular, diffuse, total)


def _ends(plan: FloorPlan, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where transmitter and receiver are: one above the other."""
    half = np.array([0.0, 0.0, 0.5 * plan.echo.separation_m])
    return place + half, place - half


def _with_targets(plan: FloorPlan, sweep: EchoSweep, places: NDArray[np.float64]) -> EchoSweep:
    """The sweeps with what the targets return."""
    heard, count = [], 0
    for epoch, place in zip(sweep.epochs, places, strict=True):
        returns, shift_hz = target_returns(plan, *_ends(plan, place), epoch)
        heard.append(_beams(plan, returns, epoch, shift_hz))
        count += len(returns)
    return replace(sweep, response=sweep.response + np.stack(heard), targets=count)


def _doppler_hz(plan: FloorPlan, paths: PathList, epoch: int) -> NDArray[np.float64]:
    """Doppler shift of returns off what stands, (paths,): both ends approach or leave it."""
    ways = ("departure", "arrival")
    towards = sum(
        directions_of(getattr(paths, f"{way}_azimuth_rad"), getattr(paths, f"{way}_elevation_rad"))
        for way in ways
    )
    return np.asarray(towards @ plan.velocities_m_s()[epoch] * plan.echo.carrier_hz / SPEED_OF_LIGHT_M_S)


def _beams(
    plan: FloorPlan, paths: PathList, epoch: int, shift_hz: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Both directions of every path through every beam, summed on the tones, (beams, tones)."""
    beams, heading = plan.echo.beams.beam_set(), plan.headings_rad()[epoch]
    sent = beams.one_way(paths.departure_azimuth_rad - heading, paths.departure_elevation_rad)
    heard = beams.one_way(paths.arrival_azimuth_rad - heading, paths.arrival_elevation_rad)
    weights = (sent * heard * paths.amplitude[:, None]).T
    if plan.echo.beam_interval_s > 0.0:
        after_s = plan.echo.beam_interval_s * np.arange(len(weights))
        weights = weights * np.exp(2j * np.pi * after_s[:, None] * shift_hz)
    return superpose(weights, paths.delay_s, plan.echo.grid())
