"""Anchors enter the joint state: places are searched, weighed against waiting, and hypotheses branch.

The hypotheses that lack an anchor branch: one for each candidate place, weighted by its evidence, and one
that goes on without it. A located anchor of which too much goes unexplained is searched again; a place that
explains the recent epochs better becomes a rival hypothesis, and the epochs to come decide. While no anchor
at all is located the agent's motion is not known either, and waiting only loses what the start tells: after
the first epoch the anchor with most paths then starts from every place that explains enough, even if one
that explains too little is as likely.

The caps of :class:`AnchorSearchConfig` are shared by the anchors that are searched in an epoch, so that its
cost does not grow with their number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.branching import branch_hypotheses
from estimator.slam.anchors.cells import Cells, cells_of, limits_of
from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.joint_update import BranchLimits, PlacePaths
from estimator.slam.anchors.labellings import labellings
from estimator.slam.anchors.likelihood import walls_between
from estimator.slam.anchors.observations import NoiseModel, observations_of
from estimator.slam.anchors.schedule import is_doubtful, is_early
from estimator.slam.anchors.search import Candidates, Scene, evidence_at, find_places, scene_of
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.models.state_vector import Layout

__all__ = ["SearchInput", "locate_anchors"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_KNOWN_M2 = 1e-12  # variance of an anchor known from the start, left by rounding where hypotheses were merged


class PathArrays(Protocol):
    """Paths (K, M) of an epoch: :class:`estimator.slam.models.epoch_paths.EpochPaths`."""

    @property
    def length_m(self) -> Array:
        """Path lengths, metres."""

    @property
    def std_m(self) -> Array:
        """Their standard deviations, metres."""

    @property
    def excess_loss_db(self) -> Array:
        """Losses beyond free space, dB; NaN if unknown."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which entries are measurements."""


@dataclass(frozen=True, eq=False)
class SearchInput:
    """What an engine tells the anchor search of itself, beside its hypotheses.

    Shapes: K anchors, L wall slots, F features of an anchor.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    confirmed : ndarray of bool, shape (L,)
        Slots whose wall counts as found.
    epoch : int
        Number of the present epoch.
    paths : PathArrays, shape (K, M)
        Its paths.
    heard : PathBuffer
        The epochs before it: track and paths.
    gain_offset_db : ndarray, shape (K,)
        To be taken off all losses of each anchor, dB; NaN where it is not known.
    noise : NoiseModel
        Measurement noise.
    fresh_visibility : ndarray, shape (F,)
        Prior visibility of the features of an anchor just located.
    prune_nats : float
        Hypotheses and places this far below the best are dropped.
    reduce : callable
        The engine's mixture reduction: hypotheses normalised, likeliest first, capped.
    """

    layout: Layout
    confirmed: NDArray[np.bool_]
    epoch: int
    paths: PathArrays
    heard: PathBuffer
    gain_offset_db: Array
    noise: NoiseModel
    fresh_visibility: Array
    prune_nats: float
    reduce: Callable[[Hypotheses], Hypotheses]


@dataclass(frozen=True, eq=False)
class _Search:
    """One anchor searched from hypotheses that agree on its clock.

    Parameters
    ----------
    anchor : int
        The anchor.
    members : ndarray of int64
        The hypotheses.
    scene : Scene
        Circles and paths, seen from the likeliest.
    slots : ndarray of int64
        Wall slots of the scene's walls.
    found : Candidates
        Places.
    enough : ndarray of bool, shape (S,)
        Which of them explain enough.
    rival : bool
        Whether the anchor is located already, elsewhere.
    """

    anchor: int
    members: Index
    scene: Scene
    slots: Index
    found: Candidates
    enough: NDArray[np.bool_]
    rival: bool


@dataclass
class _Budget:
    """How many anchors share the caps of an epoch, and the searches over clock biases that are left."""

    anchors: int
    grids: int
    searched: dict[tuple[int, int, int], _Search | None] = field(default_factory=dict)


def locate_anchors(hypotheses: Hypotheses, given: SearchInput, config: AnchorSearchConfig) -> Hypotheses:
    """Start the anchors that the best hypothesis has not located, where the paths allow it.

    Parameters
    ----------
    hypotheses : Hypotheses
        After the update by the epoch's paths.
    given : SearchInput
        What else the engine knows.
    config : AnchorSearchConfig
        Decisions and limits.

    Returns
    -------
    Hypotheses
        The same object if no anchor started.
    """
    early = is_early(len(given.heard.track.epoch), config)
    due = [
        k
        for k in range(given.layout.anchors)
        if (early or given.epoch % config.search_stride == 0)
        and (not hypotheses.located[:, k].all() or _doubtful(hypotheses, given, k, config))
    ]
    budget = _Budget(max(len(due), 1), config.max_grid_searches)
    for k in _in_turn(due, hypotheses, given, config):
        waiting = np.flatnonzero(~hypotheses.located[:, k])
        if waiting.size:
            groups = _clock_groups(hypotheses, waiting, given.layout.bias(k), config)
        elif _doubtful(hypotheses, given, k, config):
            groups = [np.array([hypotheses.best])]
        else:
            continue
        searches = [_searched(hypotheses, given, k, group, len(groups), budget, config) for group in groups]
        hypotheses = _branched(hypotheses, searches, given, config.place_margin_nats, budget, config)
    if early and given.heard.epochs >= config.start_patience and not hypotheses.located.any():
        everyone = np.arange(hypotheses.number)
        for k in np.argsort(-np.sum(given.paths.valid, axis=1), kind="stable").tolist():
            search = _searched(hypotheses, given, k, everyone, 1, budget, config)
            hypotheses = _branched(hypotheses, [search], given, -np.inf, budget, config)
            if hypotheses.located.any():
                break
    return hypotheses


def _in_turn(
    due: list[int], hypotheses: Hypotheses, given: SearchInput, config: AnchorSearchConfig
) -> list[int]:
    """The anchors that are due; those of unknown clock, of which only some can be searched, take turns."""
    best, bias = hypotheses.best, np.array([given.layout.bias(k) for k in due], dtype=np.int64)
    unknown = hypotheses.covariance[best, bias, bias] >= config.clock_step_m**2
    if np.count_nonzero(unknown) <= config.max_grid_searches:
        return due
    turn = given.epoch * config.max_grid_searches % len(due)
    return due[turn:] + due[:turn]


def _doubtful(hypotheses: Hypotheses, given: SearchInput, k: int, config: AnchorSearchConfig) -> bool:
    """Whether a located anchor should be searched again."""
    before = len(given.heard.track.epoch)
    if given.epoch % config.recheck_stride or is_early(before, config):
        return False
    best, place = hypotheses.best, given.layout.anchor_xy(k)
    if np.trace(hypotheses.covariance[best, place, place]) < _KNOWN_M2:
        return False
    count = int(np.count_nonzero(given.heard.unassociated & (given.heard.anchor == k)))
    visible = hypotheses.visibility[best, k, : 1 + given.layout.slots] > 0.5
    visible = visible & np.append(True, hypotheses.present[best])
    return is_doubtful(count, before, given.noise.clutter_mean, int(visible.sum()), config)


def _clock_groups(
    hypotheses: Hypotheses, waiting: Index, bias: int, config: AnchorSearchConfig
) -> list[Index]:
    """The hypotheses that wait for an anchor, likeliest first, in groups that agree on its clock bias.

    Anchors with a common clock: where the first one stands tells the bias, and each of its places another
    one.
    """
    groups: list[Index] = []
    left = waiting[np.argsort(-hypotheses.log_weight[waiting], kind="stable")]
    while left.size and len(groups) < config.max_clock_groups:
        own = hypotheses.mean[left, bias]
        near = np.abs(own - own[0]) < config.clock_step_m
        groups.append(left[near])
        left = left[~near]
    return groups


def _searched(
    hypotheses: Hypotheses,
    given: SearchInput,
    k: int,
    members: Index,
    groups: int,
    budget: _Budget,
    config: AnchorSearchConfig,
) -> _Search | None:
    """Places of anchor ``k``, seen from the likeliest of ``members``; None if it has to wait for its turn."""
    layout = given.layout
    first = int(members[np.argmax(hypotheses.log_weight[members])])
    key = id(hypotheses), k, first
    if key in budget.searched:
        known = budget.searched[key]
        return known and _Search(k, members, *list(vars(known).values())[2:])
    mean, covariance = hypotheses.mean[first], hypotheses.covariance[first]
    b = layout.bias(k)
    std = float(np.sqrt(covariance[b, b]))
    cells, extra = cells_of(float(mean[b]), std, config)
    share = budget.anchors * groups
    if std >= config.clock_step_m:
        if budget.grids == 0:
            return None
        share = min(budget.anchors, config.max_grid_searches) * groups
        budget.grids -= 1
    slots = np.flatnonzero(hypotheses.present[first] & given.confirmed)
    vrp = mean[layout.walls].reshape(-1, 2)[slots] if slots.size else np.empty((0, 2))
    spread = [covariance[layout.wall(s), layout.wall(s)] for s in slots.tolist()]
    n = int(given.paths.valid[k].sum())
    now = given.paths.length_m[k, :n], given.paths.std_m[k, :n], given.paths.excess_loss_db[k, :n]
    variance, gain = 0.5 * float(np.trace(covariance[:2, :2])), float(given.gain_offset_db[k])
    seen = observations_of(k, mean[:2], variance, now, given.heard, gain, given.noise, config)
    scene = scene_of(seen, vrp, np.array(spread).reshape(-1, 2, 2), given.noise, config, extra)
    limits = limits_of(share, len(cells.bias_m), scene.circles, config)
    found = find_places(scene, cells, limits, given.prune_nats, config)
    enough = (found.matches >= config.start_matches - (len(seen.paths) > 1)) & (
        found.fresh >= config.start_fresh
    )
    located = bool(hypotheses.located[first, k])
    if located:
        here = hypotheses.mean[hypotheses.best, layout.anchor_xy(k)]
        enough &= _rivals(here, cells, found, scene, config)
    elif hypotheses.located[first].any():
        enough &= (found.matches >= config.start_matches) | (found.log_evidence > config.late_evidence_nats)
    result = _Search(k, members, scene, slots, found, enough, located)
    budget.searched[key] = result
    return result


def _rivals(
    here: Array, cells: Cells, found: Candidates, scene: Scene, config: AnchorSearchConfig
) -> NDArray[np.bool_]:
    """Which places are elsewhere and explain more than where the anchor is; not its images behind walls."""
    rival = np.hypot(*(found.mean_m - here).T) > config.restart_distance_m
    behind = walls_between(here[0], here[1], scene.vrp_m)
    rival &= np.array([walls_between(x, y, scene.vrp_m) <= behind for x, y in found.mean_m], dtype=bool)
    tried = zip(*cells, strict=True)
    known = max(evidence_at(scene, here[None], *map(float, cell))[0] + prior for *cell, prior in tried)
    return np.asarray(rival & (found.log_evidence > known))


def _branched(
    hypotheses: Hypotheses,
    searches: list[_Search | None],
    given: SearchInput,
    margin: float,
    budget: _Budget,
    config: AnchorSearchConfig,
) -> Hypotheses:
    """With a hypothesis for each place that explains enough; as they are if none does.

    The best of these places has to beat those that explain too little by ``margin`` nats, from whichever
    hypotheses these are seen: hypotheses whose anchor has to wait gain nothing by its paths, and would lose
    to worse ones that have not.
    """
    made = [each for each in searches if each is not None]
    weight = [float(hypotheses.log_weight[each.members].max()) for each in made]
    best, rest = -np.inf, max(weight, default=0.0)
    for own, each in zip(weight, made, strict=True):
        best = max(best, own + float(each.found.log_evidence[each.enough].max(initial=-np.inf)))
        rest = max(rest, own + float(each.found.log_evidence[~each.enough].max(initial=-np.inf)))
    if not best > rest + margin:
        return hypotheses
    chosen = [each for each in made if each.enough.any()]
    share = budget.anchors * len(chosen)
    limits = BranchLimits(
        given.prune_nats,
        config.max_labelled_features // (share * (1 + given.layout.slots)),
        max(config.max_branch_floats // (share * given.layout.size**2), config.min_branches),
    )
    grown = hypotheses
    for each in chosen:
        grown = grown.joined(_branches(hypotheses, each, given, limits, share, config))
    return given.reduce(grown)


def _branches(
    hypotheses: Hypotheses,
    search: _Search,
    given: SearchInput,
    limits: BranchLimits,
    share: int,
    config: AnchorSearchConfig,
) -> Hypotheses:
    """The hypotheses that one of ``share`` searches makes."""
    k, noise = search.anchor, given.noise
    found = search.found.take(np.flatnonzero(search.enough))
    valid = given.paths.valid[k]
    length = given.paths.length_m[k][valid]
    nodes = min(config.max_labelling_nodes, config.max_labelling_nodes_in_all // (share * len(found)))
    candidate, label = labellings(found, search.scene, length, nodes, config)
    places = PlacePaths(
        found.mean_m,
        found.bias_m,
        found.height2_m2,
        found.height2_std_m2**2 if config.height_cells else np.full(len(found), -1.0),
        np.full(len(found), config.rival_log_prior) if search.rival else found.log_evidence,
        candidate,
        np.searchsorted(candidate, np.arange(len(found) + 1)),
        label,
        np.concatenate([[-1], search.slots]),
        length,
        np.maximum(given.paths.std_m[k][valid], noise.range_std_m) ** 2,
        float(noise.clutter_density),
    )
    return branch_hypotheses(
        hypotheses,
        search.members,
        given.layout,
        k,
        places,
        config.anchor_prior_std_m,
        (noise.height2_mean_m2, noise.height2_std_m2),
        given.fresh_visibility,
        limits,
    )
