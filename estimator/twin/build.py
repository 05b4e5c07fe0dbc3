"""A smoothed run as a map with finite walls: what a floor plan is written from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.twin.bounces import (
    BounceSamples,
    bounce_samples,
    gain_noise_db,
    gain_offsets,
    gaps_to_neighbours,
)
from estimator.twin.ends import EndSearch, label_lines
from estimator.twin.expected import expected_paths
from estimator.twin.missing import supported
from estimator.twin.obstacles import Obstacle, ShadowSearch, find_obstacles
from estimator.twin.sightings import Hearing, Sightings, joint_of, sightings
from estimator.twin.stretches import Closing, Stretch, close_gaps, wall_stretches

__all__ = ["TwinAnchor", "TwinConfig", "TwinMap", "build_twin"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TwinConfig:
    """How a twin is built.

    Parameters
    ----------
    hearing : Hearing
        What counts as heard.
    ends : EndSearch
        Where walls end.
    closing : Closing
        Which gaps are closed.
    shadows : ShadowSearch
        How obstacles are looked for.
    gain_offset_std_db : float
        Standard deviation of the anchors' gain offsets before anything is heard, where the run does not state
        its own; 0 if gains are calibrated.
    """

    hearing: Hearing = field(default_factory=Hearing)
    ends: EndSearch = field(default_factory=EndSearch)
    closing: Closing = field(default_factory=Closing)
    shadows: ShadowSearch = field(default_factory=ShadowSearch)
    gain_offset_std_db: float = 0.0


@dataclass(frozen=True, eq=False)
class TwinAnchor:
    """An anchor that was located.

    Parameters
    ----------
    name : str
        Its name.
    position_m : ndarray, shape (2,)
        Where it stands, estimator's frame.
    std_m : float
        Standard deviation of its place along the axis in which it is least known.
    height_m, height_std_m : float
        Height difference to the agent; that it is above is assumed.
    offset_db, offset_std_db : float
        Offset of its gains against free space (an EIRP other than stated); infinite deviation if unknown.
    """

    name: str
    position_m: Array
    std_m: float
    height_m: float
    height_std_m: float
    offset_db: float
    offset_std_db: float


@dataclass(frozen=True, eq=False)
class TwinMap:
    """A map with finite walls, estimator's frame.

    Parameters
    ----------
    walls : tuple of Stretch
        Walls that were mapped, and those that are assumed (line -1).
    obstacles : tuple of Obstacle
        What hides, and is no wall.
    anchors : tuple of TwinAnchor
        The located anchors.
    track_m : ndarray, shape (T, 2)
        The agent's positions.
    time_s : ndarray, shape (T,)
        Their times.
    rotation_std_rad : float
        Standard deviation of the map's rotation about RP.
    carrier_hz : float
        Carrier frequency.
    bounces : BounceSamples
        What tells the materials; walls by line, anchors by the result's numbers.
    """

    walls: tuple[Stretch, ...]
    obstacles: tuple[Obstacle, ...]
    anchors: tuple[TwinAnchor, ...]
    track_m: Array
    time_s: Array
    rotation_std_rad: float
    carrier_hz: float
    bounces: BounceSamples


def build_twin(result: SlamResult, measurements: MeasurementSet, config: TwinConfig | None = None) -> TwinMap:
    """Give the walls of a smoothed run their ends, and gather what else a floor plan needs.

    Parameters
    ----------
    result : SlamResult
        A smoothed run (``hapslam slam --smooth``).
    measurements : MeasurementSet
        What it was made of.
    config : TwinConfig, optional
        How.

    Raises
    ------
    InputError
        If the result is not a smoothed one, or has no wall or no located anchor.
    """
    joint, config = joint_of(result), config or TwinConfig()
    count, vrps = len(result.anchors), result.wall_mean_m[-1]
    if not len(vrps) or not result.anchor_valid[-1].any():
        raise InputError(
            f"result: expected a wall and a located anchor, "
            f"got {len(vrps)} and {result.anchor_valid[-1].sum()}"
        )
    sights = sightings(result, measurements, config.hearing)
    labelled = label_lines(sights, vrps, config.ends)
    spread = joint.map_covariance_m2[2 * count :, 2 * count :]
    seen = wall_stretches(labelled, vrps, spread, config.closing.shortest_m)
    closed, assumed = close_gaps(seen, heard_legs(sights), config.closing)
    kept = [wall for wall in assumed if supported(wall, closed, result, measurements, config.closing)]
    if len(kept) < len(assumed):  # ends that nothing closes stay as they were seen
        closed, _ = close_gaps(seen, heard_legs(sights), config.closing) if kept else (seen, [])
    walls = (*closed, *kept)
    expected = expected_paths(sights.unfolded, vrps, walls)
    obstacles = find_obstacles(sights, expected, _main_axis(closed), config.shadows)
    noise = gain_noise_db(gaps_to_neighbours(result, measurements, sights, expected))
    stated = result.settings.get("slam", {}).get("gain_offset_std_db", config.gain_offset_std_db)
    offset, offset_std = gain_offsets(result, noise, float(stated))
    return TwinMap(
        walls,
        tuple(obstacles),
        _anchors(result, offset, offset_std),
        result.agent_mean[:, :2],
        result.time_s,
        float(result.rotation_std_rad[-1]),
        joint.carrier_hz,
        bounce_samples(result, noise, offset),
    )


def heard_legs(sights: Sightings) -> Array:
    """Legs (N, 2, 2) of all lines of sight and single bounces that were heard, and of the track."""
    few = np.sum(sights.unfolded.walls >= 0, axis=1) < 2
    vertex = sights.unfolded.vertex_m[sights.heard & few]
    legs = np.stack([vertex[:, :-1], vertex[:, 1:]], axis=2).reshape(-1, 2, 2)
    track = sights.unfolded.vertex_m[:, 0, 0, -1]
    legs = np.concatenate([legs, np.stack([track[:-1], track[1:]], axis=1)])
    return np.asarray(legs[np.linalg.norm(legs[:, 1] - legs[:, 0], axis=1) > 1e-9])


def _main_axis(walls: list[Stretch]) -> float:
    """Direction, modulo a right angle, that most of the walls' length has, radians."""
    ends = np.array([wall.ends_m for wall in walls])
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    turn = np.sum(length * np.exp(4j * np.arctan2(along[:, 1], along[:, 0])))
    return float(np.angle(turn) / 4.0)


def _anchors(result: SlamResult, offset: Array, offset_std: Array) -> tuple[TwinAnchor, ...]:
    joint = joint_of(result)
    found = []
    for k in np.flatnonzero(result.anchor_valid[-1]).tolist():
        height = float(np.sqrt(max(joint.anchor_height2_m2[k], 0.0)))
        height2_std = float(np.sqrt(max(joint.anchor_height2_variance_m4[k], 0.0)))
        found.append(
            TwinAnchor(
                result.anchors[k],
                result.anchor_mean_m[-1, k],
                float(np.sqrt(np.linalg.eigvalsh(result.anchor_covariance_m2[-1, k])[-1])),
                height,
                height2_std / (2.0 * height) if height > height2_std else float(np.sqrt(height2_std)),
                float(offset[k]),
                float(offset_std[k]),
            )
        )
    return tuple(found)
