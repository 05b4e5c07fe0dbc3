"""What a dataset's manifest says: the links, not the plan, and what came out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S, free_space_loss_db
from raytrace.dataset.output import Output
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.links import Echo, Radio
from raytrace.propagation.engine import engine_versions

__all__ = ["head", "statistics"]

_FRAME = "origin: agent's start (RP); axes: the agent's arrays at the start; metres, radians"


def head(plan: FloorPlan, seed: int, output: Output) -> dict[str, Any]:
    """What is known before anything is traced, and all that the estimator may know (JSON types).

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    seed : int
        Seed of the noise.
    output : Output
        How the dataset is cut, and what it holds.

    Raises
    ------
    BackendError
        If the plan's engine cannot run on this machine.
    """
    agent_array, beams = plan.radio.agent_array, plan.echo.beams.beam_set()
    return {
        "name": plan.name,
        "seed": seed,
        "scene": {
            "name": plan.name,
            "sha256": plan.sha256(),
            **({"georeference": plan.georeference.model_dump()} if plan.georeference else {}),
        },
        "anchors": [anchor.name for anchor in plan.anchors],
        "epochs": plan.agent.epochs,
        "agent": {"max_speed_m_s": plan.agent.largest_speed_m_s},
        "frame": _FRAME,
        "versions": engine_versions(plan),
        "radio": {
            **_signal(plan.radio),
            "eirp_dbm": plan.radio.eirp_dbm,
            **plan.radio.model_dump(include={"snapshots", "snapshot_interval_s", "anchor_array"}),
            "agent_array": {
                "elements": agent_array.elements,
                "spacing_wavelengths": agent_array.spacing_wavelengths,
                "boresight_rad": agent_array.boresight_rad,
                **agent_array.model_dump(exclude={"elements", "spacing_wavelengths", "boresight_deg"}),
                **({} if plan.agent.orientation == "fixed" else {"orientation": plan.agent.orientation}),
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
        "output": output.as_dict(),
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


def statistics(
    plan: FloorPlan, shards: Iterable[Mapping[str, Any]], line_of_sight_s: NDArray[np.float64]
) -> dict[str, Any]:
    """What came out, over all shards (JSON types).

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    shards : iterable of mapping
        The manifest's entries.
    line_of_sight_s : ndarray, shape (n,)
        Delays of all lines of sight, seconds; the median of their SNR over all tones is given.

    Returns
    -------
    dict
        ``passive``: paths expected, found, missing, extra and traced again, diffuse paths,
        and the SNR; ``echo``: the same of the returns.
    """
    passive: Counter[str] = Counter()
    echo: Counter[str] = Counter()
    for entry in shards:
        passive.update({**entry.get("check", {}), **entry.get("others", {})})
        passive.update({"diffuse": entry["diffuse"]} if "diffuse" in entry else {})
        echo.update(entry.get("returns", {}))
    snr_db = None
    if line_of_sight_s.size:
        grid = plan.radio.grid()
        loss_db = free_space_loss_db(line_of_sight_s * SPEED_OF_LIGHT_M_S, grid.carrier_hz)
        noise_db = 10.0 * np.log10(plan.radio.noise_variance() / grid.tones)
        snr_db = round(float(np.median(-loss_db - noise_db)), 2)
    return {"passive": {**passive, "los_snr_db_median": snr_db}, "echo": dict(echo)}
