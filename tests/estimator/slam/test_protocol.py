"""The step protocol: randomness by epoch, engines of one kind, candidates as arrays."""

from __future__ import annotations

import numpy as np

from estimator.slam.gaussian.engine import GaussianEngine
from estimator.slam.particle.engine import ParticleEngine
from estimator.slam.protocol import Candidate, Engine, Prior, epoch_rng, stacked_candidates
from estimator.slam.run import config_for, engine_for


def test_randomness_depends_on_seed_and_epoch_alone():
    """A run taken up again draws what it would have drawn; another seed or epoch draws something else."""
    drawn = {(seed, t): epoch_rng(seed, t).random() for seed in (0, 1) for t in (-1, 0, 5)}
    assert len(set(drawn.values())) == 6
    assert epoch_rng(1, 5).random() == drawn[1, 5]


def test_both_engines_keep_the_protocol(room):
    """A caller may hold either."""
    measured = room.measure(1, epochs=1)
    for name, kind in (("gaussian", GaussianEngine), ("particle", ParticleEngine)):
        engine = engine_for("hybrid", name, config_for(measured, engine=name))
        assert isinstance(engine, Engine)
        assert isinstance(engine, kind)
        assert engine.name == name
    prior = Prior.of(measured)
    assert prior.anchor_names == measured.anchors
    assert prior.anchors_m is None


def test_candidates_stand_by_wall_and_rank():
    """Walls of different candidates and epochs share a column each; what is not there is NaN."""
    one = Candidate(0.7, np.array([1.0, 2.0]), np.array([3, 5]), np.array([[1.0, 0.0], [0.0, 1.0]]))
    two = Candidate(0.3, np.array([1.5, 2.0]), np.array([4]), np.array([[2.0, 2.0]]))
    found = stacked_candidates([(one, two), (), (two,)])
    assert found["candidate_wall_id"].tolist() == [3, 4, 5]
    assert found["candidate_weight"][0].tolist() == [0.7, 0.3]
    assert np.isnan(found["candidate_weight"][1]).all()
    assert found["candidate_weight"][2, 0] == 0.3
    walls = found["candidate_wall_mean_m"]
    assert walls[0, 0, 2].tolist() == [0.0, 1.0]
    assert np.isnan(walls[0, 0, 1]).all()
    assert walls[2, 0, 1].tolist() == [2.0, 2.0]
