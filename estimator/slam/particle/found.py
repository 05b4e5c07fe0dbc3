"""Which features are found, and where they are ((34), (35))."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.particle.births import vrp_between
from estimator.slam.particle.cloud import Cloud, moments_of
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.state import ParticleState

__all__ = ["found_walls", "vrp_cloud"]

Array = NDArray[np.float64]


def vrp_cloud(state: ParticleState, j: int) -> Cloud:
    """Feature ``j``'s particles as VRPs, whatever it is kept as."""
    cloud, owner = state.features.points_m[j], int(state.features.owner[j])
    return cloud if owner < 0 else vrp_between(state.anchors_m[owner], cloud)


def found_walls(state: ParticleState, config: ParticleConfig) -> dict[int, tuple[Array, Array]]:
    """Mean (2,) and covariance (2, 2) of each feature's VRP that is found, by the feature's number.

    It exists, (35), and is not all round a circle (``found_std_m``).
    """
    exists = np.flatnonzero(state.features.existence >= config.features.detect_threshold).tolist()
    moments = {j: moments_of(vrp_cloud(state, j)) for j in exists}
    most = 2.0 * config.features.found_std_m**2
    return {j: (mean, spread) for j, (mean, spread) in moments.items() if np.trace(spread) <= most}
