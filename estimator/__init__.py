"""From channels to a map: delays, walls, anchors and a trajectory, with covariances.

NumPy and SciPy only (xarray for files); the ray tracer and the service are other rooms.

The names below are the public surface; they are imported when first used, so that
``import estimator`` costs nothing. What goes deeper is imported from its module.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimator.arrays import BeamSet, UniformLinearArray, UniformPlanarArray
    from estimator.channel.nomp import DelayEstimate, NompConfig, NompPlan, estimate_delays, estimate_paths
    from estimator.dataset import open_dataset
    from estimator.errors import HapslamError, InputError
    from estimator.evaluation import evaluate
    from estimator.measurements import (
        AnchorPaths,
        Epoch,
        GaussianVrp,
        MeasurementSet,
        load_measurements,
        save_measurements,
    )
    from estimator.metrics import (
        best_rotation,
        derotated,
        mean_absolute_error,
        mospa,
        nees,
        nees_band,
        ospa,
        root_mean_square_error,
    )
    from estimator.result import SlamResult, load_result, save_result
    from estimator.sensing.flash import find_flashes, flash_walls
    from estimator.sensing.linefit import fit_wall
    from estimator.slam import GaussianConfig, ParticleConfig, run_slam
    from estimator.waveform import OfdmGrid

__all__ = [
    "AnchorPaths",
    "BeamSet",
    "DelayEstimate",
    "Epoch",
    "GaussianConfig",
    "GaussianVrp",
    "HapslamError",
    "InputError",
    "MeasurementSet",
    "NompConfig",
    "NompPlan",
    "OfdmGrid",
    "ParticleConfig",
    "SlamResult",
    "UniformLinearArray",
    "UniformPlanarArray",
    "best_rotation",
    "derotated",
    "estimate_delays",
    "estimate_paths",
    "evaluate",
    "find_flashes",
    "fit_wall",
    "flash_walls",
    "load_measurements",
    "load_result",
    "mean_absolute_error",
    "mospa",
    "nees",
    "nees_band",
    "open_dataset",
    "ospa",
    "root_mean_square_error",
    "run_slam",
    "save_measurements",
    "save_result",
]

_HOMES = {
    "arrays": ("BeamSet", "UniformLinearArray", "UniformPlanarArray"),
    "channel.nomp": ("DelayEstimate", "NompConfig", "NompPlan", "estimate_delays", "estimate_paths"),
    "dataset": ("open_dataset",),
    "errors": ("HapslamError", "InputError"),
    "evaluation": ("evaluate",),
    "measurements": (
        "AnchorPaths",
        "Epoch",
        "GaussianVrp",
        "MeasurementSet",
        "load_measurements",
        "save_measurements",
    ),
    "metrics": (
        "best_rotation",
        "derotated",
        "mean_absolute_error",
        "mospa",
        "nees",
        "nees_band",
        "ospa",
        "root_mean_square_error",
    ),
    "result": ("SlamResult", "load_result", "save_result"),
    "sensing.flash": ("find_flashes", "flash_walls"),
    "sensing.linefit": ("fit_wall",),
    "slam": ("GaussianConfig", "ParticleConfig", "run_slam"),
    "waveform": ("OfdmGrid",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A public name, imported from its module."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'estimator' has no attribute {name!r}")
    value = getattr(import_module(f"estimator.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names beside those of any module."""
    return sorted({*globals(), *__all__})
