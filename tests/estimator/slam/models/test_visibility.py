"""Prior visibility by feature."""

from __future__ import annotations

import numpy as np

from estimator.slam.models.state_vector import Layout
from estimator.slam.models.visibility import Visibility, prior_visibility


def test_each_feature_has_the_prior_of_its_kind():
    """A pair as likely as a line of sight would take most paths in the first epoch."""
    model = Visibility(prior_sight=0.8, prior_wall=0.5, prior_pair=0.2)
    assert prior_visibility(Layout(2, 2), model).tolist() == [0.8, 0.5, 0.5, 0.2, 0.2, 0.2, 0.2]
    assert prior_visibility(Layout(2, 2, shared=False), model).tolist() == [0.8, 0.5, 0.5]
    assert np.array_equal(prior_visibility(Layout(1, 0), model), [0.8])
