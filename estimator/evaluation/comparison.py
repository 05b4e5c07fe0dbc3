"""A result against the truth: errors, consistency, and the walls found, missed and invented.

The truth lies in the frame of the floor plan; results are in the estimator's frame, whose
origin is the agent's start (RP) and whose x axis is the agent's heading there:

    p_estimator = R(-heading) (p_plan - start).

Only this module and :mod:`estimator.evaluation.pictures` open the truth of a dataset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.evaluation.metrics import (
    best_rotation,
    derotated,
    distances,
    match,
    nees,
    nees_band,
    ospa,
    root_mean_square_error,
)
from estimator.geometry import mirror_in_wall, rotate
from estimator.result import SlamResult

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["EvaluationConfig", "Surface", "Truth", "evaluate", "read_truth"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EvaluationConfig:
    """What counts as what.

    Parameters
    ----------
    reflecting_epochs : int
        A wall is to be found if it reflects towards the agent, from any anchor, in at
        least this many of the result's epochs.
    wall_gate_m : float
        A wall is found if the VRP of an estimated one, rotation removed, lies within this
        distance of its own. (The line of a wall moves half as far as its VRP.)
    ospa_cutoff_m, ospa_order : float
        Cut-off and order of the OSPA distance of the VRPs.
    lost_m : float
        A run is lost if its RMSE with rotation removed exceeds this.
    band_probability : float
        Probability of the interval given for NEES.
    """

    reflecting_epochs: int = 20
    wall_gate_m: float = 2.0
    ospa_cutoff_m: float = 10.0
    ospa_order: float = 1.0
    lost_m: float = 1.0
    band_probability: float = 0.95

    def __post_init__(self) -> None:
        for name in ("wall_gate_m", "ospa_cutoff_m", "lost_m"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")
        if not 0.0 < self.band_probability < 1.0:
            raise ConfigurationError(
                f"band_probability: expected a number between 0 and 1, got {self.band_probability}"
            )


@dataclass(frozen=True, eq=False)
class Surface:
    """Walls of the plan in one line: one VRP, so one wall to an estimator.

    Parameters
    ----------
    name : str
        Names of the walls, joined by ``+``.
    vrp_m : ndarray, shape (2,)
        Mirror image of RP, metres.
    segments_m : ndarray, shape (n, 2, 2)
        Start and end of each wall, metres.
    reflects : ndarray of bool, shape (T,)
        Whether a path over one bounce on it reaches the agent from any anchor.
    """

    name: str
    vrp_m: Array
    segments_m: Array
    reflects: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth of a dataset at the epochs of a result, in the estimator's frame.

    Parameters
    ----------
    start_m : ndarray, shape (2,)
        RP in the frame of the floor plan, metres.
    heading_rad : float
        Direction of the estimator's x axis in the frame of the floor plan, radians.
    time_s : ndarray, shape (T,)
        Seconds since the first epoch.
    track_m : ndarray, shape (T, 2)
        Positions of the agent, metres.
    anchors_m : ndarray, shape (K, 2)
        Anchors, in the order of the result's, metres.
    surfaces : tuple of Surface
        All walls of the plan.
    """

    start_m: Array
    heading_rad: float
    time_s: Array
    track_m: Array
    anchors_m: Array
    surfaces: tuple[Surface, ...]

    def to_plan(self, points: ArrayLike) -> Array:
        """Points of the estimator's frame, shape (..., 2), in the frame of the floor plan."""
        return np.asarray(rotate(points, self.heading_rad) + self.start_m)


def read_truth(data: xr.Dataset, result: SlamResult) -> Truth:
    """The truth as :meth:`estimator.dataset.Dataset.truth` gives it, cut to the epochs of a result.

    Raises
    ------
    InputError
        If a variable, an anchor or an epoch of the result is missing in the truth.
    """
    needed = ("anchor_position_m", "track_m", "time_s", "wall_start_m", "wall_end_m", "reflects")
    missing = [name for name in needed if name not in data]
    missing += [name for name in ("start_m", "heading_rad") if name not in data.attrs]
    if missing:
        raise InputError(f"truth: expected {', '.join(missing)}, not there")
    start = np.asarray(data.attrs["start_m"], dtype=np.float64).ravel()[:2]
    heading = float(data.attrs["heading_rad"])

    def local(points: Array) -> Array:
        return rotate(points[..., :2] - start, -heading)

    rows = _positions(
        data["epoch"].values if "epoch" in data else np.arange(data.sizes["epoch"]), result.epoch, "epoch"
    )
    names = [str(name) for name in data["anchor"].values]
    columns = _positions(names, result.anchors, "anchor")
    reflects = np.any(data["reflects"].transpose("epoch", "anchor", "wall").values[rows], axis=1)
    walls = [str(name) for name in data["wall"].values]
    segments = np.stack([local(data["wall_start_m"].values), local(data["wall_end_m"].values)], axis=1)
    return Truth(
        start,
        heading,
        data["time_s"].values[rows],
        local(data["track_m"].transpose("epoch", ...).values[rows]),
        local(data["anchor_position_m"].transpose("anchor", ...).values[columns]),
        _surfaces(walls, segments, np.asarray(reflects)),
    )


def _positions(names: ArrayLike, wanted: ArrayLike, what: str) -> list[int]:
    """Where each of ``wanted`` stands in ``names``."""
    place = {name: row for row, name in enumerate(np.asarray(names).tolist())}
    unknown = [name for name in np.asarray(wanted).tolist() if name not in place]
    if unknown:
        raise InputError(
            f"truth: expected every {what} of the result, {unknown[0]!r} is missing; "
            "is it the truth of another dataset?"
        )
    return [place[name] for name in np.asarray(wanted).tolist()]


def _surfaces(names: list[str], segments: Array, reflects: NDArray[np.bool_]) -> tuple[Surface, ...]:
    """Walls put together that lie in one line, in the order of their first."""
    vrps = mirror_in_wall((0.0, 0.0), segments[:, 0], segments[:, 1])
    groups: list[list[int]] = []
    for wall in range(len(names)):
        for group in groups:
            if np.linalg.norm(vrps[group[0]] - vrps[wall]) < 1e-3:
                group.append(wall)
                break
        else:
            groups.append([wall])
    return tuple(
        Surface(
            "+".join(names[i] for i in group),
            vrps[group[0]],
            segments[group],
            np.asarray(np.any(reflects[:, group], axis=1)),
        )
        for group in groups
    )


def evaluate(
    result: SlamResult,
    truth: xr.Dataset,
    config: EvaluationConfig | None = None,
    seconds_per_epoch: float | None = None,
) -> dict[str, Any]:
    """Compare a result with the truth of its dataset.

    Parameters
    ----------
    result : SlamResult
        Estimates of one run.
    truth : xarray.Dataset
        Truth of its dataset (:meth:`estimator.dataset.Dataset.truth`).
    config : EvaluationConfig, optional
        What counts as what.
    seconds_per_epoch : float, optional
        Time that the run took per epoch; only passed on.

    Returns
    -------
    dict
        JSON types only:

        - ``epochs``: number of epochs; ``anchors``: their names;
        - ``position_mae_m``, ``position_rmse_m``, ``position_final_m``: errors of the agent's
          position over all epochs, and at the last;
        - ``rotation_rad``: angle about RP by which the estimated track is turned against the
          true one, counter-clockwise (least squares over all epochs);
        - ``derotated_rmse_m``: RMSE with that rotation removed;
        - ``nees_position_per_dim``: mean over epochs of NEES / 2 (epochs at which the position
          is known by definition, as the first is, do not count); ``nees_band``: interval of
          a consistent run, taken as one sample because neighbouring epochs err together;
        - ``anchors_error_m``: error of each anchor at the last epoch, null where not located;
        - ``walls_true``: walls that reflect towards the agent often enough to be found;
          ``walls_found``: those of them that were; ``walls_false``: walls confirmed at the last
          epoch that are none of the plan (a second copy of a wall is one too);
          ``walls``: all walls of the plan with ``name``, ``reflecting_epochs``, ``vrp_error_m`` (with
          rotation; null where not found);
        - ``vrp_ospa_m``: OSPA distance of the VRPs at the last epoch from those of the true
          walls, rotation included;
        - ``integrity_flagged_epochs``: epochs that the engine itself says are doubtful or lost;
          ``integrity_first_flagged``: the first of them, null if there is none; ``protection_held``: share
          of the other epochs whose error is below their protection level, null where the engine tells none;
        - ``lost``: whether ``derotated_rmse_m`` is beyond use;
        - ``seconds_per_epoch``: as given.

    Raises
    ------
    InputError
        If the truth does not belong to the result, or the result has no epoch.
    """
    config = config or EvaluationConfig()
    if len(result.epoch) == 0:
        raise InputError("result: expected at least one epoch, got none")
    known = read_truth(truth, result)
    track = result.agent_mean[:, :2]
    error = distances(track, known.track_m)
    angle = float(best_rotation(track, known.track_m))
    derotated_rmse = root_mean_square_error(derotated(track, angle), known.track_m)
    return {
        "epochs": len(result.epoch),
        "anchors": list(result.anchors),
        "position_mae_m": float(error.mean()),
        "position_rmse_m": float(np.sqrt(np.mean(error**2))),
        "position_final_m": float(error[-1]),
        "rotation_rad": angle,
        "derotated_rmse_m": derotated_rmse,
        "nees_position_per_dim": _position_nees(result, known),
        "nees_band": list(nees_band(2, probability=config.band_probability)),
        "anchors_error_m": [
            float(np.linalg.norm(mean - place)) if valid else None
            for mean, place, valid in zip(
                result.anchor_mean_m[-1], known.anchors_m, result.anchor_valid[-1], strict=True
            )
        ],
        **_walls(result, known, angle, config),
        **_integrity(result, error),
        "lost": derotated_rmse > config.lost_m,
        "seconds_per_epoch": seconds_per_epoch,
    }


def _integrity(result: SlamResult, error: Array) -> dict[str, Any]:
    """What the engine said of its own epochs, and whether its protection levels held."""
    flagged, held = result.flagged, None
    if result.protection_level_m is not None:
        told = ~flagged & np.isfinite(result.protection_level_m)
        held = float(np.mean(error[told] < result.protection_level_m[told])) if told.any() else None
    return {
        "integrity_flagged_epochs": int(flagged.sum()),
        "integrity_first_flagged": int(result.epoch[np.argmax(flagged)]) if flagged.any() else None,
        "protection_held": held,
    }


def _position_nees(result: SlamResult, truth: Truth) -> float | None:
    """Mean over epochs of NEES / 2, None if the position is known by definition at all of them."""
    covariance = result.agent_covariance[:, :2, :2]
    uncertain = np.linalg.eigvalsh(covariance)[:, 0] > 0.0
    if not uncertain.any():
        return None
    error = result.agent_mean[:, :2] - truth.track_m
    return float(nees(error[uncertain], covariance[uncertain]).mean())


def _walls(result: SlamResult, truth: Truth, angle: float, config: EvaluationConfig) -> dict[str, Any]:
    """What of the walls: the entries ``walls...`` and ``vrp_ospa_m`` of :func:`evaluate`."""
    vrps = np.array([surface.vrp_m for surface in truth.surfaces]).reshape(-1, 2)
    heard = np.array([int(surface.reflects.sum()) for surface in truth.surfaces], dtype=np.int64)
    due = heard >= config.reflecting_epochs
    estimates = result.wall_mean_m[-1][result.wall_valid[-1]]
    matched = {j: i for i, j in match(derotated(estimates, angle), vrps, config.wall_gate_m)}
    walls = [
        {
            "name": surface.name,
            "reflecting_epochs": int(count),
            "vrp_error_m": float(np.linalg.norm(estimates[matched[j]] - surface.vrp_m))
            if j in matched
            else None,
        }
        for j, (surface, count) in enumerate(zip(truth.surfaces, heard, strict=True))
    ]
    return {
        "walls_true": int(due.sum()),
        "walls_found": sum(bool(due[j]) for j in matched),
        "walls_false": len(estimates) - len(matched),
        "walls": walls,
        "vrp_ospa_m": ospa(estimates, vrps[due], config.ospa_cutoff_m, config.ospa_order),
    }
