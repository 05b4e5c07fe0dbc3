"""SLAM: epochs of path delays in; agent, anchors and walls with uncertainty out."""

from estimator.slam.config import GaussianConfig
from estimator.slam.engine import Engine, GaussianEngine, Prior, epoch_rng
from estimator.slam.estimate import Estimate, estimate
from estimator.slam.gaussian.filter import step, step_many
from estimator.slam.gaussian.start import start
from estimator.slam.gaussian.state import GaussianState, load_state, save_state
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.engine import ParticleEngine
from estimator.slam.run import run_slam
from estimator.slam.run_many import run_many

__all__ = [
    "Engine",
    "Estimate",
    "GaussianConfig",
    "GaussianEngine",
    "GaussianState",
    "ParticleConfig",
    "ParticleEngine",
    "Prior",
    "epoch_rng",
    "estimate",
    "load_state",
    "run_many",
    "run_slam",
    "save_state",
    "start",
    "step",
    "step_many",
]
