"""The figures that can be reproduced, and what a request for one says.

This module is light: the command line lists the figures without loading what computes them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

from estimator.errors import ConfigurationError
from estimator.executors import Progress, Workers

if TYPE_CHECKING:
    from estimator.experiments.report import Report
    from estimator.experiments.room import Room

__all__ = ["FIGURES", "Entry", "Request", "reproduce", "wanted"]


@dataclass(frozen=True)
class Entry:
    """A figure of the paper.

    Parameters
    ----------
    title : str
        What it shows.
    module : str
        The module of this package with its function ``reproduce``.
    runs : int
        Runs of the paper; 0 where nothing is random.
    methods : tuple of str
        Methods compared by default; empty where no SLAM is run.
    """

    title: str
    module: str
    runs: int
    methods: tuple[str, ...] = ()


FIGURES = {
    "fig7": Entry("Distribution of the estimated distance", "range_distribution", 10_000),
    "fig8": Entry("Error of the estimated distance and its bound", "range_accuracy", 10_000),
    "fig9": Entry("Approximation of the distance's bound", "range_bounds", 0),
    "fig10": Entry("Distribution of the estimated VRP", "vrp_distribution", 10_000),
    "fig11": Entry(
        "Rotation of the map with and without active sensing", "rotation", 1, ("passive", "hybrid")
    ),
    "fig12": Entry("Walls refined and found by passive sensing", "wall_refinement", 1, ("hybrid",)),
    "fig13": Entry("Errors of localisation and mapping", "methods_compared", 100, ("hybrid", "mva", "va")),
    "fig14": Entry("Maps of a single run", "single_run", 1, ("va", "mva", "hybrid")),
}


@dataclass(frozen=True, eq=False)
class Request:
    """What to reproduce, and by what means.

    Parameters
    ----------
    room : Room
        The truth of the SLAM experiments.
    runs : int, optional
        Monte-Carlo runs (points of Fig. 8: each); by default as many as the paper's.
    seed : int
        Seed of run 0; run ``i`` has ``seed + i``.
    methods : sequence of str
        ``METHOD[+OPTION...]`` each; by default those of the figure.
    engine : str, optional
        The engine; by default those that can run the method.
    particles : int
        Particles of the ``particle`` engine.
    workers : Workers
        Where runs happen; by default in this process.
    progress : callable, optional
        Called with (tasks done, tasks in all).
    """

    room: Room
    runs: int | None = None
    seed: int = 1
    methods: Sequence[str] = ()
    engine: str | None = None
    particles: int = 100_000
    workers: Workers = field(default_factory=Workers)
    progress: Progress | None = None

    def map(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
        """Results of tasks, in their order; see :meth:`estimator.executors.Workers.map`."""
        return self.workers.map(function, tasks, self.progress)


def wanted(name: str) -> list[str]:
    """The figures that a name stands for: one, or all of them for ``all``.

    Raises
    ------
    ConfigurationError
        If there is no such figure; says which there are.
    """
    if name == "all":
        return list(FIGURES)
    if name not in FIGURES:
        raise ConfigurationError(f"figure: expected one of {', '.join(FIGURES)}, all, got {name!r}")
    return [name]


def reproduce(name: str, request: Request) -> Report:
    """Reproduce one figure.

    Raises
    ------
    ConfigurationError
        If the figure, a method or an engine is unknown or without meaning for the figure, or the
        number of runs not positive.
    """
    if name not in FIGURES:
        raise ConfigurationError(f"figure: expected one of {', '.join(FIGURES)}, got {name!r}")
    if request.runs is not None and request.runs < 1:
        raise ConfigurationError(f"runs: expected 1 or more, got {request.runs}")
    if (request.methods or request.engine) and not FIGURES[name].methods:
        raise ConfigurationError(f"methods, engine: expected none for {name}, which runs no SLAM")
    module = import_module(f"estimator.experiments.{FIGURES[name].module}")
    report: Report = module.reproduce(name, FIGURES[name], request)
    return report
