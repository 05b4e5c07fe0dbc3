"""Anchors enter the hypotheses: who is searched, what is enough, and what an epoch may cost."""

from __future__ import annotations

from dataclasses import replace
from time import process_time

import numpy as np
import pytest

from estimator.slam.anchors import SearchInput, initialise, locate_anchors
from estimator.slam.anchors.search import Candidates
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.hypotheses import Hypotheses, log_sum_exp
from estimator.slam.models.path_buffer import PathBuffer, Track
from estimator.slam.models.state_vector import NOWHERE_M, Layout
from estimator.slam.models.visibility import Visibility, prior_visibility
from tests.estimator.slam.anchors.scenes import ANCHOR, NOISE, SEARCH, WALLS, mirrored, path_lengths

OTHER = np.array([-8.0, 16.0])


def hypotheses_of(layout: Layout, walls: np.ndarray, count: int = 1, clock_std: float = 0.0) -> Hypotheses:
    """Hypotheses that know the agent and the walls, and no anchor."""
    mean, variance = np.zeros((count, layout.size)), np.full(layout.size, 1e-4)
    mean[:, layout.walls] = walls.ravel()
    for k in range(layout.anchors):
        mean[:, layout.anchor(k)] = NOWHERE_M, 0.0, 0.0, 0.0
        variance[layout.bias(k)] = clock_std**2
        variance[layout.anchor_xy(k)] = 0.0
    weight = -0.1 * np.arange(count)
    return Hypotheses(
        weight - log_sum_exp(weight),
        mean,
        np.tile(np.diag(variance), (count, 1, 1)),
        np.zeros((count, layout.anchors), dtype=bool),
        np.ones((count, layout.slots), dtype=bool),
        np.tile(prior_visibility(layout, Visibility()), (count, layout.anchors, 1)),
        np.zeros((count, layout.slots), dtype=np.int64),
    )


def reduced(hypotheses: Hypotheses) -> Hypotheses:
    """Normalised, the likeliest hundred."""
    kept = hypotheses.take(np.argsort(-hypotheses.log_weight, kind="stable")[:100])
    return kept._replace(log_weight=kept.log_weight - log_sum_exp(kept.log_weight))


def given_paths(layout: Layout, lengths: list[list[np.ndarray]], noise=NOISE) -> SearchInput:
    """The input of an epoch whose paths, and those of the epochs before, are ``lengths[epoch][anchor]``."""
    epochs, anchors = len(lengths), layout.anchors
    most = max(len(own) for own in lengths[-1])
    table = np.ones((anchors, most))
    for k, own in enumerate(lengths[-1]):
        table[k, : len(own)] = own
    number = np.array([len(own) for own in lengths[-1]])
    none = np.full(table.shape, np.nan)
    never, asked = np.full_like(table, np.inf), np.ones(anchors, dtype=bool)
    paths = EpochPaths(number, table, np.full_like(table, 0.1), none, 0.0 * table, never, True, asked)
    old = [(t, k, x) for t in range(epochs - 1) for k in range(anchors) for x in lengths[t][k]]
    epoch, anchor, length = (np.array(column) for column in zip(*old, strict=True)) if old else ([], [], [])
    size = len(old)
    positions = np.zeros((epochs - 1, 2))
    heard = PathBuffer(
        Track(np.arange(epochs - 1), positions, np.full(epochs - 1, 0.05)),
        np.array(epoch, dtype=np.int64),
        np.array(anchor, dtype=np.int64),
        np.array(length, dtype=float),
        np.full(size, 0.1),
        np.full(size, np.nan),
        np.ones(size, dtype=bool),
    )
    return SearchInput(
        layout=layout,
        confirmed=np.ones(layout.slots, dtype=bool),
        epoch=epochs - 1,
        paths=paths,
        heard=heard,
        gain_offset_db=np.full(anchors, np.nan),
        noise=noise,
        fresh_visibility=prior_visibility(layout, Visibility()),
        prune_nats=12.0,
        reduce=reduced,
    )


def heard_at(anchors, epochs: int, bias: float = 0.0) -> list[list[np.ndarray]]:
    """Exact paths of some anchors to RP, in so many epochs."""
    return [[path_lengths(np.array(a), np.zeros(2)) + bias for a in anchors] for _ in range(epochs)]


def found_at(place, matches: int, evidence: float) -> Candidates:
    """One candidate."""
    count, zero = np.array([matches]), np.zeros(1)
    return Candidates(
        np.array(place)[None], np.eye(2)[None], np.array([evidence]), count, count, zero, zero, zero
    )


def test_anchors_start_where_they_are():
    """The whole way from paths to hypotheses: two anchors, four walls, two epochs."""
    layout = Layout(2, 4)
    before = hypotheses_of(layout, WALLS)
    after = locate_anchors(before, given_paths(layout, heard_at([ANCHOR, OTHER], 2)), SEARCH)
    assert after.located[after.best].all()
    for k, anchor in enumerate((ANCHOR, OTHER)):
        np.testing.assert_allclose(after.mean[after.best, layout.anchor_xy(k)], anchor, atol=0.1)
    assert not before.located.any()


def test_a_common_clock_bias_is_found_with_the_place():
    """Lengths that are all 4 m too long put no anchor anywhere unless the clock is tried."""
    layout = Layout(1, 4)
    before = hypotheses_of(layout, WALLS, clock_std=5.0)
    after = locate_anchors(before, given_paths(layout, heard_at([ANCHOR], 3, bias=4.0)), SEARCH)
    assert after.located[after.best].all()
    np.testing.assert_allclose(after.mean[after.best, layout.anchor_xy(0)], ANCHOR, atol=0.5)
    assert after.mean[after.best, layout.bias(0)] == pytest.approx(4.0, abs=0.5)


def test_a_height_is_found_with_the_place():
    """An antenna 4 m up: distances in the plane put the anchor elsewhere, or nowhere."""
    layout = Layout(1, 4)
    before = hypotheses_of(layout, WALLS)
    slant = [[np.sqrt(own**2 + 16.0) for own in epoch] for epoch in heard_at([ANCHOR], 3)]
    search = replace(SEARCH, height_cells=8)
    after = locate_anchors(before, given_paths(layout, slant), search)
    assert after.located[after.best].all()
    np.testing.assert_allclose(after.mean[after.best, layout.anchor_xy(0)], ANCHOR, atol=0.3)
    height2, spread = after.mean[after.best, layout.height2(0)], after.covariance[after.best]
    assert abs(height2 - 16.0) < 3.0 * np.sqrt(spread[layout.height2(0), layout.height2(0)])


def test_what_is_not_heard_waits():
    """No path, no anchor, and the very same hypotheses."""
    layout = Layout(1, 4)
    before = hypotheses_of(layout, WALLS)
    assert locate_anchors(before, given_paths(layout, [[np.array([])]] * 2), SEARCH) is before


@pytest.mark.parametrize(
    ("matches", "evidence", "other", "starts"),
    [(3, 12.0, True, False), (3, 25.0, True, True), (4, 12.0, True, True), (3, 12.0, False, True)],
)
def test_three_features_may_be_chance(monkeypatch, matches, evidence, other, starts):
    """Once another anchor stands, a place of only three features needs evidence that chance has not."""
    layout = Layout(2, 4)
    before = hypotheses_of(layout, WALLS)
    before.located[:, 0] = other
    before.mean[:, layout.anchor_xy(0)] = OTHER
    monkeypatch.setattr(initialise, "find_places", lambda *_: found_at(ANCHOR, matches, evidence))
    after = locate_anchors(before, given_paths(layout, heard_at([OTHER, ANCHOR], 9)), SEARCH)
    assert bool(after.located[after.best, int(other)]) == starts


def test_a_place_has_to_beat_those_that_explain_too_little(monkeypatch):
    """A place of chance beside an unexplained better one is a coin thrown too early."""
    layout = Layout(1, 4)
    before = hypotheses_of(layout, WALLS)
    for ahead, starts in ((1.0, False), (3.0, True)):
        places = Candidates(
            np.array([ANCHOR, OTHER]),
            np.array([np.eye(2)] * 2),
            np.array([30.0 + ahead, 30.0]),
            np.array([5, 2]),
            np.array([5, 2]),
            np.zeros(2),
            np.zeros(2),
            np.zeros(2),
        )
        monkeypatch.setattr(initialise, "find_places", lambda *_, places=places: places)
        after = locate_anchors(before, given_paths(layout, heard_at([ANCHOR], 9)), SEARCH)
        assert bool(after.located.any()) == starts


def doubting(anchor: np.ndarray, epochs: int = 17) -> tuple[Hypotheses, SearchInput]:
    """An anchor that stands at OTHER, while all its paths come from ``anchor``."""
    layout = Layout(1, 4)
    before = hypotheses_of(layout, WALLS)
    before.located[:] = True
    before.mean[:, layout.anchor_xy(0)] = OTHER
    before.covariance[:, layout.anchor_xy(0), layout.anchor_xy(0)] = 0.01 * np.eye(2)
    before.visibility[:] = 0.0
    return before, given_paths(layout, heard_at([anchor], epochs))


def test_an_anchor_that_explains_nothing_is_searched_again():
    """A wrong start has to be undone: the right place becomes a hypothesis."""
    before, given = doubting(ANCHOR)
    after = locate_anchors(before, given, SEARCH)
    gap = np.linalg.norm(after.mean[:, given.layout.anchor_xy(0)] - ANCHOR, axis=1)
    assert gap.min() < 0.2


def test_an_anchor_is_not_taken_for_its_own_image():
    """Its images behind walls explain much, too, and open no rivals; what is explained is not searched."""
    image = mirrored(mirrored(OTHER, WALLS[0]), WALLS[1])
    before, given = doubting(image)
    after = locate_anchors(before, given, SEARCH)
    gap = np.linalg.norm(after.mean[:, given.layout.anchor_xy(0)] - image, axis=1)
    assert gap.min() > 2.0
    before, given = doubting(ANCHOR)
    explained = given.heard._replace(unassociated=np.zeros_like(given.heard.unassociated))
    assert locate_anchors(before, replace(given, heard=explained), SEARCH) is before


def searches_of(monkeypatch, hypotheses, given):
    """The anchors' limits of all searches of an epoch, in which nothing is found."""
    limits = []

    def nothing(scene, cells, limit, *_):
        limits.append((limit, scene, len(cells.bias_m)))
        return found_at(ANCHOR, 0, -99.0)

    monkeypatch.setattr(initialise, "find_places", nothing)
    locate_anchors(hypotheses, given, SEARCH)
    return limits


@pytest.mark.parametrize(("anchors", "groups"), [(1, 1), (2, 1), (16, 1), (4, 6), (16, 10)])
def test_searches_share_what_an_epoch_may_cost(monkeypatch, anchors, groups):
    """However many anchors and clocks, all searches together stay within the caps."""
    layout = Layout(anchors, 4)
    hypotheses = hypotheses_of(layout, WALLS, count=groups)
    for k in range(anchors):
        hypotheses.mean[:, layout.bias(k)] = 3.0 * np.arange(groups)
    made = searches_of(monkeypatch, hypotheses, given_paths(layout, heard_at([ANCHOR] * anchors, 1)))
    assert len(made) == anchors * groups
    assert sum(limit.pairs_in_all * 5 for limit, _, _ in made) <= SEARCH.max_pair_circles
    assert sum(limit.scored * 12 for limit, _, _ in made) <= SEARCH.max_scored_circles
    refined = [limit.refined_in_all * scene.circles.x.size for limit, scene, _ in made]
    assert sum(refined) <= max(SEARCH.max_refined_circles, 17 * len(made))


def test_anchors_of_unknown_clock_take_turns(monkeypatch):
    """Searches over clocks are dear: a few an epoch, and in time each anchor has one."""
    layout, seen = Layout(5, 4), set()
    hypotheses = hypotheses_of(layout, WALLS, clock_std=10.0)
    anchors = [ANCHOR + 0.5 * k for k in range(5)]
    for epochs in range(1, 4):
        made = searches_of(monkeypatch, hypotheses, given_paths(layout, heard_at(anchors, epochs)))
        assert len(made) == SEARCH.max_grid_searches
        assert all(cells > 50 for _, _, cells in made)
        seen |= {float(scene.seen.length_m[-1, 0]) for _, scene, _ in made}
    assert len(seen) == 5


def test_a_wide_clock_prior_makes_no_more_cells_than_allowed(monkeypatch):
    """A clock known to a kilometre must not make thousands of searches: the spacing grows."""
    layout = Layout(1, 4)
    hypotheses = hypotheses_of(layout, WALLS, clock_std=1_000.0)
    ((_, scene, cells),) = searches_of(monkeypatch, hypotheses, given_paths(layout, heard_at([ANCHOR], 1)))
    assert SEARCH.max_clocks - 2 <= cells <= SEARCH.max_clocks + 2
    assert scene.seen.length_variance_m2[0, 0] > 100.0  # and the lengths are as uncertain as it is wide


def seconds(anchors: int, walls: int, paths: int, clock_std: float = 0.0, hypotheses: int = 1) -> float:
    """CPU time of the first epochs' search, the shortest of three."""
    rng = np.random.default_rng(3)
    turn, offset = rng.uniform(0.0, 2.0 * np.pi, walls), rng.uniform(5.0, 60.0, walls)
    vrps = 2.0 * offset[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    layout, lengths = Layout(anchors, walls), []
    places = rng.uniform(-20.0, 20.0, (anchors, 2))
    for _ in range(3):
        own = [path_lengths(place, np.zeros(2), vrps) for place in places]
        clutter = max(paths - walls - 1, 0)
        lengths.append([np.concatenate([x, rng.uniform(1.0, 150.0, clutter)])[:paths] for x in own])
    noise = replace(NOISE, clutter_mean=3.0)
    before, given = hypotheses_of(layout, vrps, hypotheses, clock_std), given_paths(layout, lengths, noise)
    times = []
    for _ in range(3):
        begin = process_time()
        locate_anchors(before, given, SEARCH)
        times.append(process_time() - begin)
    return min(times)


def test_no_epoch_costs_more_than_a_bounded_multiple_of_an_ordinary_one():
    """Sixteen anchors, twenty walls, two hundred paths, unknown clocks: tens of ordinary searches."""
    ordinary = seconds(1, 4, 10)
    assert seconds(16, 20, 200) < 150.0 * ordinary
    assert seconds(16, 20, 200, hypotheses=60) < 150.0 * ordinary
    assert seconds(16, 20, 200, clock_std=10.0) < 150.0 * ordinary
    assert seconds(16, 4, 10) < 4.0 * 16.0 * ordinary
