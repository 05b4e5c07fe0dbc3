"""A whole run: measurements in, estimates of every epoch out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from estimator.errors import ConfigurationError
from estimator.joined_results import join_results
from estimator.measurements import GaussianVrp, MeasurementSet
from estimator.parts import Parts
from estimator.result import SlamResult, load_result, save_result
from estimator.slam import methods
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.engine import GaussianEngine
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.engine import ParticleEngine
from estimator.slam.protocol import INTEGRITY_STATES, Engine, Estimate, Prior, epoch_rng, stacked_candidates
from estimator.threads import one_blas_thread

__all__ = ["ENGINES", "METHODS", "config_for", "engine_for", "run_slam"]

METHODS = tuple(methods.METHODS)
ENGINES = ("gaussian", "particle")
_STRETCH = 1000  # epochs whose estimates are stacked together: arrays need less memory
_PART = "slam"
_STATES = {name: number for number, name in enumerate(INTEGRITY_STATES)}
Config = GaussianConfig | ParticleConfig
_CONFIGS: Mapping[str, type[Config]] = {"gaussian": GaussianConfig, "particle": ParticleConfig}


def config_for(measurements: MeasurementSet, base: Config | None = None, engine: str = "gaussian") -> Config:
    """The configuration that fits the measurements.

    What produced them may state its noise in ``settings["measurement_model"]`` (a
    mapping of :class:`GaussianConfig` fields, of which an engine takes those it has);
    the rest is ``base`` or the default.

    Parameters
    ----------
    measurements : MeasurementSet
        Measurements of a run.
    base : GaussianConfig or ParticleConfig, optional
        Values that the measurements do not state; names the engine too.
    engine : str
        The engine to configure without ``base``.

    Raises
    ------
    ConfigurationError
        If the engine is unknown, or the mapping names an unknown field or a value out
        of range.
    """
    if engine not in _CONFIGS:
        raise ConfigurationError(f"engine: expected one of {', '.join(ENGINES)}, got {engine!r}")
    stated: Mapping[str, Any] = measurements.settings.get("measurement_model", {})
    base = _CONFIGS[engine]() if base is None else base
    if not set(GaussianConfig.names()).issuperset(stated):
        raise ConfigurationError(f"measurement_model: expected names of settings, got {dict(stated)}")
    if isinstance(base, GaussianConfig):
        known = {
            "max_speed_m_s": measurements.max_speed_m_s,
            "echo_bias_std_m": measurements.echo_bias_std_m,
        }
        return base.but(**{name: value for name, value in known.items() if value is not None} | {**stated})
    own = base.names()
    return base.but(**{name: value for name, value in stated.items() if name in own})


def engine_for(method: str, engine: str, config: Config) -> Engine:
    """The engine that runs ``method``; :data:`estimator.slam.methods.PAIRS` lists what there is.

    Raises
    ------
    ConfigurationError
        If the method or the engine is unknown, the engine cannot run the method, or the
        configuration is another engine's.
    """
    chosen = methods.method_for(method, engine)
    if isinstance(config, ParticleConfig) and engine == "particle":
        return ParticleEngine(config, chosen)
    if isinstance(config, GaussianConfig) and engine == "gaussian":
        return GaussianEngine(config, chosen)
    raise ConfigurationError(
        f"config: expected a {_CONFIGS[engine].__name__} for engine {engine}, got a {type(config).__name__}"
    )


@one_blas_thread()
def run_slam(
    measurements: MeasurementSet,
    method: str = "hybrid",
    engine: str = "gaussian",
    seed: int = 0,
    config: Config | None = None,
    progress: Callable[[int, int], None] | None = None,
    walls: Sequence[GaussianVrp] | None = None,
    parts: Parts | None = None,
) -> SlamResult:
    """Run SLAM over all epochs.

    Parameters
    ----------
    measurements : MeasurementSet
        Walls sensed at the start and epochs of paths.
    method : str
        What is known and sensed (:mod:`estimator.slam.methods`): ``"hybrid"`` (nothing known,
        active and passive sensing), ``"va"``, ``"mva"``, ``"passive"`` or ``"active"``.
    engine : str
        How inference is done: ``"gaussian"`` (joint, consistent) or ``"particle"`` (belief
        propagation as published).
    seed : int
        Seed of engines that draw random numbers; recorded in the result.
    config : GaussianConfig or ParticleConfig, optional
        Models and limits; by default those that fit the measurements.
    progress : callable, optional
        Called with (epochs done, epochs in all).
    walls : sequence of GaussianVrp, optional
        Walls known from a floor plan (:func:`estimator.known_walls.known_walls`) instead of those sensed.
    parts : Parts, optional
        Where what is done is kept, and what is done already.

    Returns
    -------
    SlamResult

    Raises
    ------
    ConfigurationError
        If the method or the engine is unknown, or there is no such pair.
    InputError
        If the measurements lack what the method needs: an epoch, an anchor, a wall, or
        for ``va`` and ``mva`` the anchors' positions; or have known walls where the method takes none.
    """
    config = config_for(measurements, engine=engine) if config is None else config
    chosen = engine_for(method, engine, config)
    settings = {"slam": config.flat(), "measurements": dict(measurements.settings)}
    run = _Stretches(
        measurements, parts, lambda part, found: collect(part, found, method, engine, seed, settings)
    )
    if run.saved is None:
        state = chosen.start(Prior.of(measurements, walls), epoch_rng(seed, -1))
    else:
        state = chosen.load(run.saved)
    for epoch in measurements.epochs[run.done :]:
        state = chosen.step(state, epoch, epoch_rng(seed, epoch.index))
        run.add(chosen.estimate(state))
        if parts is not None and parts.due:
            run.keep(parts, chosen.save(state))
        if progress is not None:
            progress(run.done, len(measurements.epochs))
    return run.result()


class _Stretches:
    """Estimates of a run, stacked stretch by stretch, with what runs before it kept.

    Parameters
    ----------
    measurements : MeasurementSet
        Of the whole run.
    parts : Parts, optional
        What runs before this one kept.
    stacked : callable
        Makes a result of measurements and their estimates.
    """

    def __init__(
        self,
        measurements: MeasurementSet,
        parts: Parts | None,
        stacked: Callable[[MeasurementSet, Sequence[Estimate]], SlamResult],
    ) -> None:
        kept = [] if parts is None else parts.of(_PART)
        self.done = kept[-1].done if kept else 0
        self.saved = parts.state(kept[-1]) if parts is not None and kept else None
        self._measurements, self._stacked = measurements, stacked
        self._kept, self._new = [load_result(part.path) for part in kept], list[SlamResult]()
        self._estimates: list[Estimate] = []

    def add(self, estimate: Estimate) -> None:
        """The estimate of the next epoch."""
        self._estimates.append(estimate)
        self.done += 1
        if len(self._estimates) == _STRETCH:
            self._stack()

    def keep(self, parts: Parts, state: bytes) -> None:
        """Keep the epochs since the part before."""
        self._stack()
        part, self._new = join_results(self._new), []
        parts.keep(_PART, self.done, lambda path: save_result(part, path), state)
        self._kept.append(part)

    def result(self) -> SlamResult:
        """The result of all epochs."""
        self._stack()
        return join_results([*self._kept, *self._new])

    def _stack(self) -> None:
        epochs = self._measurements.epochs[self.done - len(self._estimates) : self.done]
        if self._estimates or not self._measurements.epochs:
            self._new.append(self._stacked(replace(self._measurements, epochs=epochs), self._estimates))
        self._estimates = []


def collect(
    measurements: MeasurementSet,
    estimates: Sequence[Estimate],
    method: str,
    engine: str,
    seed: int,
    settings: Mapping[str, Any],
) -> SlamResult:
    """Stack the estimates of all epochs of a run into a result."""
    epochs, anchors = len(estimates), len(measurements.anchors)
    ids = np.unique(np.concatenate([[], *(e.wall_id for e in estimates)])).astype(np.int64)
    wall_valid = np.zeros((epochs, ids.size), dtype=bool)
    wall_mean = np.full((epochs, ids.size, 2), np.nan)
    wall_covariance = np.full((epochs, ids.size, 2, 2), np.nan)
    wall_existence = np.full((epochs, ids.size), np.nan)
    for t, e in enumerate(estimates):
        columns = np.searchsorted(ids, e.wall_id)
        wall_valid[t, columns] = True
        wall_mean[t, columns], wall_covariance[t, columns] = e.wall_mean_m, e.wall_covariance_m2
        wall_existence[t, columns] = e.wall_existence

    def stacked(name: str, *shape: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array([getattr(e, name) for e in estimates], dtype=np.float64).reshape(epochs, *shape)

    told: dict[str, Any] = {**stacked_candidates([e.candidates for e in estimates])}
    return SlamResult(
        method=method,
        engine=engine,
        seed=seed,
        anchors=measurements.anchors,
        epoch=np.array([epoch.index for epoch in measurements.epochs], dtype=np.int64),
        time_s=np.array([epoch.time_s for epoch in measurements.epochs], dtype=np.float64),
        agent_mean=stacked("agent_mean", 4),
        agent_covariance=stacked("agent_covariance", 4, 4),
        rotation_std_rad=stacked("rotation_std_rad"),
        anchor_valid=stacked("anchor_valid", anchors).astype(bool),
        anchor_mean_m=stacked("anchor_mean_m", anchors, 2),
        anchor_covariance_m2=stacked("anchor_covariance_m2", anchors, 2, 2),
        wall_id=ids,
        wall_valid=wall_valid,
        wall_mean_m=wall_mean,
        wall_covariance_m2=wall_covariance,
        hypotheses=stacked("hypotheses").astype(np.int64),
        log_evidence=stacked("log_evidence"),
        anchor_existence=stacked("anchor_existence", anchors),
        wall_existence=wall_existence,
        **told,
        integrity_state=np.array([_STATES.get(e.integrity.state, -1) for e in estimates], dtype=np.int64),
        integrity_probability=np.array([e.integrity.probability for e in estimates]),
        protection_level_m=np.array([e.integrity.protection_level_m for e in estimates]),
        settings=dict(settings),
        dataset=measurements.dataset,
    )
