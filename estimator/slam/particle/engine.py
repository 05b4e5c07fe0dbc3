"""The particle engine: belief propagation SLAM with independent marginals, as published.

    J. Yang, C.-K. Wen, S. Jin, "Hybrid Active and Passive Sensing for SLAM in Wireless
    Communication Systems", Section IV.

Each node, the agent, every anchor, every wall, has its own belief, a cloud of particles.
An epoch runs through the anchors one after the other, (27), each with the beliefs that the
one before left:

    predict the agent, (38), (39), and the features, (40), (41)
    -> per anchor: associate, (28)-(31); weigh agent, anchor and features, (42)-(47);
       keep what did not get worse, (48); start features from unexplained paths, (46)
    -> locate anchors, IV-B1 -> merge, (48), and prune features

The beliefs forget how agent, anchors and walls hang together; the covariances are too
small accordingly, those of the map's rotation most of all. :mod:`estimator.slam.gaussian.engine`
is the engine that keeps them. Where this engine departs from the paper, its configuration
says so: the detection probability of a pair of anchor and feature is learned
(``start_visibility``), for a wall that one anchor is not heard over is not for that reason
no wall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.measurements import Epoch
from estimator.slam.methods import Method, note_unused, walls_at_start
from estimator.slam.models.clutter_guard import guard_clutter
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.particle.anchors import remember_paths, ring_anchors, start_anchors
from estimator.slam.particle.births import merged, pruned
from estimator.slam.particle.cloud import gaussian_cloud, moments_of
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.found import found_walls, vrp_cloud
from estimator.slam.particle.state import (
    Features,
    ParticleState,
    load_particle_state,
    save_particle_state,
)
from estimator.slam.particle.step import hear_anchor, predict
from estimator.slam.protocol import LEAST_WEIGHT, MOST, Candidate, Estimate, Prior

__all__ = ["ParticleEngine"]

Array = NDArray[np.float64]
Wall = tuple[int, Array, Array, float]
Moments = tuple[Array, Array]


@dataclass(frozen=True)
class ParticleEngine:
    """Belief propagation with particles, for one method.

    Parameters
    ----------
    config : ParticleConfig
        Models and limits.
    method : Method
        What is known and sensed.
    """

    config: ParticleConfig
    method: Method
    name: str = "particle"

    def start(self, prior: Prior, rng: np.random.Generator) -> ParticleState:
        """The state before the first epoch.

        Raises
        ------
        InputError
            If the prior lacks what the method knows at the start: walls or anchors.
        """
        config, count = self.config, len(prior.anchor_names)
        if count == 0:
            raise InputError(f"{self.method.name} SLAM: expected at least one anchor, got none")
        if self.method.walls and not prior.walls:
            raise InputError(
                f"{self.method.name} SLAM: expected at least one wall sensed at the start, got none"
            )
        agent = np.diag([config.motion.start_std_m**2] * 2 + [config.motion.velocity_std_m_s**2] * 2)
        anchors = [np.zeros((2, config.inference.particles), np.float32)] * count
        known = self.method.anchors == "known"
        note_unused(self.method, prior, anchors_used=known)
        if known:
            if prior.anchors_m is None:
                raise InputError(
                    f"{self.method.name} SLAM: expected measurements that know where the anchors are "
                    "(known_anchors_m), got none"
                )
            spread = config.motion.anchor_std_m**2 * np.eye(2)
            for k, place in enumerate(prior.anchors_m):
                anchors[k] = gaussian_cloud(place, spread, config.inference.particles, rng)
        walls = walls_at_start(self.method, prior)
        clouds = [gaussian_cloud(w.mean_m, w.covariance_m2, config.inference.particles, rng) for w in walls]
        size = len(walls)
        return ParticleState(
            method=self.method.name,
            anchor_names=prior.anchor_names,
            epoch=-1,
            time_s=0.0,
            log_evidence=0.0,
            next_wall_id=size,
            agent=gaussian_cloud(np.zeros(4), agent, config.inference.particles, rng),
            anchors_m=tuple(anchors),
            located=np.full(count, known),
            sight=np.full(count, config.visibility.start_visibility),
            features=Features(
                tuple(clouds),
                np.full(size, config.features.survival_probability),
                np.full((size, count), config.visibility.start_visibility),
                np.full(size, -1, dtype=np.int64),
                np.arange(size),
                np.full(size, -1, dtype=np.int64),
            ),
            buffer=PathBuffer.empty(),
        )

    def step(self, state: ParticleState, epoch: Epoch, rng: np.random.Generator) -> ParticleState:
        """The state after one more epoch; the given state is not changed.

        Anchors with more than ``most_paths`` paths count as not heard.

        Raises
        ------
        InputError
            If the epoch is not later than the state, or has another number of anchors.
        """
        if len(epoch.paths) != len(state.anchor_names):
            raise InputError(
                f"epoch {epoch.index}: expected paths of {len(state.anchor_names)} anchors, "
                f"got {len(epoch.paths)}"
            )
        if state.epoch >= 0:
            if epoch.index <= state.epoch or not epoch.time_s > state.time_s:
                raise InputError(
                    f"epoch {epoch.index} at {epoch.time_s} s: expected one later than epoch {state.epoch} "
                    f"at {state.time_s} s"
                )
            step_s = epoch.time_s - state.time_s
            state = predict(state, step_s, epoch.was_asked, self.method, self.config, rng)
        state = replace(state, epoch=epoch.index, time_s=epoch.time_s)
        epoch = guard_clutter(epoch, self.config.noise.most_paths)
        if not self.method.paths:
            return state
        for k in np.flatnonzero(state.located & epoch.was_asked).tolist():
            state = hear_anchor(state, k, epoch.paths[k], self.method, self.config, rng)
        if not state.located.all():
            if self.method.anchors == "ring":
                state = ring_anchors(remember_paths(state, epoch, self.config), self.config, rng)
            else:
                state = remember_paths(start_anchors(state, epoch, self.config, rng), epoch, self.config)
        features = merged(state.features, self.config)
        return replace(state, features=pruned(features, epoch.index, self.config))

    def estimate(self, state: ParticleState) -> Estimate:
        """MMSE estimates (34), (37) of what is found, (35), with the clouds' covariances.

        Virtual anchors are given as the walls they imply, (3); a wall that several anchors
        found is given once, as the one that knows it best. The rotation's standard
        deviation is that of the walls' bearings taken as independent, as this engine does.
        """
        mean, covariance = moments_of(state.agent)
        count = len(state.anchor_names)
        anchors, spreads = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        for k in np.flatnonzero(state.located):
            anchors[k], spreads[k] = moments_of(state.anchors_m[k])
        placed = found_walls(state, self.config)
        walls = self._walls(state, placed)
        return Estimate(
            agent_mean=mean,
            agent_covariance=covariance,
            rotation_std_rad=_rotation_std(walls),
            anchor_valid=state.located.copy(),
            anchor_mean_m=anchors,
            anchor_covariance_m2=spreads,
            wall_id=np.array([number for number, _, _, _ in walls], dtype=np.int64),
            wall_mean_m=np.array([place for _, place, _, _ in walls]).reshape(-1, 2),
            wall_covariance_m2=np.array([spread for _, _, spread, _ in walls]).reshape(-1, 2, 2),
            hypotheses=state.particles,
            log_evidence=state.log_evidence,
            anchor_existence=state.located.astype(np.float64),
            wall_existence=np.array([existence for _, _, _, existence in walls], dtype=np.float64),
            candidates=self._candidates(state, mean[:2], placed),
        )

    def save(self, state: ParticleState) -> bytes:
        """See :func:`estimator.slam.particle.state.save_particle_state`."""
        return save_particle_state(state)

    def load(self, data: bytes) -> ParticleState:
        """See :func:`estimator.slam.particle.state.load_particle_state`."""
        state = load_particle_state(data)
        if state.method != self.method.name:
            raise InputError(f"state: expected one of method {self.method.name}, got {state.method}")
        return state

    def _walls(self, state: ParticleState, placed: dict[int, Moments]) -> list[Wall]:
        """Identity, mean, covariance and probability of the walls that are found, oldest first."""
        found: list[Wall] = []
        for j, (mean, covariance) in placed.items():
            existence = min(float(state.features.existence[j]), 1.0)
            wall = (int(state.features.wall_id[j]), mean, covariance, existence)
            for i, other in enumerate(found):
                if np.linalg.norm(wall[1] - other[1]) < self.config.features.similarity_m:
                    surer = max(wall[3], other[3])
                    better = wall if np.trace(wall[2]) < np.trace(other[2]) else other
                    found[i] = (other[0], better[1], better[2], surer)
                    break
            else:
                found.append(wall)
        return sorted(found, key=lambda entry: entry[0])

    def _candidates(
        self, state: ParticleState, agent_m: Array, placed: dict[int, Moments]
    ) -> tuple[Candidate, ...]:
        """The walls that are not found yet, the likeliest first."""
        existence = state.features.existence
        order = np.argsort(-existence, kind="stable").tolist()
        waiting = [j for j in order if j not in placed and existence[j] >= LEAST_WEIGHT]
        return tuple(
            Candidate(
                min(float(existence[j]), 1.0),
                agent_m,
                state.features.wall_id[[j]],
                moments_of(vrp_cloud(state, j))[0][None],
            )
            for j in waiting[:MOST]
        )


def _rotation_std(walls: list[Wall]) -> float:
    """Standard deviation of the rotation, radians; uniform on the circle without walls."""
    information = 3.0 / np.pi**2
    for _, mean, covariance, _ in walls:
        square = float(mean @ mean)
        tangent = np.array([-mean[1], mean[0]])
        information += square**2 / max(float(tangent @ covariance @ tangent), 1e-12)
    return float(information**-0.5)
