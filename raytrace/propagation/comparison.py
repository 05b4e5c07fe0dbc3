"""Traced paths against the image method, one by one: which, when, whence, and how strong.

Paths that are decided at a corner (to a millimetre, or by two bounces within a centimetre) may
or may not have been traced. Paths through one wall or around one corner are compared with those of
:mod:`raytrace.propagation.bends`; of those that bend more often, or bounce besides, nothing is known.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.bends import BentOnce, bent_once, corners_of, match_bends
from raytrace.propagation.directions import directions_of
from raytrace.propagation.images import image_paths
from raytrace.propagation.passive import LEG_M, RIM_M
from raytrace.propagation.paths import NO_SURFACE, PathList
from raytrace.propagation.shadowing import shadowed

__all__ = ["Comparison", "compare", "compare_bent"]

# A path whose delay, arrival or magnitude differs by more is wrong.
_DELAY_M = 1e-3
_ANGLE_DEG = 0.01
_AMPLITUDE_DB = 0.05
_MOST_NAMED = 100


@dataclass(frozen=True)
class Comparison:
    """What :func:`compare` found.

    Parameters
    ----------
    expected, found, missing, extra : int
        Paths of the image method, those among them in the files, those that are not,
        and paths in the files that no image explains.
    wrong : int
        Found paths whose delay is off by more than a millimetre, whose arrival by more than
        0.01 degrees, or whose magnitude by more than 0.05 dB from Fresnel theory.
    delay_error_m, angle_error_deg, amplitude_error_db : float
        Largest deviations of delays (as lengths), directions of arrival and magnitudes, as far as
        these are numbers.
    named : tuple of dict
        The first hundred paths that are missing, extra or wrong: ``fault``, ``epoch``,
        ``anchor``, ``surfaces`` from the anchor to the agent.
    """

    expected: int = 0
    found: int = 0
    missing: int = 0
    extra: int = 0
    wrong: int = 0
    delay_error_m: float = 0.0
    angle_error_deg: float = 0.0
    amplitude_error_db: float = 0.0
    named: tuple[dict[str, Any], ...] = field(default=())

    @property
    def ok(self) -> bool:
        """Whether no path is missing, extra or wrong."""
        return not (self.missing or self.extra or self.wrong)

    def as_dict(self) -> dict[str, Any]:
        """JSON types."""
        return {"ok": self.ok, **asdict(self), "named": list(self.named)}

    def __add__(self, other: Comparison) -> Comparison:
        """What was found in both."""
        mine, others = asdict(self), asdict(other)
        worst = {key: max(mine[key], others[key]) for key in mine if "error" in key}
        summed = {key: mine[key] + others[key] for key in mine if key not in worst}
        return Comparison(**{**summed, **worst, "named": summed["named"][:_MOST_NAMED]})


def compare(
    plan: FloorPlan,
    positions_m: NDArray[np.float64],
    paths: PathList,
    first: int = 0,
    times_s: NDArray[np.float64] | None = None,
) -> Comparison:
    """Look for every path among those of the image method, and the other way round.

    Parameters
    ----------
    plan : FloorPlan
        The plan; its ``tracing.depth`` says how many bounces there should be.
    positions_m : ndarray, shape (n, 3)
        Positions of the agent, metres.
    paths : PathList
        What was traced from the plan's anchors; ``epoch`` counts the positions.
    first : int
        Added to the epochs of named paths.
    times_s : ndarray, shape (n,), optional
        Time at each position since the first epoch, seconds, if the paths are those that the plan's
        bodies left; by default of none.
    """
    owed = image_paths(plan, positions_m, rim_m=RIM_M, leg_m=LEG_M).flat()
    others = paths.walls[~np.isin(_keys(plan, paths), _keys(plan, owed))]
    spare = image_paths(plan, positions_m, rim_m=-RIM_M, among=others).flat()
    every = PathList.concatenate([owed, spare])
    if times_s is not None:
        every = shadowed(plan, every, positions_m, times_s)
    keys = {name: _keys(plan, some) for name, some in (("all", every), ("owed", owed), ("got", paths))}
    lost = owed.select(~np.isin(keys["owed"], keys["got"]))
    _, once = np.unique(keys["got"], return_index=True)
    explained = np.zeros(len(paths), dtype=np.bool_)
    explained[once] = np.isin(keys["got"][once], keys["all"])  # a path that is there twice is extra
    surplus = paths.select(~explained)
    _, i, j = np.intersect1d(keys["got"], keys["all"], return_indices=True)
    mine, exact = paths.select(i), every.select(j)

    delay_m = np.abs(mine.delay_s - exact.delay_s) * SPEED_OF_LIGHT_M_S
    cosine = np.sum(_directions(mine) * _directions(exact), axis=-1)
    sine = np.linalg.norm(np.cross(_directions(mine), _directions(exact)), axis=-1)
    angle_deg = np.rad2deg(np.arctan2(sine, cosine))
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude_db = np.abs(20.0 * np.log10(np.abs(mine.amplitude) / np.abs(exact.amplitude)))
    off = ~((delay_m <= _DELAY_M) & (angle_deg <= _ANGLE_DEG) & (amplitude_db <= _AMPLITUDE_DB))
    faults = (("missing", lost), ("extra", surplus), ("wrong", mine.select(off)))
    named = [path for fault, some in faults for path in _named(plan, fault, some, first)]
    return Comparison(
        expected=len(owed) + len(i) - int(np.isin(keys["owed"], keys["got"]).sum()),
        found=len(i),
        missing=len(lost),
        extra=len(surplus),
        wrong=int(off.sum()),
        delay_error_m=_largest(delay_m),
        angle_error_deg=_largest(angle_deg),
        amplitude_error_db=_largest(amplitude_db),
        named=tuple(named[:_MOST_NAMED]),
    )


def compare_bent(
    plan: FloorPlan, positions_m: NDArray[np.float64], paths: PathList, first: int = 0
) -> Comparison:
    """Look for every path that bends once among those of the geometry, and the other way round.

    Parameters are those of :func:`compare`; amplitudes are not compared.
    """
    known = bent_once(plan, positions_m, RIM_M)
    match = match_bends(plan, positions_m, paths, known)
    mine, delay_s = paths.select(match.paths), known.delay_s[match.known]
    delay_m = np.abs(mine.delay_s - delay_s) * SPEED_OF_LIGHT_M_S
    sine = np.linalg.norm(np.cross(_directions(mine), known.towards[match.known]), axis=-1)
    angle_deg = np.rad2deg(np.arctan2(sine, np.sum(_directions(mine) * known.towards[match.known], axis=-1)))
    off = match.paths[~((delay_m <= _DELAY_M) & (angle_deg <= _ANGLE_DEG))]
    named = [_bend(plan, known, int(row), first) for row in match.missing[:_MOST_NAMED]]
    for fault, rows in (("extra", match.extra), ("wrong", off)):
        named += _named(plan, fault, paths.select(rows), first)
    return Comparison(
        expected=len(match.paths) + len(match.missing),
        found=len(match.paths),
        missing=len(match.missing),
        extra=len(match.extra),
        wrong=len(off),
        delay_error_m=_largest(delay_m),
        angle_error_deg=_largest(angle_deg),
        named=tuple(named[:_MOST_NAMED]),
    )


def _bend(plan: FloorPlan, known: BentOnce, row: int, first: int) -> dict[str, Any]:
    """A missing path that bends once: the surface that it passes, or the walls of its corner."""
    surfaces, name = len(plan.surface_names), int(known.name[row])
    walls = corners_of(plan).faces[name - surfaces] if name >= surfaces else [name]
    return {
        "fault": "missing",
        "epoch": first + int(known.epoch[row]),
        "anchor": plan.anchors[int(known.anchor[row])].name,
        "surfaces": [plan.surface_names[wall] for wall in walls],
    }


def _largest(values: NDArray[np.float64]) -> float:
    """Largest of the values that are numbers; 0 if there is none."""
    return float(values[np.isfinite(values)].max(initial=0.0))


def _keys(plan: FloorPlan, paths: PathList) -> NDArray[np.int64]:
    return paths.keys(len(plan.anchors), len(plan.surface_names))


def _directions(paths: PathList) -> NDArray[np.float64]:
    """Unit vectors to where paths come from, shape (n, 3)."""
    return directions_of(paths.arrival_azimuth_rad, paths.arrival_elevation_rad)


def _named(plan: FloorPlan, fault: str, paths: PathList, first: int) -> list[dict[str, Any]]:
    names = plan.surface_names
    return [
        {
            "fault": fault,
            "epoch": first + int(paths.epoch[row]),
            "anchor": plan.anchors[int(paths.anchor[row])].name,
            "surfaces": [names[wall] for wall in paths.walls[row] if wall != NO_SURFACE],
        }
        for row in range(min(len(paths), _MOST_NAMED))
    ]
