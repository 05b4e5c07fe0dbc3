"""Smoothed runs as a good engine would make them: a plan's own paths, given to the right features."""

from __future__ import annotations

import numpy as np

from estimator.geometry import segments_cross, vrp_of_line
from estimator.joint_map import JointMap
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.result import SlamResult
from estimator.twin.bounces import gain_noise_db
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.images import image_paths

STD_M = 0.03
RESOLVED_M = 0.3


def lines_of(plan: FloorPlan, among: list[str] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """VRPs (L, 2) of the plan's lines from the track's start, and the line of each wall; -1 if left out."""
    start, end = plan.walls_m()
    vrps = vrp_of_line(start, end, plan.track()[0, :2]) - plan.track()[0, :2]
    line, found = np.full(len(vrps), -1), []
    for i, vrp in enumerate(vrps):
        if among is not None and plan.walls[i].name not in among:
            continue
        same = [j for j, other in enumerate(found) if np.linalg.norm(other - vrp) < 1e-6]
        line[i] = same[0] if same else len(found)
        if not same:
            found.append(vrp)
    return np.array(found).reshape(-1, 2), line


def _flashes(plan: FloorPlan, line: np.ndarray, agent: np.ndarray, rng: np.random.Generator) -> tuple:
    """The agent's images in the walls that it faces at right angles and sees, relative to it."""
    start, end = plan.walls_m()
    along = end - start
    share = np.sum((agent - start) * along, axis=1) / np.sum(along**2, axis=1)
    foot = start + share[:, None] * along
    found = []
    for wall in np.flatnonzero((share > 0.0) & (share < 1.0) & (line >= 0)):
        others = np.arange(len(start)) != wall
        if not segments_cross(agent, foot[wall], start[others], end[others]).any():
            image = 2.0 * (foot[wall] - agent) + STD_M * rng.standard_normal(2)
            found.append(GaussianVrp(image, STD_M**2 * np.eye(2)))
    return tuple(found)


def _resolved(lengths: np.ndarray, amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Paths (ascending) that a link of 400 MHz tells apart: the strongest of each cluster, and their sums."""
    if not len(lengths):
        return np.zeros(0, dtype=int), amplitude
    group = np.concatenate([[0], np.cumsum(np.diff(lengths) > RESOLVED_M)])
    strongest = [
        np.flatnonzero(group == g)[np.argmax(np.abs(amplitude[group == g]))] for g in range(group[-1] + 1)
    ]
    total = np.array([amplitude[group == g].sum() for g in range(group[-1] + 1)])
    return np.array(strongest), total


def _gain_noise(lengths: np.ndarray) -> np.ndarray:
    """Standard deviations of gains at 400 MHz by the distance of the next path."""
    if len(lengths) < 2:
        return np.full(len(lengths), 0.05)
    gap = np.abs(lengths[:, None] - lengths) + 1e9 * np.eye(len(lengths))
    return gain_noise_db(gap.min(axis=1))


def mapped_run(
    plan: FloorPlan,
    rng: np.random.Generator,
    stride: int = 1,
    among: list[str] | None = None,
    mistaken: float = 0.0,
    offset_db: float = 0.0,
    sweeps: bool = False,
) -> tuple[SlamResult, MeasurementSet]:
    """A smoothed run along every ``stride``-th position, and what it was made of.

    ``among`` names the walls that were mapped; a share of double bounces is ``mistaken`` for another's. With
    ``sweeps`` every position sees the mapped walls that lie straight before it.
    """
    track = plan.track()[::stride]
    paths = image_paths(plan, track)
    vrps, line = lines_of(plan, among)
    epochs, anchors, count = len(track), len(plan.anchors), len(vrps)
    columns: dict[str, list] = {
        "epoch": [],
        "anchor": [],
        "number": [],
        "walls": [],
        "gain": [],
        "length": [],
    }
    heard = []
    for t in range(epochs):
        of_anchors = []
        for k in range(anchors):
            order = np.flatnonzero(paths.valid[t, k])
            merged, amplitude = _resolved(
                paths.delay_s[t, k][order] * SPEED_OF_LIGHT_M_S, paths.amplitude[t, k][order]
            )
            order = order[merged]
            noise = STD_M * rng.standard_normal(len(order))
            length = paths.delay_s[t, k][order] * SPEED_OF_LIGHT_M_S + noise
            gain = 20.0 * np.log10(np.abs(amplitude)) + offset_db
            gain = gain + _gain_noise(length) * rng.standard_normal(len(order))
            std = np.full(len(order), STD_M / SPEED_OF_LIGHT_M_S)
            of_anchors.append(AnchorPaths(length / SPEED_OF_LIGHT_M_S, std, gain))
            for number, walls in enumerate(paths.walls[t, k][order]):
                lines = [int(line[wall]) if wall < len(line) else -1 for wall in walls if wall >= 0]
                if -1 in lines or len(lines) > 2 or len(set(lines)) < len(lines):
                    continue
                if len(lines) == 2 and rng.random() < mistaken:
                    lines = rng.permutation(count)[:2].tolist()
                columns["epoch"].append(t)
                columns["anchor"].append(k)
                columns["number"].append(number)
                columns["walls"].append([*lines, -1, -1][:2])
                columns["gain"].append(gain[number])
                columns["length"].append(length[number])
        sweep = _flashes(plan, line, track[t, :2], rng) if sweeps else ()
        heard.append(Epoch(t, float(t), tuple(of_anchors), sweep))
    rise = plan.anchors_m()[:, 2] - plan.agent.height_m
    here = plan.anchors_m()[:, :2] - track[0, :2]
    size = 2 * (anchors + count)
    joint = JointMap(
        plan.radio.carrier_hz,
        rise**2,
        np.full(anchors, 1e-3),
        np.zeros(anchors),
        np.zeros(anchors),
        1e-4 * np.eye(size),
        np.full((count, 2), np.nan),
        np.array(columns["epoch"]),
        np.array(columns["anchor"]),
        np.array(columns["number"]),
        np.array(columns["walls"], dtype=np.int64).reshape(-1, 2),
        np.array(columns["length"]),
        np.full(len(columns["epoch"]), STD_M),
        np.array(columns["gain"]),
        np.zeros(len(columns["epoch"])),
    )
    agent = np.zeros((epochs, 4))
    agent[:, :2] = track[:, :2] - track[0, :2]
    ones = np.ones(epochs, dtype=np.int64)
    names = tuple(anchor.name for anchor in plan.anchors)
    result = SlamResult(
        method="hybrid",
        engine="smoother",
        seed=1,
        anchors=names,
        epoch=np.arange(epochs),
        time_s=np.arange(epochs) * 1.0,
        agent_mean=agent,
        agent_covariance=np.tile(1e-4 * np.eye(4), (epochs, 1, 1)),
        rotation_std_rad=np.full(epochs, 1e-3),
        anchor_valid=np.ones((epochs, anchors), dtype=bool),
        anchor_mean_m=np.tile(here, (epochs, 1, 1)),
        anchor_covariance_m2=np.tile(1e-4 * np.eye(2), (epochs, anchors, 1, 1)),
        wall_id=np.arange(count),
        wall_valid=np.ones((epochs, count), dtype=bool),
        wall_mean_m=np.tile(vrps, (epochs, 1, 1)),
        wall_covariance_m2=np.tile(1e-4 * np.eye(2), (epochs, count, 1, 1)),
        hypotheses=ones,
        log_evidence=np.zeros(epochs),
        anchor_existence=np.ones((epochs, anchors)),
        wall_existence=np.ones((epochs, count)),
        candidate_weight=np.ones((epochs, 1)),
        candidate_agent_m=agent[:, None, :2],
        candidate_wall_id=np.arange(count),
        candidate_wall_mean_m=np.tile(vrps, (epochs, 1, 1, 1)),
        settings={"measurements": {}},
        dataset=None,
        joint=joint,
    )
    return result, MeasurementSet(names, (), tuple(heard), plan.radio.carrier_hz, settings={})
