"""Measurements and estimates as JSON text, exact to the last bit.

JSON numbers are written with as many digits as tell two doubles apart, so what is read
back equals what was written. Equal measurements give equal text: the measurement log is
compared and folded in this form.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, Odometry
from estimator.slam.protocol import Candidate, Estimate, Integrity

__all__ = [
    "dump",
    "epoch_text",
    "estimate_document",
    "odometry_entry",
    "read_epoch",
    "read_estimate",
    "read_sweep",
    "sweep_text",
]

Array = NDArray[np.float64]
_COLUMNS = tuple(entry.name for entry in fields(AnchorPaths))


def dump(value: object) -> str:
    """JSON in the shortest form; refuses NaN and infinity."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def epoch_text(epoch: Epoch) -> str:
    """An epoch as the log keeps it."""
    paths = [
        {name: column.tolist() for name in _COLUMNS if (column := getattr(entry, name)) is not None}
        for entry in epoch.paths
    ]
    entry: dict[str, Any] = {"epoch": epoch.index, "time_s": epoch.time_s, "paths": paths}
    if epoch.sweep:
        entry["sweep"] = _walls(epoch.sweep)
    if not epoch.heading_held:
        entry["heading_held"] = False
    if epoch.asked is not None:
        entry["asked"] = list(epoch.asked)
    return dump({**entry, **odometry_entry(epoch)})


def odometry_entry(epoch: Epoch) -> dict[str, Any]:
    """The entry ``odometry`` of an epoch in requests and in the log; none where it brings none."""
    told = epoch.odometry
    if told is None:
        return {}
    place, spread = told.displacement_m.tolist(), told.covariance.tolist()
    return {"odometry": {"displacement_m": place, "turn_rad": told.turn_rad, "covariance": spread}}


def read_epoch(text: str) -> Epoch:
    """The epoch that :func:`epoch_text` wrote."""
    value = json.loads(text)
    paths = tuple(AnchorPaths(**columns) for columns in value["paths"])
    sweep = tuple(GaussianVrp(mean, covariance) for mean, covariance in value.get("sweep", ()))
    asked = tuple(value["asked"]) if "asked" in value else None
    held = value.get("heading_held", True)
    moved = Odometry(**value["odometry"]) if "odometry" in value else None
    return Epoch(value["epoch"], value["time_s"], paths, sweep, held, asked, moved)


def sweep_text(number: int, walls: Iterable[GaussianVrp]) -> str:
    """A sweep as the log keeps it: the walls sensed by it."""
    return dump({"sweep": number, "walls": _walls(walls)})


def _walls(walls: Iterable[GaussianVrp]) -> list[list[Any]]:
    return [[wall.mean_m.tolist(), wall.covariance_m2.tolist()] for wall in walls]


def read_sweep(text: str) -> tuple[GaussianVrp, ...]:
    """The walls of the sweep that :func:`sweep_text` wrote."""
    return tuple(GaussianVrp(mean, covariance) for mean, covariance in json.loads(text)["walls"])


def estimate_document(
    epoch: int, time_s: float, anchors: Sequence[str], estimate: Estimate
) -> dict[str, Any]:
    """An estimate as the service shows it: JSON types, units in the names, null where unknown."""
    mean = estimate.agent_mean.tolist()
    return {
        "epoch": epoch,
        "time_s": time_s,
        "agent": {
            "position_m": mean[:2],
            "velocity_m_s": mean[2:],
            "covariance": estimate.agent_covariance.tolist(),
        },
        "rotation_std_rad": float(estimate.rotation_std_rad),
        "anchors": [
            {
                "name": name,
                "located": bool(located),
                "position_m": place.tolist() if located else None,
                "covariance_m2": covariance.tolist() if located else None,
                "existence": float(existence),
                **_measured("clock_bias", clock),
                **_measured("height", height),
            }
            for name, located, place, covariance, existence, clock, height in zip(
                anchors,
                estimate.anchor_valid,
                estimate.anchor_mean_m,
                estimate.anchor_covariance_m2,
                estimate.anchor_existence,
                _pairs(estimate.anchor_clock_m, len(anchors)),
                _pairs(estimate.anchor_height_m, len(anchors)),
                strict=True,
            )
        ],
        "walls": [
            {
                "id": int(number),
                "vrp_m": vrp.tolist(),
                "covariance_m2": covariance.tolist(),
                "existence": float(existence),
            }
            for number, vrp, covariance, existence in zip(
                estimate.wall_id,
                estimate.wall_mean_m,
                estimate.wall_covariance_m2,
                estimate.wall_existence,
                strict=True,
            )
        ],
        "hypotheses": int(estimate.hypotheses),
        "candidates": [_candidate(entry) for entry in estimate.candidates],
        "log_evidence": float(estimate.log_evidence),
        "integrity": _integrity(estimate.integrity),
    }


def _pairs(found: Array | None, count: int) -> Array | list[None]:
    return [None] * count if found is None else found


def _measured(name: str, pair: Array | None) -> dict[str, float | None]:
    """A value in metres and its standard deviation: null where not known yet, nothing if not estimated."""
    if pair is None:
        return {}
    return {f"{name}_m": _known(float(pair[0])), f"{name}_std_m": _known(float(pair[1]))}


def _read_pairs(anchors: list[dict[str, Any]], name: str) -> Array | None:
    if not anchors or f"{name}_m" not in anchors[0]:
        return None
    names = (f"{name}_m", f"{name}_std_m")
    return np.array([[math.nan if a[n] is None else a[n] for n in names] for a in anchors], dtype=np.float64)


def _integrity(integrity: Integrity) -> dict[str, Any]:
    return {
        "state": integrity.state,
        "probability": _known(integrity.probability),
        "protection_level_m": _known(integrity.protection_level_m),
        "reasons": list(integrity.reasons),
    }


def _known(value: float) -> float | None:
    """A number, None where it is NaN: not known."""
    return None if math.isnan(value) else float(value)


def _read_integrity(document: dict[str, Any]) -> Integrity:
    numbers = {
        name: math.nan if document[name] is None else document[name]
        for name in ("probability", "protection_level_m")
    }
    return Integrity(state=document["state"], reasons=tuple(document["reasons"]), **numbers)


def _candidate(candidate: Candidate) -> dict[str, Any]:
    pairs = zip(candidate.wall_id.tolist(), candidate.wall_mean_m.tolist(), strict=True)
    return {
        "weight": candidate.weight,
        "position_m": candidate.agent_m.tolist(),
        "walls": [{"id": number, "vrp_m": vrp} for number, vrp in pairs],
    }


def _read_candidate(document: dict[str, Any]) -> Candidate:
    walls = document["walls"]
    return Candidate(
        document["weight"],
        np.array(document["position_m"]),
        np.array([wall["id"] for wall in walls], dtype=np.int64),
        np.array([wall["vrp_m"] for wall in walls], dtype=np.float64).reshape(-1, 2),
    )


def read_estimate(document: dict[str, Any]) -> Estimate:
    """The estimate that :func:`estimate_document` showed, bit for bit."""
    agent, anchors, walls = document["agent"], document["anchors"], document["walls"]
    nowhere, unknown = [np.nan] * 2, [[np.nan] * 2] * 2
    return Estimate(
        agent_mean=np.array(agent["position_m"] + agent["velocity_m_s"]),
        agent_covariance=np.array(agent["covariance"]),
        rotation_std_rad=document["rotation_std_rad"],
        anchor_valid=np.array([anchor["located"] for anchor in anchors], dtype=bool),
        anchor_mean_m=np.array([anchor["position_m"] or nowhere for anchor in anchors]).reshape(-1, 2),
        anchor_covariance_m2=np.array([anchor["covariance_m2"] or unknown for anchor in anchors]).reshape(
            -1, 2, 2
        ),
        wall_id=np.array([wall["id"] for wall in walls], dtype=np.int64),
        wall_mean_m=np.array([wall["vrp_m"] for wall in walls], dtype=np.float64).reshape(-1, 2),
        wall_covariance_m2=np.array([wall["covariance_m2"] for wall in walls], dtype=np.float64).reshape(
            -1, 2, 2
        ),
        hypotheses=document["hypotheses"],
        log_evidence=document["log_evidence"],
        anchor_existence=np.array([anchor["existence"] for anchor in anchors], dtype=np.float64),
        wall_existence=np.array([wall["existence"] for wall in walls], dtype=np.float64),
        candidates=tuple(_read_candidate(entry) for entry in document["candidates"]),
        integrity=_read_integrity(document["integrity"]) if "integrity" in document else Integrity(),
        anchor_clock_m=_read_pairs(anchors, "clock_bias"),
        anchor_height_m=_read_pairs(anchors, "height"),
    )
