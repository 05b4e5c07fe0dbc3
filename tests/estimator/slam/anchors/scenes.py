"""A few walls and the paths of an anchor: the anchor is mirrored, where the search mirrors the agent."""

from __future__ import annotations

import numpy as np

from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.observations import Observations, gathered
from estimator.slam.anchors.search import Scene, scene_of
from estimator.slam.models.noise import MeasurementNoise

SEARCH = AnchorSearchConfig(height_cells=0)
NOISE = MeasurementNoise(range_std_m=0.1, clutter_mean=1.0)
WALLS = np.array([[40.0, 0.0], [0.0, -30.0], [-24.0, 0.0], [0.0, 50.0]])  # VRPs of a rectangle round RP
SPREAD = np.array([0.01, 0.02, 0.03, 0.04])[:, None, None] * np.eye(2)
ANCHOR = np.array([11.0, 9.0])


def mirrored(point: np.ndarray, vrp: np.ndarray) -> np.ndarray:
    """Image of a point in the wall half-way to a VRP: its foot on the wall, and as far beyond."""
    normal = vrp / np.linalg.norm(vrp)
    return point - 2.0 * (point @ normal - 0.5 * np.linalg.norm(vrp)) * normal


def path_lengths(anchor: np.ndarray, agent: np.ndarray, walls: np.ndarray = WALLS) -> np.ndarray:
    """Line of sight and single bounces."""
    sources = [anchor, *(mirrored(anchor, wall) for wall in walls)]
    return np.array([np.linalg.norm(agent - source) for source in sources])


def observed(
    agents: list[tuple[float, float]],
    anchor: np.ndarray = ANCHOR,
    extra: tuple[float, ...] = (),
    bias: float = 0.0,
    height2: float = 0.0,
    walls: np.ndarray = WALLS,
) -> Observations:
    """The paths of an anchor at some positions of the agent, without noise, and clutter of given lengths."""
    epochs = []
    for agent in np.array(agents):
        length = np.sqrt(path_lengths(anchor, agent, walls) ** 2 + height2) + bias
        length = np.concatenate([length, extra])
        epochs.append((length, np.full(length.size, 0.01), np.ones(length.size)))
    return gathered(np.array(agents), np.tile(0.01 * np.eye(2), (len(agents), 1, 1)), epochs)


def scene(seen: Observations, walls: np.ndarray = WALLS, spread: np.ndarray = SPREAD) -> Scene:
    """The circles of these observations."""
    return scene_of(seen, walls, spread, NOISE, SEARCH)
