"""Synthetic measurements from geometry alone (Section V-E of the paper).

The walls of a plan give the visible specular paths; each is detected with a
probability, its length gets Gaussian noise, and Poisson clutter is added. The walls
seen at the start get the paper's active-sensing variances. The result is the same
type as the ray-traced chain's, so every engine runs on either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import mirror_in_wall, segments_cross, vrp_of_line
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.specular import SpecularPaths, specular_paths
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = [
    "SimulationConfig",
    "measure_scene",
    "simulate_epochs",
    "simulate_sweep",
    "simulate_walls",
    "walls_in_view",
]


Array = NDArray[np.float64]


@dataclass(frozen=True)
class SimulationConfig:
    """Measurement model of the simulation; the defaults are the paper's (Section V-E).

    Parameters
    ----------
    range_std_m : float
        Standard deviation of a path length, metres.
    detection_probability : float
        Probability that a visible path is measured.
    clutter_mean : float
        Mean of the Poisson number of clutter measurements per anchor and epoch.
    region_m : float
        Paths beyond are not heard; clutter is uniform on (0, region), metres.
    order : int
        Largest number of bounces.
    step_s : float
        Time between epochs, seconds.
    azimuth_std_rad : float
        Standard deviation of directions of arrival, radians; 0: none are measured.
    clock_bias_m : float
        Constant clock bias of all anchors as a path length, metres.
    clock_free_std_m : float
        Standard deviation of a clock bias common to all anchors that is new in every epoch, metres: what is
        left are time differences of arrival. None brings a path below zero.
    sweep_every : int
        Epochs between beam sweeps after the one at the start; 0: no more sweeps.
    sweep_variance : float
        Variance per axis of a wall seen by a later sweep over its squared distance: the
        paper's four variances at the start are 8.9e-4 of it on average.
    heading_held : bool
        Whether the agent's axes stay those of the start; if not, each epoch has a
        heading of its own.
    """

    range_std_m: float = 0.1
    detection_probability: float = 0.95
    clutter_mean: float = 1.0
    region_m: float = 180.0
    order: int = 1
    step_s: float = 1.0
    azimuth_std_rad: float = 0.0
    clock_bias_m: float = 0.0
    clock_free_std_m: float = 0.0
    sweep_every: int = 0
    sweep_variance: float = 8.9e-4
    heading_held: bool = True

    def __post_init__(self) -> None:
        for name in ("range_std_m", "region_m", "step_s"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")
        if not 0.0 <= self.detection_probability <= 1.0:
            raise ConfigurationError(
                f"detection_probability: expected a number from 0 to 1, got {self.detection_probability}"
            )
        for name in ("clutter_mean", "clock_free_std_m"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected 0 or more, got {getattr(self, name)}")


def simulate_walls(
    vrps_m: ArrayLike, variances_m2: ArrayLike, rng: np.random.Generator
) -> tuple[GaussianVrp, ...]:
    """Walls as active sensing at the start would give them.

    Parameters
    ----------
    vrps_m : array_like, shape (L, 2)
        True VRPs relative to RP, metres.
    variances_m2 : array_like, shape (L,)
        Variance per axis, square metres.
    rng : Generator
        Source of randomness.
    """
    vrps = np.asarray(vrps_m, dtype=np.float64)
    variances = np.asarray(variances_m2, dtype=np.float64)
    if vrps.shape != (*variances.shape, 2):
        raise InputError(f"variances_m2: expected one per VRP ({len(vrps)}), got shape {variances.shape}")
    noise = rng.normal(size=vrps.shape) * np.sqrt(variances)[:, None]
    return tuple(
        GaussianVrp(mean, variance * np.eye(2))
        for mean, variance in zip(vrps + noise, variances, strict=True)
    )


def simulate_epochs(
    paths: SpecularPaths, config: SimulationConfig, rng: np.random.Generator
) -> tuple[Epoch, ...]:
    """Noisy, thinned and cluttered paths of every epoch, sorted by delay.

    Parameters
    ----------
    paths : SpecularPaths
        True paths; see :func:`estimator.specular.specular_paths`.
    config : SimulationConfig
        Measurement model.
    rng : Generator
        Source of randomness.
    """
    epochs = []
    for t in range(paths.length_m.shape[0]):
        heading = 0.0 if config.heading_held else float(rng.uniform(-np.pi, np.pi))
        bias = config.clock_bias_m + _free_clock(paths.length_m[t][paths.visible[t]], config, rng)
        heard = tuple(
            _hear(paths.length_m[t, k][seen], paths.azimuth_rad[t, k][seen] - heading, bias, config, rng)
            for k, seen in enumerate(paths.visible[t])
        )
        epochs.append(Epoch(t, t * config.step_s, heard, heading_held=config.heading_held))
    return tuple(epochs)


def _free_clock(lengths: Array, config: SimulationConfig, rng: np.random.Generator) -> float:
    """The clock bias of an epoch, metres; none where it is not free."""
    if config.clock_free_std_m == 0.0:
        return 0.0
    shortest = float(lengths.min(initial=np.inf))
    while True:
        bias = float(rng.normal(scale=config.clock_free_std_m))
        if bias > -shortest:
            return bias


def _hear(
    lengths: Array, azimuths: Array, bias_m: float, config: SimulationConfig, rng: np.random.Generator
) -> AnchorPaths:
    """One anchor's paths in one epoch."""
    detected = rng.random(lengths.size) < config.detection_probability
    true = lengths[detected]
    noisy = true + bias_m + rng.normal(scale=config.range_std_m, size=true.size)
    clutter = rng.uniform(0.0, config.region_m, size=rng.poisson(config.clutter_mean))
    ranges = np.concatenate([noisy, clutter])
    order = ranges.argsort(kind="stable")
    ranges = ranges[order]
    kept = (ranges > 0.0) & (ranges <= config.region_m)
    delay_s = ranges[kept] / SPEED_OF_LIGHT_M_S
    std_s = np.full(delay_s.size, config.range_std_m / SPEED_OF_LIGHT_M_S)
    if config.azimuth_std_rad == 0.0:
        return AnchorPaths(delay_s, std_s)
    order = order[kept]
    true = azimuths[detected] + rng.normal(scale=config.azimuth_std_rad, size=true.size)
    every = np.concatenate([true, rng.uniform(-np.pi, np.pi, size=clutter.size)])
    azimuth = np.angle(np.exp(1j * every[order]))
    azimuth_std = np.full(order.size, config.azimuth_std_rad)
    return AnchorPaths(delay_s, std_s, azimuth_rad=azimuth, azimuth_std_rad=azimuth_std)


def walls_in_view(start_m: ArrayLike, end_m: ArrayLike, position_m: ArrayLike) -> list[int]:
    """Walls that a sweep from a place sees: the foot of the perpendicular is on them and in sight.

    Parameters
    ----------
    start_m, end_m : array_like, shape (L, 2)
        Wall end points, metres.
    position_m : array_like, shape (2,)
        The agent, metres.

    Returns
    -------
    list of int
        Their indices, ascending.
    """
    start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
    position = np.asarray(position_m, dtype=np.float64)
    seen = []
    for wall, image in enumerate(mirror_in_wall(position, start, end)):
        others = np.arange(len(start)) != wall
        foot = 0.5 * (position + image)
        on_wall = segments_cross(position, image, start[wall], end[wall], margin=0.0)
        if on_wall and not np.any(segments_cross(position, foot, start[others], end[others])):
            seen.append(wall)
    return seen


def simulate_sweep(
    start_m: ArrayLike, end_m: ArrayLike, position_m: ArrayLike, variance: float, rng: np.random.Generator
) -> tuple[GaussianVrp, ...]:
    """What a beam sweep sees from a place: the walls with their perpendicular foot in view.

    Parameters
    ----------
    start_m, end_m : array_like, shape (L, 2)
        Wall end points, metres.
    position_m : array_like, shape (2,)
        The agent, metres.
    variance : float
        Variance per axis over the squared distance.
    rng : Generator
        Source of randomness.

    Returns
    -------
    tuple of GaussianVrp
        The agent's mirror images relative to the agent, in the plan's axes.
    """
    position = np.asarray(position_m, dtype=np.float64)
    images = mirror_in_wall(position, start_m, end_m)
    flashes = []
    for wall in walls_in_view(start_m, end_m, position):
        image, foot = images[wall], 0.5 * (position + images[wall])
        spread = variance * float(np.sum((foot - position) ** 2))
        noise = rng.normal(scale=np.sqrt(spread), size=2)
        flashes.append(GaussianVrp(image - position + noise, spread * np.eye(2)))
    return tuple(flashes)


def measure_scene(
    start_m: ArrayLike,
    end_m: ArrayLike,
    anchors_m: ArrayLike,
    track_m: ArrayLike,
    wall_variances_m2: Sequence[float],
    carrier_hz: float,
    config: SimulationConfig,
    rng: np.random.Generator,
    know_anchors: bool = False,
    paths: SpecularPaths | None = None,
) -> MeasurementSet:
    """Measurements of a run through a room: the first walls with variances, all epochs.

    Parameters
    ----------
    start_m, end_m : array_like, shape (L, 2)
        Wall end points in the plan's frame, metres.
    anchors_m : array_like, shape (K, 2)
        Anchors, metres.
    track_m : array_like, shape (T, 2)
        Agent positions, metres; the first is RP.
    wall_variances_m2 : sequence of float
        Active-sensing variance per axis of the first walls of the list.
    carrier_hz : float
        Carrier frequency, hertz.
    config : SimulationConfig
        Measurement model.
    rng : Generator
        Source of randomness.
    know_anchors : bool
        Whether the measurements say where the anchors are.
    paths : SpecularPaths, optional
        The true paths of up to ``config.order`` bounces, where they have been traced already.
    """
    reference = np.asarray(track_m, dtype=np.float64)[0]
    sensed = len(wall_variances_m2)
    vrps = vrp_of_line(start_m, end_m, reference)[:sensed] - reference
    walls = simulate_walls(vrps, wall_variances_m2, rng)
    if paths is None:
        paths = specular_paths(start_m, end_m, anchors_m, track_m, config.order)
    epochs = simulate_epochs(paths, config, rng)
    if config.sweep_every:
        epochs = tuple(_with_sweep(epoch, start_m, end_m, track_m, config, rng) for epoch in epochs)
    names = tuple(f"pa{k + 1}" for k in range(paths.length_m.shape[1]))
    model: dict[str, float | bool] = {
        "range_std_m": config.range_std_m,
        "detection_probability": min(max(config.detection_probability, 0.01), 0.99),
        "clutter_mean": config.clutter_mean,
        "region_m": config.region_m,
        "height2_mean_m2": 0.0,
        "height2_std_m2": 0.0,
    }
    if config.clock_bias_m:
        model |= {"clock_bias_std_m": abs(config.clock_bias_m), "clock_bias_common": True}
    if config.clock_free_std_m:
        model |= {"clock_free_std_m": config.clock_free_std_m}
    settings = {"simulation": asdict(config), "measurement_model": model}
    places = np.asarray(anchors_m, dtype=np.float64).reshape(-1, 2) - reference if know_anchors else None
    return MeasurementSet(names, walls, epochs, carrier_hz, settings, known_anchors_m=places)


def _with_sweep(
    epoch: Epoch,
    start_m: ArrayLike,
    end_m: ArrayLike,
    track_m: ArrayLike,
    config: SimulationConfig,
    rng: np.random.Generator,
) -> Epoch:
    """The epoch with a beam sweep, if one is due."""
    if epoch.index == 0 or epoch.index % config.sweep_every:
        return epoch
    place = np.asarray(track_m, dtype=np.float64)[epoch.index]
    return replace(epoch, sweep=simulate_sweep(start_m, end_m, place, config.sweep_variance, rng))
