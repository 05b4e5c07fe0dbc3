"""What is believed of measurements: noise, misses, clutter, unknown heights and gains."""

from __future__ import annotations

from dataclasses import dataclass

from estimator.slam.models.settings import Settings, not_negative, positive, probability

__all__ = ["MeasurementNoise"]


@dataclass(frozen=True)
class MeasurementNoise(Settings):
    """The measurement model that all engines and the smoother share.

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
    height2_mean_m2, height2_std_m2 : float
        Prior of the squared height difference of anchor and agent, square metres;
        (0, 0) for planar measurements.
    gain_offset_std_db : float
        Standard deviation of an unknown constant offset of each anchor's gains (an unknown EIRP), dB; 0
        if they are calibrated. The line of sight tells it.
    most_paths : int
        An anchor with more paths in an epoch counts as not heard: no channel has as many, every feature would
        find a path among them, and every wall could be found.
    """

    range_std_m: float = positive(0.02)
    detection_probability: float = probability(0.95)
    clutter_mean: float = not_negative(3.0)
    region_m: float = positive(180.0)
    height2_mean_m2: float = not_negative(1.0)
    height2_std_m2: float = not_negative(1.0)
    gain_offset_std_db: float = not_negative(0.0)
    most_paths: int = positive(200)

    @property
    def clutter_density(self) -> float:
        """Clutter intensity, per metre; at least one in a hundred epochs."""
        return max(self.clutter_mean, 0.01) / self.region_m
