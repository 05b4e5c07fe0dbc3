"""An estimated plan on trial: its predictions beside those of the true plan and of interpolations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.geometry import rotate
from raytrace.plan.floorplan import FloorPlan
from raytrace.prediction.channels import channels_of, predict
from raytrace.prediction.heldout import HeldOut
from raytrace.prediction.interpolation import INTERPOLATIONS, interpolated_db
from raytrace.prediction.score import NEAR_M, score_channels, score_powers

__all__ = ["end_errors", "trial"]

Array = NDArray[np.float64]


def trial(
    plan: FloorPlan, held: HeldOut, start_m: Array, heading_rad: float, mapped_m: Array, measured_db: Array
) -> dict[str, Any]:
    """Hold an estimated plan against channels that it has not seen.

    Parameters
    ----------
    plan : FloorPlan
        The estimated plan; its anchors have the names of the true ones.
    held : HeldOut
        The channels.
    start_m, heading_rad : ndarray, shape (2,) or (3,), and float
        Where the mapped track began in the true plan, and the direction of the estimator's x axis there.
    mapped_m : ndarray, shape (M, 2)
        The mapped track, estimator's frame.
    measured_db : ndarray, shape (M, K)
        Powers measured along it, dB over the EIRP, for the plan's anchors; NaN where there is none.

    Returns
    -------
    dict
        JSON types: ``twin`` and ``true_plan`` as :func:`score_channels` gives them, ``interpolations`` by
        name,
        ``ends_m`` as :func:`end_errors`, ``positions``, ``far_share``, and ``anchors`` that count.

    Raises
    ------
    InputError
        If an anchor of the plan is unknown to the dataset.
    """
    names = [anchor.name for anchor in held.plan.anchors]
    missing = [anchor.name for anchor in plan.anchors if anchor.name not in names]
    if missing:
        raise InputError(f"anchors: expected those of the dataset, {', '.join(names)}, got {missing[0]!r}")
    columns = np.array([names.index(anchor.name) for anchor in plan.anchors])
    places = held.seen_from(np.asarray(start_m), heading_rad)
    far = np.linalg.norm(places[:, None] - mapped_m, axis=-1).min(axis=1) > NEAR_M
    flat = held.paths.flat()
    own = flat.select(np.isin(flat.anchor, columns))
    order = np.full(len(names), -1)
    order[columns] = np.arange(len(columns))
    renamed = type(own)(**{**vars(own), "anchor": order[own.anchor]})
    true = channels_of(type(held.paths).build(renamed, len(places), len(columns)), held.plan.radio.grid())
    exact = predict(
        held.plan.model_copy(update={"anchors": tuple(held.plan.anchors[c] for c in columns)}), held.track_m
    )
    anchors = plan.anchors_m()[:, :2]
    others = {
        name: interpolated_db(name, places, anchors, mapped_m, measured_db, plan.radio.carrier_hz)
        for name in INTERPOLATIONS
    }
    return {
        "positions": len(places),
        "far_share": float(far.mean()),
        "anchors": [anchor.name for anchor in plan.anchors],
        "twin": score_channels(predict(plan, places), true, far),
        "true_plan": score_channels(exact, true, far),
        "interpolations": score_powers(others, true, far),
        "ends_m": end_errors(plan, held.plan, np.asarray(start_m), heading_rad),
    }


def end_errors(plan: FloorPlan, true: FloorPlan, start_m: Array, heading_rad: float) -> dict[str, Any]:
    """Distances of the plan's corners from the nearest true ends: ``mean``, ``largest`` and ``count``."""
    kinds = {} if plan.uncertainty is None else {entry.wall: entry for entry in plan.uncertainty.walls}
    ends = [
        end
        for wall in plan.walls
        for end, kind in (
            (wall.from_m, kinds[wall.name].from_end if wall.name in kinds else None),
            (wall.to_m, kinds[wall.name].to_end if wall.name in kinds else None),
        )
        if kind == "corner"
    ]
    if not ends:
        return {"count": 0, "mean": None, "largest": None}
    known = rotate(np.concatenate(true.walls_m()) - start_m[:2], -heading_rad)
    error = np.linalg.norm(np.array(ends)[:, None] - known, axis=-1).min(axis=1)
    return {"count": len(ends), "mean": float(error.mean()), "largest": float(error.max())}
