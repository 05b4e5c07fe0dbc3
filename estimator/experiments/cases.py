"""What an experiment runs: a method, an engine, and what is measured in addition.

A case is named ``METHOD[+OPTION...]/ENGINE``, for instance ``hybrid+aoa/gaussian``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from estimator.errors import ConfigurationError
from estimator.experiments.room import Room
from estimator.simulate import SimulationConfig
from estimator.slam.bounds.posterior import Bounds, posterior_bounds
from estimator.slam.bounds.scenario import Sensing
from estimator.slam.methods import METHODS, PAIRS, Method, method_for

__all__ = ["OPTIONS", "Case", "Option", "cases_of", "limit_of", "simulation_with"]


@dataclass(frozen=True)
class Option:
    """Something measured, or not known, in addition to the paper's scenario.

    Parameters
    ----------
    text : str
        What it is.
    simulation : mapping
        Fields of :class:`~estimator.simulate.SimulationConfig` that it sets.
    sensing : mapping
        Fields of :class:`~estimator.slam.bounds.scenario.Sensing` that it sets.
    """

    text: str
    simulation: Mapping[str, Any] = field(default_factory=dict)
    sensing: Mapping[str, Any] = field(default_factory=dict)


_DEGREE_RAD = float(np.deg2rad(1.0))
OPTIONS = {
    "aoa": Option(
        "directions of arrival of 1 degree, heading held",
        {"azimuth_std_rad": _DEGREE_RAD},
        {"azimuth_std_rad": _DEGREE_RAD},
    ),
    "sweeps": Option("a beam sweep every 10 epochs, heading held", {"sweep_every": 10}, {"sweep_every": 10}),
    "clock": Option(
        "an unknown constant clock bias (10 m) of all anchors",
        {"clock_bias_m": 10.0},
        {"clock_bias": "common"},
    ),
    "tdoa": Option(
        "a clock bias (10 m) of all anchors that is new in every epoch: time differences of arrival",
        {"clock_free_std_m": 10.0},
        {"clock_bias": "free"},
    ),
}


@dataclass(frozen=True)
class Case:
    """One method with one engine.

    Parameters
    ----------
    method, engine : str
        What is known and sensed, and how inference is done; a pair of
        :data:`estimator.slam.methods.PAIRS`.
    options : tuple of str
        Keys of :data:`OPTIONS`.
    """

    method: str
    engine: str
    options: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Method and options: ``hybrid+aoa``."""
        return "+".join((self.method, *self.options))

    @property
    def key(self) -> str:
        """Name and engine: ``hybrid+aoa/gaussian``."""
        return f"{self.name}/{self.engine}"

    @property
    def setting(self) -> Method:
        """What the method knows and senses."""
        return METHODS[self.method]

    @property
    def simulation(self) -> SimulationConfig:
        """How its measurements are simulated."""
        return simulation_with(self.options)


def simulation_with(options: Sequence[str]) -> SimulationConfig:
    """The paper's measurement model with options.

    Raises
    ------
    ConfigurationError
        If an option is unknown.
    """
    config = SimulationConfig()
    for name in options:
        if name not in OPTIONS:
            raise ConfigurationError(f"option: expected one of {', '.join(OPTIONS)}, got {name!r}")
        config = replace(config, **OPTIONS[name].simulation)
    return config


def cases_of(methods: Sequence[str], engine: str | None, every_engine: bool = True) -> list[Case]:
    """The cases of methods with options, in their order.

    Parameters
    ----------
    methods : sequence of str
        ``METHOD[+OPTION...]`` each.
    engine : str or None
        The engine; None for those that can run the method.
    every_engine : bool
        Whether None means all of these or the first of them.

    Raises
    ------
    ConfigurationError
        If a method, an option or the pair with the engine does not exist; says what does.
    """
    cases: list[Case] = []
    for name in methods:
        method, *options = name.split("+")
        simulation_with(options)
        able = [other for known, other in PAIRS if known == method]
        engines = [engine] if engine is not None else able[: None if every_engine else 1]
        for each in engines or [PAIRS[0][1]]:
            method_for(method, each)
            case = Case(method, each, tuple(options))
            if case not in cases:
                cases.append(case)
    return cases


def limit_of(room: Room, case: Case) -> Bounds | None:
    """The bound of what a case measures.

    None for a method that hears no paths, and for one that knows neither a wall nor an anchor at the start:
    its map may turn by any angle, and a bound linearised about the truth means nothing.
    """
    setting, simulation = case.setting, case.simulation
    if not setting.paths or setting.anchors == "ring":
        return None
    sensing = Sensing(
        range_std_m=simulation.range_std_m,
        detection_probability=simulation.detection_probability,
        order=simulation.order,
        anchors_known=setting.anchors == "known",
        sensed=room.sensed if setting.walls else {},
        sweep_variance=simulation.sweep_variance,
    )
    for name in case.options:
        sensing = replace(sensing, **OPTIONS[name].sensing)
    return posterior_bounds(room.scenario, sensing)
