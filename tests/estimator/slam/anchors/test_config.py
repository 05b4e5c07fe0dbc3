"""The configuration of the anchor search."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from estimator.errors import ConfigurationError
from estimator.slam.anchors.config import AnchorSearchConfig


@pytest.mark.parametrize("entry", [entry.name for entry in fields(AnchorSearchConfig)])
def test_what_makes_no_sense_is_refused(entry):
    """A limit of nothing, or a number that is none, would fail deep inside a run."""
    with pytest.raises(ConfigurationError, match=entry):
        replace(AnchorSearchConfig(), **{entry: float("nan")})


@pytest.mark.parametrize("entry", ["max_pairs", "clock_step_m", "start_attempts", "search_gate_sigma"])
def test_limits_are_positive(entry):
    """Zero or less would search nothing and say nothing."""
    with pytest.raises(ConfigurationError, match=entry):
        replace(AnchorSearchConfig(), **{entry: 0})


@pytest.mark.parametrize("entry", ["fresh_probability", "search_visibility_los"])
def test_probabilities_are_below_one(entry):
    """A certainty has an infinite log odds."""
    with pytest.raises(ConfigurationError, match=entry):
        replace(AnchorSearchConfig(), **{entry: 1.0})


def test_log_priors_may_be_negative():
    """They mostly are."""
    assert replace(AnchorSearchConfig(), rival_log_prior=-9.0).rival_log_prior == -9.0
