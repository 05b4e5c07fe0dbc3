"""Whether the paths of a dataset are those of its floor plan: the check of the files themselves.

The image method constructs the paths anew from the plan in the truth file, and every
path in the files is looked for among them, and the other way round. Hashes of all
shards are checked on the way. As in generation, paths that are decided at a corner (to a
millimetre, or by two bounces within a centimetre) may or may not have been traced. Paths
through walls and around corners are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import Dataset
from estimator.errors import FileFormatError
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.floorplan import FloorPlan
from raytrace.images import image_paths
from raytrace.passive import LEG_M, RIM_M
from raytrace.paths import NO_SURFACE, PathList, directions_of
from raytrace.shards import stored_paths, stored_plan

__all__ = ["Verification", "verify"]

# A delay or an arrival that differs by more is wrong.
_DELAY_M = 1e-3
_ANGLE_DEG = 0.01
# So close to a corner single precision costs the tracer up to 1.6 dB: amplitudes are not compared.
_CORNER_M = 0.03
_MOST_NAMED = 100

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Verification:
    """What :func:`verify` found.

    Parameters
    ----------
    expected, found, missing, extra : int
        Paths of the image method, those among them in the files, those that are not,
        and paths in the files that no image explains.
    wrong : int
        Found paths whose delay is off by more than a millimetre, or whose arrival by
        more than 0.01 degrees.
    delay_error_m, angle_error_deg : float
        Largest deviations of delays (as lengths) and directions of arrival, as far as these are numbers.
    amplitude_error_db, amplitude_over : float, int
        Largest deviation of a magnitude from Fresnel theory, more than 3 cm from every
        corner, and how many deviate by more than 0.05 dB.
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
    amplitude_over: int = 0
    named: tuple[dict[str, Any], ...] = field(default=())

    @property
    def ok(self) -> bool:
        """Whether no path is missing, extra or wrong."""
        return not (self.missing or self.extra or self.wrong)

    def as_dict(self) -> dict[str, Any]:
        """JSON types."""
        return {"ok": self.ok, **asdict(self), "named": list(self.named)}

    def __add__(self, other: Verification) -> Verification:
        """What was found in both."""
        mine, others = asdict(self), asdict(other)
        worst = {key: max(mine[key], others[key]) for key in mine if "error" in key}
        summed = {key: mine[key] + others[key] for key in mine if key not in worst}
        return Verification(**{**summed, **worst, "named": summed["named"][:_MOST_NAMED]})


def verify(dataset: Dataset, progress: Progress | None = None) -> Verification:
    """Compare the paths of a dataset with the image method, shard by shard.

    Parameters
    ----------
    dataset : Dataset
        A complete dataset with its truth.
    progress : callable, optional
        Called with (epochs done, epochs in all, what is done).

    Raises
    ------
    FileFormatError
        If a shard is missing or changed, epochs are missing or twice there, or the plan
        is not the one that the manifest names.
    """
    plan = stored_plan(dataset.truth())
    if plan.sha256() != dataset.manifest["scene"]["sha256"]:
        raise FileFormatError(f"{dataset.path}: expected the manifest's plan in truth.nc, found another")
    for kind in ("passive", "echo"):
        for _ in dataset.shards(kind):
            pass
    track, done, result = plan.track(), 0, Verification()
    for shard in dataset.shards("paths"):
        epochs = shard["epoch"].values
        if not np.array_equal(epochs, np.arange(done, done + len(epochs))):
            raise FileFormatError(f"{dataset.path}: expected paths from epoch {done} on, got {epochs[:1]}")
        paths = stored_paths(shard, plan.heading_rad).flat()
        result = result + _compare(plan, track[epochs], paths.select(paths.is_specular), done)
        done += len(epochs)
        if progress is not None:
            progress(done, len(track), "comparing paths")
    if done != len(track):
        raise FileFormatError(f"{dataset.path}: expected paths of {len(track)} epochs, got {done}")
    return result


def _compare(plan: FloorPlan, positions: NDArray[np.float64], stored: PathList, first: int) -> Verification:
    """Paths in a shard against those of the image method; epochs of both count from the shard's first."""
    every = image_paths(plan, positions, rim_m=-RIM_M).flat()
    owed = image_paths(plan, positions, rim_m=RIM_M, leg_m=LEG_M).flat()
    keys = {name: _keys(plan, paths) for name, paths in (("all", every), ("owed", owed), ("got", stored))}
    lost = owed.select(~np.isin(keys["owed"], keys["got"]))
    _, once = np.unique(keys["got"], return_index=True)
    explained = np.zeros(len(stored), dtype=np.bool_)
    explained[once] = np.isin(keys["got"][once], keys["all"])  # a path that is there twice is extra
    surplus = stored.select(~explained)
    _, i, j = np.intersect1d(keys["got"], keys["all"], return_indices=True)
    mine, exact = stored.select(i), every.select(j)

    delay_m = np.abs(mine.delay_s - exact.delay_s) * SPEED_OF_LIGHT_M_S
    cosine = np.sum(_directions(mine) * _directions(exact), axis=-1)
    sine = np.linalg.norm(np.cross(_directions(mine), _directions(exact)), axis=-1)
    angle_deg = np.rad2deg(np.arctan2(sine, cosine))
    off = ~((delay_m <= _DELAY_M) & (angle_deg <= _ANGLE_DEG))
    clear = image_paths(plan, positions, rim_m=_CORNER_M, leg_m=_CORNER_M).flat()
    far = np.isin(_keys(plan, exact), _keys(plan, clear))
    ratio = np.abs(mine.amplitude[far]) / np.abs(exact.amplitude[far])
    with np.errstate(divide="ignore"):
        amplitude_db = np.abs(20.0 * np.log10(ratio))
    faults = (("missing", lost), ("extra", surplus), ("wrong", mine.select(off)))
    named = [path for fault, paths in faults for path in _named(plan, fault, paths, first)]
    return Verification(
        expected=len(owed) + len(i) - int(np.isin(keys["owed"], keys["got"]).sum()),
        found=len(i),
        missing=len(lost),
        extra=len(surplus),
        wrong=int(off.sum()),
        delay_error_m=_largest(delay_m),
        angle_error_deg=_largest(angle_deg),
        amplitude_error_db=_largest(amplitude_db),
        amplitude_over=int(np.sum(~(amplitude_db <= 0.05))),
        named=tuple(named[:_MOST_NAMED]),
    )


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
