"""Materials of walls with several, and of walls whose reflections are not resolved."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import ConfigurationError
from estimator.waveform import SPEED_OF_LIGHT_M_S, free_space_loss_db
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.materials import permittivity, slab_reflection
from raytrace.prediction.material_refinement import ClusterFit, clusters_of, refine_materials
from raytrace.prediction.wall_parts import Losses, wall_parts
from raytrace.propagation.images import image_paths

CARRIER_HZ = 28e9


def losses(parts: list[tuple[float, float, str, float]], rng: np.random.Generator, count: int = 30) -> Losses:
    """Level bounces off a wall along the x axis, of parts from, to, material and thickness."""
    along, vertex, loss = [], [], []
    for first, last, material, thickness in parts:
        for x in rng.uniform(first, last, count):
            half, height = rng.uniform(0.5, 6.0), 3.0
            cosine = height / np.hypot(half, height)
            te, _ = slab_reflection(cosine, permittivity(material, CARRIER_HZ), thickness, CARRIER_HZ)
            along.append(x)
            vertex.append([[x - half, height, 0], [x, 0, 0], [x + half, height, 0]])
            loss.append(-20.0 * np.log10(abs(te)) + 0.05 * rng.standard_normal())
    return Losses(np.array(along), np.array(vertex), np.array(loss), np.full(len(loss), 0.05))


def test_a_wall_is_cut_where_its_material_changes():
    """Plasterboard, then glass from a corner on; a corner at which nothing changes is none."""
    heard = losses([(0, 4, "plasterboard", 0.1), (4, 9, "glass", 0.02)], np.random.default_rng(1))
    parts = wall_parts(9.0, [2.0, 4.0], heard, CARRIER_HZ)
    assert [(p.from_m, p.to_m, p.fit.material) for p in parts] == [
        (0.0, 4.0, "plasterboard"),
        (4.0, 9.0, "glass"),
    ]


def test_parts_that_nobody_heard_take_after_their_neighbours():
    """A part without a bounce is no part; a wall without one has no fit."""
    heard = losses([(0, 4, "brick", 0.12)], np.random.default_rng(2))
    (part,) = wall_parts(9.0, [5.0], heard, CARRIER_HZ)
    assert (part.from_m, part.to_m, part.fit.material) == (0.0, 9.0, "brick")
    (part,) = wall_parts(9.0, [], heard.between(5.0, 9.0), CARRIER_HZ)
    assert part.fit is None


@pytest.fixture(scope="module")
def corridor():
    """The corridor, and what a link of 400 MHz measures of it: powers of clusters that interfere."""
    plan, rng = load_floorplan("corridor"), np.random.default_rng(3)
    track = plan.track()
    paths = image_paths(plan, track)
    lengths, gains = [], []
    for t in range(len(track)):
        of_lengths, of_gains = [], []
        for k in range(len(plan.anchors)):
            valid = paths.valid[t, k]
            length = paths.delay_s[t, k][valid] * SPEED_OF_LIGHT_M_S
            amplitude = paths.amplitude[t, k][valid] * np.exp(2j * np.pi * rng.random(valid.sum()))
            group = (
                np.concatenate([[0], np.cumsum(np.diff(length) > 0.75)]) if len(length) else np.zeros(0, int)
            )
            total = np.array([np.sum(amplitude[group == g]) for g in range(group.max(initial=-1) + 1)])
            of_lengths.append(np.array([length[group == g][0] for g in range(len(total))]))
            of_gains.append(20.0 * np.log10(np.abs(total) + 1e-12))
        lengths.append(of_lengths)
        gains.append(of_gains)
    return plan, track, lengths, gains


def test_unresolved_walls_are_told_from_clusters(corridor):
    """From a corridor of glass all over to its plasterboard, concrete, metal and brick."""
    plan, track, lengths, gains = corridor
    walls = [
        {**wall.model_dump(mode="json"), "material": "glass", "thickness_m": 0.01} for wall in plan.walls
    ]
    blank = updated(plan, {"walls": walls})
    fits = refine_materials(blank, clusters_of(blank, track, lengths, gains), [w.name for w in plan.walls])
    right = {wall.name: fits[wall.name][0] == wall.material for wall in plan.walls}
    assert sum(right.values()) >= 7, fits
    assert right["lift"]
    assert all(sum(fit[2].values()) == pytest.approx(1.0) for fit in fits.values())


def test_walls_that_are_known_stay(corridor):
    """Only those that are asked for are told."""
    plan, track, lengths, gains = corridor
    fits = refine_materials(plan, clusters_of(plan, track, lengths, gains), ["lift"])
    assert fits["lift"][0] == "metal"
    assert set(fits) == {"lift"}
    with pytest.raises(ConfigurationError, match="expected at least one of each"):
        ClusterFit(materials=())


def test_clusters_hold_what_was_measured(corridor):
    """Powers of line of sight and its neighbours add up to what was measured about them."""
    plan, track, lengths, gains = corridor
    clusters = clusters_of(plan, track, lengths, gains)
    direct = clusters.cluster[np.flatnonzero((clusters.paths.order == 0) & (clusters.paths.anchor == 0))]
    assert np.mean(clusters.measured[direct] > 0.0) > 0.95
    length = clusters.paths.delay_s * SPEED_OF_LIGHT_M_S
    alone = np.bincount(clusters.cluster)[clusters.cluster] == 1
    single = np.flatnonzero(alone & (clusters.paths.order == 0))
    free = 10.0 ** (-free_space_loss_db(length[single], CARRIER_HZ) / 10.0)
    np.testing.assert_allclose(clusters.measured[clusters.cluster[single]], free, rtol=1e-6)
