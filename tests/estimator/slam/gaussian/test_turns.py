"""Sudden turns: each hypothesis once more with a new velocity, by the rate of turns."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.gaussian.turns import with_turns
from estimator.slam.models.motion import Motion
from tests.estimator.slam.models.test_hypotheses import some


def test_each_hypothesis_goes_on_or_turns():
    """Weights are shared by the chance of a turn; of the old velocity nothing is left in the new one."""
    given = some(3)
    motion = Motion(turn_rate_hz=0.2, velocity_std_m_s=1.5)
    both = with_turns(given, 0.5, motion)
    assert both.number == 6
    assert np.exp(both.log_weight[3:] - given.log_weight) == pytest.approx(0.1)
    assert np.exp(both.log_weight[:3] - given.log_weight) == pytest.approx(0.9)
    assert np.array_equal(both.mean[:3], given.mean)
    assert not both.mean[3:, 2:4].any()
    assert np.array_equal(both.mean[3:, 4:], given.mean[:, 4:])
    np.testing.assert_allclose(both.covariance[3:, 2:4, 2:4], np.tile(2.25 * np.eye(2), (3, 1, 1)))
    assert not both.covariance[3:, 2:4, 4:].any()
    assert np.array_equal(both.covariance[3:, 4:, 4:], given.covariance[:, 4:, 4:])


def test_without_turns_nothing_doubles():
    """A rate of zero leaves the hypotheses themselves."""
    given = some(3)
    assert with_turns(given, 0.5, Motion(turn_rate_hz=0.0)) is given
