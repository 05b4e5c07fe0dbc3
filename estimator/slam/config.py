"""Configuration of the Gaussian engine."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from estimator.errors import ConfigurationError

__all__ = ["GaussianConfig"]

_BLIND_SUPPORT, _BLIND_PATIENCE = 2, 3.0  # times as much, while no wall is known


@dataclass(frozen=True)
class GaussianConfig:
    """Models and limits of the Gaussian engine.

    Parameters
    ----------
    range_std_m : float
        Smallest standard deviation believed of a path length, metres: covers what the
        channel estimator's own figure leaves out (interference between paths).
    detection_probability : float
        Probability that a visible feature is measured.
    clutter_mean : float
        Mean number of measurements per anchor and epoch that no feature explains.
    region_m : float
        Largest path length; clutter is uniform on it, metres.
    gate_sigma : float
        Association gate, standard deviations.
    acceleration_variance : float
        Driving noise of the near-constant-velocity motion (39), m^2/s^4 per axis.
    velocity_std_m_s : float
        Standard deviation of the agent's unknown initial velocity, per axis.
    start_std_m : float
        Standard deviation of the agent's initial position about RP, per axis, metres; 0 where
        the start defines the frame.
    height2_mean_m2, height2_std_m2 : float
        Prior of the squared height difference of anchor and agent, square metres;
        (0, 0) for planar measurements.
    clock_bias_std_m : float
        Standard deviation of the anchors' unknown constant clock bias as a path length,
        metres; 0 if the clocks agree.
    clock_bias_common : bool
        Whether all anchors have the same bias.
    appear_probability, vanish_probability : float
        Per epoch, that an invisible feature becomes visible and the reverse.
    start_matches : int
        Paths that must agree before an anchor is located.
    start_window : int
        Epochs searched when one was not enough.
    start_attempts : int
        Rows (label hypotheses) kept of each anchor's start.
    restart_distance_m : float
        A located anchor may turn out to be elsewhere, at least this far away, metres.
    birth_window, birth_support : int
        Epochs looked back for a new wall, and unexplained paths on one line in them.
    birth_spacing_rad : float
        Spacing of the bearings that a new wall is tried on.
    birth_margin_db : float
        A path may start a wall only if it lost at most this more than a bounce at normal incidence, where
        a wall reflects least. Double bounces lose more: in a right corner of concrete, glass or plasterboard
        at least 1.3 dB more, but for the last metres before one of the walls is grazed.
    bounce_loss_db, bounce_loss_std_db : float
        Prior of the loss in a bounce at normal incidence: building materials have 5 to 13 dB. The walls seen
        by the first sweep soon tell it better.
    gain_offset_std_db : float
        Standard deviation of an unknown constant offset of each anchor's gains (an unknown EIRP), dB; 0
        if they are calibrated. The line of sight tells it.
    birth_trust : float
        Power, 0 to 1, of the likelihood that the track gives each bearing of a new wall: its
        errors are alike from epoch to epoch, where only lines of sight have told it.
    birth_log_prior : float
        Log prior odds of a new wall.
    virtual_stride : int
        Virtual anchors are searched for every so many epochs.
    virtual_window : int
        Epochs looked back for them; of a long way fewer suffice.
    virtual_evidence : float
        Log likelihood over "all is clutter" that a new virtual anchor needs.
    virtual_bearing_std_rad : float
        Its bearing must be known this well.
    virtual_alike_epochs : float
        For so many epochs the track's errors are alike: its first covariance allows for it.
    virtual_forgetting : float
        Share of the log weights of hypotheses that is forgotten in every epoch: on a straight
        track they tell no virtual anchor from its mirror image, yet walk at random.
    confirm_support : int
        Fresh detections before a wall counts as found.
    confirm_weight : float
        Posterior weight, within ``confirm_radius_m``, before a wall counts as found.
    confirm_radius_m : float
        Radius in which hypotheses on one wall are the same wall, metres.
    pending_epochs : int
        Epochs after which an unconfirmed wall is given up,
    pending_travel_m : float
        if the agent has also come this far, metres.
    pair_radius_m : float
        A path this close to a predicted double bounce starts no wall, metres.
    pair_std_m : float
        Double bounces predicted better than this inform the filter, metres.
    pair_gate_std_m : float
        Double bounces predicted worse than this are left out of the association: while the
        walls are uncertain they would take the paths of others, metres.
    prune_nats : float
        Hypotheses this far below the best are dropped.
    alike_sigma : float
        Hypotheses closer than this many standard deviations in every coordinate become one,
    unlikely_sigma : float
        or farther apart, up to this, if one of them is so unlikely that it hardly adds to the variance. Not
        in the first epochs, while the labels are open.
    max_hypotheses : int
        Hypotheses kept.
    """

    range_std_m: float = 0.02
    detection_probability: float = 0.95
    clutter_mean: float = 3.0
    region_m: float = 180.0
    gate_sigma: float = 4.0
    acceleration_variance: float = 0.0278
    velocity_std_m_s: float = 1.0
    start_std_m: float = 0.0
    height2_mean_m2: float = 1.0
    height2_std_m2: float = 1.0
    clock_bias_std_m: float = 0.0
    clock_bias_common: bool = False
    appear_probability: float = 0.01
    vanish_probability: float = 0.01
    start_matches: int = 4
    start_window: int = 16
    start_attempts: int = 20
    restart_distance_m: float = 2.0
    birth_window: int = 18
    birth_support: int = 10
    birth_spacing_rad: float = float(np.deg2rad(1.5))
    birth_margin_db: float = 1.5
    bounce_loss_db: float = 9.0
    bounce_loss_std_db: float = 3.0
    gain_offset_std_db: float = 0.0
    birth_trust: float = 1.0
    birth_log_prior: float = -5.0
    virtual_stride: int = 5
    virtual_window: int = 150
    virtual_evidence: float = 20.0
    virtual_bearing_std_rad: float = 0.2
    virtual_alike_epochs: float = 8.0
    virtual_forgetting: float = 0.05
    confirm_support: int = 5
    confirm_weight: float = 0.98
    confirm_radius_m: float = 3.0
    pending_epochs: int = 40
    pending_travel_m: float = 15.0
    pair_radius_m: float = 0.6
    pair_std_m: float = 0.5
    pair_gate_std_m: float = 0.4
    prune_nats: float = 12.0
    alike_sigma: float = 0.7
    unlikely_sigma: float = 2.0
    max_hypotheses: int = 100

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not np.isfinite(value):
                raise ConfigurationError(
                    f"GaussianConfig.{entry.name}: expected a finite number, got {value!r}"
                )
            signed = entry.name in ("birth_log_prior",)
            zero = entry.name in (
                "height2_mean_m2",
                "height2_std_m2",
                "clutter_mean",
                "clock_bias_std_m",
                "start_std_m",
                "clock_bias_common",
                "gain_offset_std_db",
                "virtual_forgetting",
            )
            if not signed and (value < 0 or (value == 0 and not zero)):
                raise ConfigurationError(
                    f"GaussianConfig.{entry.name}: expected a positive number, got {value!r}"
                )
        for name in ("detection_probability", "appear_probability", "vanish_probability", "confirm_weight"):
            if not getattr(self, name) < 1.0:
                raise ConfigurationError(
                    f"GaussianConfig.{name}: expected less than 1, got {getattr(self, name)}"
                )

    def widened(self) -> GaussianConfig:
        """The same models with room for more hypotheses."""
        return replace(
            self,
            start_attempts=2 * self.start_attempts,
            max_hypotheses=2 * self.max_hypotheses,
            unlikely_sigma=self.alike_sigma,
        )

    def blind(self) -> GaussianConfig:
        """The same models, in more doubt: while no wall is known, the first one decides on all others."""
        return replace(
            self,
            confirm_support=_BLIND_SUPPORT * self.confirm_support,
            prune_nats=_BLIND_PATIENCE * self.prune_nats,
        )

    @property
    def clutter_density(self) -> float:
        """Clutter intensity, per metre; at least one in a hundred epochs."""
        return max(self.clutter_mean, 0.01) / self.region_m
