"""Rooms and measurements of the estimator's benchmark: the paper's room, and one size of it made larger."""

from __future__ import annotations

import numpy as np

from estimator.experiments.room import Room, make_room
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.simulate import SimulationConfig
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = ["EPOCHS", "many_anchors", "many_paths", "many_walls", "paper_room", "request"]

EPOCHS = 236
_CORNERS_M = np.array([(0, 0), (0, 40), (50, 40), (50, 60), (80, 60), (80, 0)], dtype=np.float64)
_ANCHORS_M = ((68.0, 6.0), (42.0, 36.0))
_WAYPOINTS_M = np.array([(10, 15), (70, 9), (73.5, 12), (70, 48), (66, 52.5), (54, 55)], dtype=np.float64)
_RADIUS_M = 30.0  # of the polygons
_STD_M = 0.1  # of lengths, and per axis of walls, of the random request
_REACH_M = 180.0  # of its paths


def _along(waypoints: np.ndarray, count: int) -> np.ndarray:
    """Equally spaced places on the way through way-points."""
    legs = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    reached = np.concatenate([[0.0], np.cumsum(legs)])
    walked = np.linspace(0.0, reached[-1], count)
    return np.stack([np.interp(walked, reached, axis) for axis in waypoints.T], axis=1)


def paper_room(anchors_m: np.ndarray | None = None) -> Room:
    """The L-shaped room of the paper's Section V-E with its walk of 236 epochs."""
    places = _ANCHORS_M if anchors_m is None else anchors_m
    track = _along(_WAYPOINTS_M, EPOCHS)
    return make_room("paper", _CORNERS_M, np.roll(_CORNERS_M, -1, axis=0), places, track)


def many_anchors(count: int) -> MeasurementSet:
    """The paper's room with anchors at random places."""
    places = np.random.default_rng(1).uniform((1.0, 1.0), (79.0, 59.0), (50 * count, 2))
    inside = (places[:, 1] < 39.0) | (places[:, 0] > 51.0)
    return paper_room(places[inside][:count]).measure(SimulationConfig(), 1)


def many_walls(count: int) -> MeasurementSet:
    """A room of so many walls, nearly a regular polygon, all of them seen at the start."""
    rng = np.random.default_rng(1)
    turn = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / count
    corners = _RADIUS_M * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    track = _along(np.array([(0.0, 0.0), (6.0, -3.0), (9.0, 8.0)]), EPOCHS // 4)
    anchors = ((12.0, 4.0), (-5.0, 11.0))
    return make_room("polygon", corners, np.roll(corners, -1, axis=0), anchors, track).measure(
        SimulationConfig(), 1
    )


def many_paths(count: int) -> MeasurementSet:
    """The paper's room, where clutter makes up so many paths of each anchor in an epoch, on average."""
    room = paper_room()
    true = float(room.scenario.visible()[: EPOCHS // 4].sum(axis=-1).mean())
    return room.measure(SimulationConfig(clutter_mean=max(count - true, 0.0)), 1)


def request(walls: int, anchors: int, paths: int) -> MeasurementSet:
    """One epoch of random paths, of all anchors, in front of random walls: nothing in it fits anything."""
    rng = np.random.default_rng(1)
    sensed = tuple(GaussianVrp(vrp, _STD_M**2 * np.eye(2)) for vrp in rng.uniform(-80.0, 80.0, (walls, 2)))
    std_s = np.full(paths, _STD_M / SPEED_OF_LIGHT_M_S)
    heard = tuple(
        AnchorPaths(np.sort(rng.uniform(1.0, _REACH_M, paths)) / SPEED_OF_LIGHT_M_S, std_s)
        for _ in range(anchors)
    )
    names = tuple(f"pa{k + 1}" for k in range(anchors))
    return MeasurementSet(names, sensed, (Epoch(0, 0.0, heard),), 28e9)
