"""Configuration of the anchor search: when, how wide, how sure, and how much at most."""

from __future__ import annotations

from dataclasses import dataclass, replace

from estimator.slam.models.settings import Settings, any_number, not_negative, positive, probability

__all__ = ["AnchorSearchConfig"]


@dataclass(frozen=True)
class AnchorSearchConfig(Settings):
    """Decisions and limits of the anchor search.

    Parameters
    ----------
    start_window : int
        Epochs that are remembered for the search.
    search_stride : int
        Epochs between searches, and between the remembered epochs that a search uses: paths of
        neighbouring epochs tell nearly the same. Before this many epochs every epoch is searched and used.
    recheck_stride : int
        Epochs between checks whether a located anchor should be searched again.
    doubt_sigma, doubt_paths : float
        A located anchor is searched again if its unassociated paths exceed the expected clutter by this many
        standard deviations (of a Poisson number) plus this many paths an epoch.
    start_matches : int
        Features (line of sight, single bounces) that paths must explain before an anchor is located.
    start_fresh : int
        Features that a path of the present epoch must explain for sure.
    fresh_probability : float
        Association probability from which a path explains a feature for sure.
    start_patience : int
        Epochs that pass before the first anchor starts from places that explain enough though others are as
        likely.
    start_attempts : int
        Places kept of each search.
    restart_distance_m : float
        A located anchor may turn out to be elsewhere, at least this far away, metres.
    place_margin_nats : float
        Log evidence by which a place must beat those that explain too little, and no place at all.
    late_evidence_nats : float
        Log evidence that a place of fewer than ``start_matches`` features needs once another anchor stands:
        chance agreements reach 10 to 15.
    rival_log_prior : float
        Log prior odds that a located anchor is elsewhere after all.
    behind_wall_log_prior : float
        Log prior odds of standing behind a known wall, each: anchors are rarely in other rooms.
    anchor_prior_std_m : float
        Standard deviation per axis of an anchor before the present epoch's paths enter the joint Gaussian,
        metres: wide, for the place itself came from these paths.
    clock_step_m : float
        Spacing of the clock biases that are tried, and the standard deviation below which one is enough,
        metres.
    clock_sigma : float
        Clock biases are tried up to this many standard deviations.
    max_clocks : int
        Clock biases tried; where more are needed the spacing grows.
    max_clock_groups : int
        Groups of hypotheses that agree on an anchor's clock bias, each of which is searched for.
    height_cells : int
        Heights above or below the agent that are tried; 0 compares path lengths with distances
        in the plane, right where these are many times the height. Each costs as much as a clock bias.
    height_min_m, height_max_m : float
        The least and the largest of these, metres; the others are spaced geometrically.
    height_scale_m : float
        Mean of the exponential prior of the height, metres: antennas on ceilings and walls.
    height_widths : float
        A squared height that a search over few epochs found is known to so many standard deviations of its
        cell: cells beside it explain the paths nearly as well, and the place moves with the height.
    survey_track : int
        Places of the whole track whose paths are kept for surveys (:mod:`estimator.slam.anchors.survey`):
        where there are more, every other one is dropped.
    survey_step_m : float
        These are this far apart at least, metres.
    survey_epochs : int
        Places of one survey, spread evenly over those that heard the anchor.
    survey_track_std_m : float
        Anchors are surveyed while the agent's standard deviation is below this, metres.
    survey_patience : int
        Epochs after a sweep in which anchors wait for their survey, however little is known of the track.
    survey_least : int
        Places at which an anchor must have been heard.
    survey_stride, survey_recheck_stride : int
        Epochs between surveys of an anchor that is not located, and of one that is.
    survey_near_share : float
        The grid reaches as far as the shortest path of the epoch at this quantile of them: no anchor is
        farther off than a path of its is long, but for clutter.
    survey_points, survey_spacing_m : int, float
        Points of the grid, and the spacing in metres to which it is made finer round the best of them.
    survey_height_stride : int
        Of the heights tried, the grid takes every so many-th.
    survey_grid_epochs, survey_seeds : int
        Epochs that weigh the grid, and places that are refined.
    survey_share_los, survey_share_wall, survey_share_pair : float
        Shares of the paths that are lines of sight, and come over one and over two known walls; the rest is
        clutter.
    survey_halvings : int
        How many paths nothing known explains is not known: these shares, or they halved up to so often, are
        equally likely.
    survey_nats : float
        Log evidence by which a place must beat all others, and none at all: a wrong wall explains path after
        path, so that what neighbouring places tell is not independent.
    survey_apart_m : float
        Places farther apart than this are different, metres.
    survey_beyond : float
        A wall is taken to reflect beyond the stretch on which it was seen to, this many times as far as the
        agent was from it: rooms are about as long as they are wide, and a path that would have come over a
        wall farther on comes over a neighbour of it that is not known yet.
    survey_start_std_m : float
        Standard deviation with which a surveyed place enters the joint Gaussian beside what its paths and the
        track make it, metres: what walls and wrong labels put all its paths off by.
    search_gate_sigma : float
        Standard deviations within which a path may explain a circle.
    search_visibility_los, search_visibility_wall, search_visibility_pair : float
        Prior probability that a path of 0, 1, 2 bounces is there.
    los_loss_std_db : float
        Standard deviation of the loss of a line of sight beyond free space, dB.
    loss_range_db : float
        Losses of other paths are uniform over this range, dB.
    seed_radius_m, place_radius_m : float
        Seeds, and places, closer than this to a better one are the same, metres.
    wall_pair_margin_m : float
        Walls may be misplaced by so much when double bounces are ranked, metres.
    touch_m2 : float
        Circles that miss each other still touch, if the squared half chord is no less than minus this.
    max_wall_pairs : int
        Ordered pairs of walls whose double bounces may explain paths, those of the shortest paths first.
    max_gated : int
        Paths of an epoch that may explain one circle, the nearest first.
    max_pairs : int
        Pairs of circles that are intersected for one clock bias (40 paths and four walls).
    max_pair_circles : int
        The same of all clock biases and searches of an epoch, times the circles of up to one bounce that each
        intersection is compared with.
    min_paired_circles, min_paired_paths : int
        Circles and paths of which pairs are made, at least, where not all pairs are.
    max_scored : int
        Intersections of one clock bias that are scored with double bounces.
    max_scored_circles : int
        The same of all searches of an epoch, times the double bounces.
    max_refined, max_refined_in_all : int
        Places that are refined and weighed, of one clock bias and of all searches of an epoch.
    max_refined_circles : int
        These places times the circles of all epochs that each is compared with.
    max_grid_searches : int
        Searches over clock biases an epoch; other anchors of unknown clock wait for a later one.
    labelling_gap_m : float
        Lengths this close may be exchanged by the walls' errors, metres.
    labelling_slack : float
        Labellings this much worse than the best of a place are kept: a path left out counts 1, a gap half its
        square in units of ``labelling_gap_m``.
    max_labellings : int
        Labellings kept of each place.
    max_labelling_nodes, max_labelling_nodes_in_all : int
        Partial labellings looked at for one place, and for all places of an epoch's searches.
    max_labelled_features : int
        Hypotheses times labellings times features that are weighed when anchors are located, in all of an
        epoch.
    max_branch_floats : int
        Covariance entries of the hypotheses made when anchors are located, in all of an epoch (8 byte each).
    min_branches : int
        Hypotheses that may be made of each anchor whatever their size.
    """

    start_window: int = positive(16)
    search_stride: int = positive(4)
    recheck_stride: int = positive(8)
    doubt_sigma: float = positive(4.0)
    doubt_paths: float = positive(0.5)
    start_matches: int = positive(4)
    start_fresh: int = positive(2)
    fresh_probability: float = probability(0.9)
    start_patience: int = not_negative(1)
    start_attempts: int = positive(20)
    restart_distance_m: float = positive(2.0)
    place_margin_nats: float = positive(2.0)
    late_evidence_nats: float = any_number(20.0)
    rival_log_prior: float = any_number(-3.0)
    behind_wall_log_prior: float = any_number(-2.5)
    anchor_prior_std_m: float = positive(10.0)
    clock_step_m: float = positive(1.0)
    clock_sigma: float = positive(3.0)
    max_clocks: int = positive(128)
    max_clock_groups: int = positive(10)
    height_cells: int = not_negative(8)
    height_min_m: float = positive(0.5)
    height_max_m: float = positive(6.5)
    height_scale_m: float = positive(2.5)
    height_widths: float = positive(5.0)
    survey_track: int = positive(120)
    survey_step_m: float = positive(0.4)
    survey_epochs: int = positive(40)
    survey_track_std_m: float = positive(0.25)
    survey_patience: int = positive(12)
    survey_least: int = positive(12)
    survey_stride: int = positive(4)
    survey_recheck_stride: int = positive(32)
    survey_near_share: float = probability(0.25)
    survey_points: int = positive(1600)
    survey_spacing_m: float = positive(0.4)
    survey_height_stride: int = positive(2)
    survey_grid_epochs: int = positive(16)
    survey_seeds: int = positive(16)
    survey_share_los: float = probability(0.3)
    survey_share_wall: float = probability(0.4)
    survey_share_pair: float = probability(0.15)
    survey_halvings: int = not_negative(3)
    survey_nats: float = positive(40.0)
    survey_apart_m: float = positive(0.3)
    survey_beyond: float = not_negative(1.0)
    survey_start_std_m: float = positive(0.2)
    search_gate_sigma: float = positive(4.0)
    search_visibility_los: float = probability(0.9)
    search_visibility_wall: float = probability(0.6)
    search_visibility_pair: float = probability(0.2)
    los_loss_std_db: float = positive(2.5)
    loss_range_db: float = positive(40.0)
    seed_radius_m: float = positive(0.7)
    place_radius_m: float = positive(0.5)
    wall_pair_margin_m: float = positive(1.0)
    touch_m2: float = positive(1.0)
    max_wall_pairs: int = positive(64)
    max_gated: int = positive(8)
    max_pairs: int = positive(20_000)
    max_pair_circles: int = positive(400_000)
    min_paired_circles: int = positive(5)
    min_paired_paths: int = positive(12)
    max_scored: int = positive(1_000)
    max_scored_circles: int = positive(80_000)
    max_refined: int = positive(60)
    max_refined_in_all: int = positive(600)
    max_refined_circles: int = positive(24_000)
    max_grid_searches: int = positive(2)
    labelling_gap_m: float = positive(3.0)
    labelling_slack: float = positive(1.2)
    max_labellings: int = positive(24)
    max_labelling_nodes: int = positive(20_000)
    max_labelling_nodes_in_all: int = positive(400_000)
    max_labelled_features: int = positive(200_000)
    max_branch_floats: int = positive(2_000_000)
    min_branches: int = positive(4)

    def widened(self) -> AnchorSearchConfig:
        """The same with twice the places kept of each search."""
        return replace(self, start_attempts=2 * self.start_attempts)
