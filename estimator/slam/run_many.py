"""Many whole runs together, as Monte-Carlo experiments need them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict

from estimator.errors import InputError
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.slam.config import GaussianConfig
from estimator.slam.engine import GaussianEngine, Prior, epoch_rng
from estimator.slam.estimate import Estimate
from estimator.slam.run import collect, config_for, engine_for
from estimator.threads import one_blas_thread

__all__ = ["run_many"]


@one_blas_thread()
def run_many(
    measurements: Sequence[MeasurementSet],
    method: str = "hybrid",
    seeds: Sequence[int] | None = None,
    config: GaussianConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[SlamResult]:
    """Run SLAM with the ``gaussian`` engine over many independent runs, epoch by epoch all together.

    Each result is that of :func:`estimator.run_slam` to rounding; fifty take about a quarter of the time.

    Parameters
    ----------
    measurements : sequence of MeasurementSet
        The runs; they may differ in length, anchors and models.
    method : str
        What is known and sensed, as for ``run_slam``.
    seeds : sequence of int, optional
        Recorded in the results, one each; by default 0. The engine draws no random numbers.
    config : GaussianConfig, optional
        Models and limits of all runs; by default those that fit each run's measurements.
    progress : callable, optional
        Called with (epochs done, epochs in all), of all runs.

    Returns
    -------
    list of SlamResult

    Raises
    ------
    ConfigurationError
        If the method is unknown or needs the ``particle`` engine.
    InputError
        If there are not as many seeds as runs, or measurements lack what the method needs.
    """
    seeds = [0] * len(measurements) if seeds is None else seeds
    if len(seeds) != len(measurements):
        raise InputError(f"seeds: expected one for each of {len(measurements)} runs, got {len(seeds)}")
    engines = [_engine(each, method, config) for each in measurements]
    states = [
        engine.start(Prior.of(each), epoch_rng(seed, -1))
        for engine, each, seed in zip(engines, measurements, seeds, strict=True)
    ]
    estimates: list[list[Estimate]] = [[] for _ in measurements]
    total, done = sum(len(each.epochs) for each in measurements), 0
    for t in range(max((len(each.epochs) for each in measurements), default=0)):
        going: dict[GaussianEngine, list[int]] = {}
        for i, each in enumerate(measurements):
            if t < len(each.epochs):
                going.setdefault(engines[i], []).append(i)
        for engine, runs in going.items():
            after = engine.step_many([states[i] for i in runs], [measurements[i].epochs[t] for i in runs])
            for i, state in zip(runs, after, strict=True):
                states[i] = state
                estimates[i].append(engine.estimate(state))
            done += len(runs)
        if progress is not None:
            progress(done, total)
    return [
        collect(
            each,
            estimates[i],
            method,
            "gaussian",
            seeds[i],
            {"slam": asdict(engines[i].config), "measurements": dict(each.settings)},
        )
        for i, each in enumerate(measurements)
    ]


def _engine(measurements: MeasurementSet, method: str, config: GaussianConfig | None) -> GaussianEngine:
    fitting = config_for(measurements) if config is None else config
    engine = engine_for(method, "gaussian", fitting)
    assert isinstance(engine, GaussianEngine)
    return engine
