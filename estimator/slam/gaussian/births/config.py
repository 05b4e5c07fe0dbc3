"""Configuration of births."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.slam.models.settings import Settings, any_number, not_negative, positive

__all__ = ["Births", "VirtualBirths"]


@dataclass(frozen=True)
class Births(Settings):
    """When and where walls are born.

    Parameters
    ----------
    birth_window, birth_support : int
        Epochs looked back for a new wall, and unassociated paths on one line in them.
    birth_spacing_rad : float
        Spacing of the bearings that a new wall is tried on.
    birth_trust : float
        Power, 0 to 1, of the likelihood that the track gives each bearing of a new wall: its
        errors are alike from epoch to epoch, where only lines of sight have told it.
    birth_log_prior : float
        Log prior odds of a new wall.
    settled_std_m : float
        Standard deviation of an anchor's place from which walls may be born: of a misplaced one, false
        walls are.
    line_sigma : float
        A path lies on a line within so many standard deviations.
    line_epochs : int
        Epochs that two paths must be apart to give the slope of a line.
    most_line_paths : int
        Latest paths of an anchor that lines are sought through, the best supported first. Bounds time.
    most_parts : int
        The spacing of bearings is divided into at most so many parts near the anchor.
    extent_error_m : float
        Where a wall's observed extent ends is known no better, metres.
    wild_sigma : float
        An epoch tells nothing from so many standard deviations on: the agent was thought to be elsewhere.
    blocked_legs : int
        Legs of detected paths that go through a wall if it is not there.
    most_legs : int
        Latest legs that are looked at. Bounds time.
    least_vrp_m : float
        Walls nearer to the start than half this are not born of paths, metres.
    reach_std_m, floor_std_m : float
        Standard deviations given to a new wall: along the line to its virtual anchor, and in all
        directions, metres.
    overlap : float
        Standard deviation of each Gaussian of a bank across the bearing, in spacings: they overlap.
    """

    birth_window: int = positive(18)
    birth_support: int = positive(10)
    birth_spacing_rad: float = positive(float(np.deg2rad(1.5)))
    birth_trust: float = positive(1.0)
    birth_log_prior: float = any_number(-5.0)
    settled_std_m: float = positive(1.5)
    line_sigma: float = positive(3.0)
    line_epochs: int = positive(3)
    most_line_paths: int = positive(32)
    most_parts: int = positive(12)
    extent_error_m: float = not_negative(1.0)
    wild_sigma: float = positive(4.0)
    blocked_legs: int = positive(2)
    most_legs: int = positive(400)
    least_vrp_m: float = positive(1.0)
    reach_std_m: float = positive(0.3)
    floor_std_m: float = positive(0.05)
    overlap: float = positive(0.7)


@dataclass(frozen=True)
class VirtualBirths(Settings):
    """When and where virtual anchors are born.

    Parameters
    ----------
    virtual_stride : int
        Virtual anchors are searched for every so many epochs.
    virtual_window : int
        Epochs looked back for them; of a long way fewer suffice.
    virtual_evidence : float
        Log likelihood over "all is clutter" that a new virtual anchor needs.
    virtual_bearing_std_rad : float
        Its bearing must be known this well,
    narrower : float
        or better by this factor where there is one mode alone.
    virtual_alike_epochs : float
        For so many epochs the track's errors are alike: its first covariance allows for it.
    virtual_forgetting : float
        Share of the log weights of hypotheses that is forgotten in every epoch: on a straight
        track they tell no virtual anchor from its mirror image, yet walk at random.
    least_epochs : int
        Epochs of a window, however far the agent went in them.
    travel_sigma : float
        How far the agent goes in a window, range standard deviations.
    coarsest_rad : float
        Largest spacing of bearings.
    mode_nats : float
        Places less likely than the best by more are not kept,
    most_modes : int
        nor more than so many.
    aside : float
        Where the halves of a Gaussian that is too wide stand, in its standard deviations.
    same_wall_m : float
        Virtual anchors that imply walls closer than this are told as one wall (the similarity threshold
        of the paper, V-E), metres.
    most_recent_paths : int
        Latest unassociated paths of an anchor that are looked at,
    most_seeds : int
        and latest path lengths that candidates are made of. They bound time and memory.
    """

    virtual_stride: int = positive(5)
    virtual_window: int = positive(150)
    virtual_evidence: float = positive(20.0)
    virtual_bearing_std_rad: float = positive(0.2)
    narrower: float = positive(0.6)
    virtual_alike_epochs: float = positive(8.0)
    virtual_forgetting: float = not_negative(0.05)
    least_epochs: int = positive(12)
    travel_sigma: float = positive(40.0)
    coarsest_rad: float = positive(0.1)
    mode_nats: float = positive(10.0)
    most_modes: int = positive(4)
    aside: float = positive(0.8)
    same_wall_m: float = positive(1.0)
    most_recent_paths: int = positive(600)
    most_seeds: int = positive(24)
