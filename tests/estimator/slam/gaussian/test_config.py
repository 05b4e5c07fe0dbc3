"""The configuration in groups: flat names are unique, changes land in their group, errors name them."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields

import pytest

from estimator.errors import ConfigurationError
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.phase import phase_of
from estimator.slam.models.state_vector import Layout
from estimator.slam.particle.config import ParticleConfig


@pytest.mark.parametrize("config", [GaussianConfig(), ParticleConfig()])
def test_flat_names_are_unique(config):
    """Two settings of one name could not both be set."""
    names = [one.name for entry in fields(config) for one in fields(getattr(config, entry.name))]
    assert len(names) == len(set(names))
    assert set(config.flat()) == set(config.names()) == set(names)


def test_a_change_lands_in_its_group_alone():
    """The rest is the default's, and the default stays what it is."""
    changed = GaussianConfig.of(range_std_m=0.3, birth_window=20)
    assert changed.noise.range_std_m == 0.3
    assert changed.births.birth_window == 20
    assert changed.but(range_std_m=0.02, birth_window=18) == GaussianConfig()
    default, flat = GaussianConfig().flat(), changed.flat()
    assert {name for name in flat if flat[name] != default[name]} == {"range_std_m", "birth_window"}
    with pytest.raises(FrozenInstanceError):
        changed.noise.range_std_m = 1.0


def test_unknown_names_and_values_out_of_range_are_told():
    """With the names that were given."""
    with pytest.raises(ConfigurationError, match="expected names of settings, got colour, size"):
        GaussianConfig.of(size=1, colour=2)
    with pytest.raises(
        ConfigurationError, match=r"MeasurementNoise\.range_std_m: expected a positive number"
    ):
        GaussianConfig.of(range_std_m=0.0)


def test_compiled_functions_get_what_is_set():
    """A field in the wrong place of a tuple would be another's value."""
    config = GaussianConfig()
    for name, value in config.flat().items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            continue
        for kernel in config.kernels:
            if name in kernel._fields:
                other = config.but(**{name: 0.5 * value if isinstance(value, float) else value + 1})
                moved = [k for k, fresh in zip(config.kernels, other.kernels, strict=True) if k != fresh]
                assert moved
                for before in moved:
                    after = next(k for k in other.kernels if type(k) is type(before))
                    changed = {f for f in before._fields if getattr(before, f) != getattr(after, f)}
                    assert changed == {name}
                break


@pytest.mark.parametrize("config", [GaussianConfig(), ParticleConfig()])
def test_every_group_says_what_its_fields_are(config):
    """A setting without unit and reason is a constant with another name."""
    for entry in fields(config):
        group = type(getattr(config, entry.name))
        for one in fields(group):
            assert one.name in (group.__doc__ or ""), f"{group.__name__}.{one.name}"


def test_phases():
    """Nothing unlikely is merged early in the first epochs; patience while no wall is known."""
    config = GaussianConfig()
    parts = config.phases, config.reduction, config.lifecycle
    first, settled, blind = (
        phase_of(0, False, *parts),
        phase_of(8, False, *parts),
        phase_of(100, True, *parts),
    )
    assert first.unlikely_sigma == config.reduction.alike_sigma
    assert settled.unlikely_sigma == config.reduction.unlikely_sigma
    assert blind.prune_nats == 3.0 * settled.prune_nats
    assert blind.confirm_support == 2 * settled.confirm_support
    model = config.reduce_model(settled, Layout(2, 5))
    assert (model.prune_nats, model.most) == (settled.prune_nats, config.reduction.max_hypotheses)
