"""SLAM: epochs of path delays in; agent, anchors and walls with uncertainty out."""

from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.engine import GaussianEngine, step
from estimator.slam.gaussian.estimate import estimate
from estimator.slam.gaussian.start import start
from estimator.slam.gaussian.state import GaussianState, load_state, save_state
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.engine import ParticleEngine
from estimator.slam.protocol import Engine, Estimate, Prior, epoch_rng
from estimator.slam.run import run_slam

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
    "run_slam",
    "save_state",
    "start",
    "step",
]
