"""Materials told from losses: those of the image method, with noise."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import ConfigurationError, InputError
from estimator.waveform import free_space_loss_db
from raytrace.plan.files import load_floorplan, updated
from raytrace.propagation.images import image_paths
from raytrace.propagation.slab_fit import SlabSearch, fit_slab

CARRIER_HZ = 28e9


def losses_of(material: str, thickness_m: float, rng: np.random.Generator, count: int = 40):
    """Bounces off the south wall of a room, and what they lose."""
    wall = {"name": "south", "from_m": [0, 0], "to_m": [30, 0], "height_m": 4.0}
    plan = updated(
        load_floorplan("hall"),
        {
            "walls": [{**wall, "material": material, "thickness_m": thickness_m}],
            "anchors": [{"name": "a", "position_m": [10.0, 8.0, 3.0]}],
            "agent.waypoints_m": [[2.0, 5.0], [28.0, 3.0]],
            "agent.epochs": 2,
        },
    )
    places = np.column_stack([rng.uniform(1, 29, count), rng.uniform(1, 9, count), np.full(count, 1.5)])
    paths = image_paths(plan, places, depth=1).flat()
    paths = paths.select(paths.order == 1)
    anchor, agent = plan.anchors_m()[0], places[paths.epoch]
    share = anchor[1] / (anchor[1] + agent[:, 1])
    bounce = anchor + share[:, None] * (agent - anchor)
    bounce[:, 1] = 0.0
    vertex = np.stack([np.broadcast_to(anchor, agent.shape), bounce, agent], axis=1)
    length = np.linalg.norm(np.diff(vertex, axis=1), axis=-1).sum(axis=1)
    loss = -20.0 * np.log10(np.abs(paths.amplitude)) - free_space_loss_db(length, CARRIER_HZ)
    return vertex, loss + 0.05 * rng.standard_normal(len(loss)), np.full(len(loss), 0.05)


@pytest.mark.parametrize(
    ("material", "thickness_m"),
    [
        ("concrete", 0.2),
        ("brick", 0.24),
        ("plasterboard", 0.026),
        ("wood", 0.04),
        ("glass", 0.03),
        ("metal", 0.01),
    ],
)
def test_materials_are_told(material, thickness_m):
    """The class is right and nearly certain, and losses of the fit are those of the wall."""
    fit = fit_slab(*losses_of(material, thickness_m, np.random.default_rng(4)), CARRIER_HZ)
    assert fit.material == material
    assert fit.probabilities[material] > 0.9
    assert sum(fit.probabilities.values()) == pytest.approx(1.0)
    assert fit.residual_db < 0.1


def test_a_few_wrong_losses_do_not_matter():
    """Every tenth loss is another path's."""
    vertex, loss, noise = losses_of("glass", 0.03, np.random.default_rng(5))
    loss[::10] += 6.0
    fit = fit_slab(vertex, loss, noise, CARRIER_HZ)
    assert fit.material == "glass"
    assert fit.thickness_m == pytest.approx(0.03, abs=0.5e-3)


def test_what_is_known_before_counts():
    """A material that cannot be is not found."""
    losses = losses_of("glass", 0.03, np.random.default_rng(6), count=3)
    fit = fit_slab(*losses, CARRIER_HZ, prior={"concrete": 1.0})
    assert fit.material == "concrete"


def test_nothing_tells_nothing():
    """A wall without losses, and searches that cannot be."""
    with pytest.raises(InputError, match="expected losses of a wall's reflections, got none"):
        fit_slab(np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0), CARRIER_HZ)
    with pytest.raises(ConfigurationError, match="at least one candidate"):
        SlabSearch(materials=())
    with pytest.raises(ConfigurationError, match="ascending thicknesses"):
        SlabSearch(thinnest_m=0.5)
