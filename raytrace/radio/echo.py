"""The active link: what the agent hears of its own beams.

Two models, chosen by the plan. ``physical``: the path solver's specular returns (the
flash off a wall at normal incidence, and returns over corners), plus diffuse ones where
materials scatter. ``radar-equation``: the paper's (7) on traced hits. In both, the
plan's point targets return what the radar equation gives them. Transmitter
and receiver stand a few centimetres apart, one above the other, so that no
direction in the horizontal plane is preferred.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.engine import Scene, scene_of, specular_paths, traced
from raytrace.propagation.passive import TraceReport
from raytrace.propagation.paths import PathList
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
        headings = plan.headings_rad()[list(epochs)]
        responses = [
            radar_sweep(plan, radio, place, heading) for place, heading in zip(places, headings, strict=True)
        ]
        sweep = EchoSweep(epochs, np.stack(responses), 0, 0, None)
    else:
        sweep = _physical(plan, radio, epochs, places)
    return _with_targets(plan, sweep, places) if plan.targets else sweep


def _physical(
    plan: FloorPlan, radio: Scene, epochs: tuple[int, ...], places: NDArray[np.float64]
) -> EchoSweep:
    responses, reports, specular, diffuse = [], [], 0, 0
    for place, heading in zip(places, plan.headings_rad()[list(epochs)], strict=True):
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
        responses.append(_beams(plan, returns.canonical(), heading))
    total = TraceReport(
        *(sum(values) for values in zip(*(r.as_dict().values() for r in reports), strict=True))
    )
    return EchoSweep(epochs, np.stack(responses), specular, diffuse, total)


def _ends(plan: FloorPlan, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where transmitter and receiver are: one above the other."""
    half = np.array([0.0, 0.0, 0.5 * plan.echo.separation_m])
    return place + half, place - half


def _with_targets(plan: FloorPlan, sweep: EchoSweep, places: NDArray[np.float64]) -> EchoSweep:
    """The sweeps with what the point targets return."""
    returns = [target_returns(plan, *_ends(plan, place)) for place in places]
    headings = plan.headings_rad()[list(sweep.epochs)]
    heard = [_beams(plan, paths, heading) for paths, heading in zip(returns, headings, strict=True)]
    count = sum(len(paths) for paths in returns)
    return replace(sweep, response=sweep.response + np.stack(heard), targets=count)


def _beams(plan: FloorPlan, paths: PathList, heading: float) -> NDArray[np.complex128]:
    """Both directions of every path through every beam, summed on the tones, (beams, tones)."""
    beams = plan.echo.beams.beam_set()
    sent = beams.one_way(paths.departure_azimuth_rad - heading, paths.departure_elevation_rad)
    heard = beams.one_way(paths.arrival_azimuth_rad - heading, paths.arrival_elevation_rad)
    return superpose((sent * heard * paths.amplitude[:, None]).T, paths.delay_s, plan.echo.grid())
