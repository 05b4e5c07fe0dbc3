"""Flashes: the agent's own images in the walls, and their derivatives."""

from __future__ import annotations

import numpy as np

from estimator.geometry import mirror_in_wall
from estimator.slam.models.state_vector import THETA
from estimator.slam.models.sweeps import predict_flashes
from tests.estimator.slam.models.test_path_lengths import state_of


def test_flashes_are_the_agents_own_images(room):
    """A sweep would be matched to the wrong walls: flashes are mirror images, turned by theta."""
    mean, layout = state_of(room, room.track[120])
    mean[THETA] = 0.3
    flash, _ = predict_flashes(mean, layout)
    image = mirror_in_wall(room.track[120], room.walls[:, 0], room.walls[:, 1]) - room.track[120]
    c, s = np.cos(0.3), np.sin(0.3)
    assert np.allclose(flash, image @ np.array([[c, -s], [s, c]]).T, atol=1e-9)


def test_derivatives_are_central_differences(room):
    """A wrong derivative would correct agent, walls and rotation the wrong way."""
    mean, layout = state_of(room, room.track[120])
    mean[THETA] = 0.1
    _, jacobian = predict_flashes(mean, layout)
    for column in range(layout.size):
        shift = np.zeros(layout.size)
        shift[column] = 1e-5
        ahead, behind = (predict_flashes(mean + s * shift, layout)[0] for s in (1, -1))
        assert np.allclose(jacobian[..., column], (ahead - behind) / 2e-5, atol=1e-6)
