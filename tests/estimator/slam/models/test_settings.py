"""Groups of settings refuse what they cannot mean, and say which setting, what it takes and what came."""

from __future__ import annotations

from dataclasses import fields, make_dataclass

import numpy as np
import pytest

from estimator.errors import ConfigurationError
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.models.settings import Settings, any_number, not_negative, positive, probability
from estimator.slam.models.visibility import Visibility

GROUPS = [
    type(getattr(GaussianConfig(), entry.name))
    for entry in fields(GaussianConfig)
    if isinstance(getattr(GaussianConfig(), entry.name), Settings)
]


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.__name__)
@pytest.mark.parametrize("value", [np.nan, np.inf, "much", None])
def test_what_is_no_number_is_refused(group, value):
    """In every group and every field: the error names both."""
    for entry in fields(group):
        with pytest.raises(ConfigurationError, match=rf"^{group.__name__}\.{entry.name}: expected"):
            group(**{entry.name: value})


@pytest.mark.parametrize(
    ("field", "refused", "taken"),
    [
        (positive, [0.0, -1.0], [1e-9, 5]),
        (not_negative, [-1e-9], [0.0, 5]),
        (probability, [0.0, 1.0, -0.1], [0.5]),
        (any_number, [], [-5.0, 0, 5]),
    ],
)
def test_each_kind_of_field_has_its_range(field, refused, taken):
    """A probability of one has no logarithm of its complement; a width of zero divides by zero."""
    default = field(0.5)
    made = make_dataclass("Made", [("one", float, default)], bases=(Settings,), frozen=True)
    for value in refused:
        with pytest.raises(ConfigurationError, match=r"^Made\.one: expected .*, got"):
            made(one=value)
    for value in taken:
        assert made(one=value).one == value


def test_clutter_has_a_density_even_where_there_is_none():
    """Without the floor the first false path would have no weight to compare with."""
    assert MeasurementNoise(clutter_mean=3.0, region_m=150.0).clutter_density == pytest.approx(0.02)
    assert MeasurementNoise(clutter_mean=0.0, region_m=100.0).clutter_density == pytest.approx(1e-4)


def test_visibility_is_a_group():
    """Its probabilities are open intervals: what never vanishes could never be found missing."""
    with pytest.raises(ConfigurationError, match=r"Visibility.vanish_probability"):
        Visibility(vanish_probability=0.0)


COUNTING = [group for group in GROUPS if any(entry.type == "int" for entry in fields(group))]


@pytest.mark.parametrize("group", COUNTING, ids=lambda group: group.__name__)
def test_whole_numbers_stay_whole(group):
    """Half a hypothesis or a third of a path cannot be counted."""
    for entry in fields(group):
        if entry.type == "int":
            with pytest.raises(ConfigurationError, match=rf"^{group.__name__}\.{entry.name}: expected"):
                group(**{entry.name: 2.5})
