"""From a dataset's channels to measurements: the stage ``hapslam extract``.

All channel frequency responses go through NOMP (:mod:`estimator.channel.nomp`), the beam
sweep at the start through the search for flashes (:mod:`estimator.sensing.flash`). The dataset's
paths and truth are not opened.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from estimator.arrays import BeamSet
from estimator.channel.nomp import DelayEstimate, NompConfig, NompPlan
from estimator.dataset import Dataset
from estimator.errors import ConfigurationError, FileFormatError, InputError
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.sensing.beam_ranges import walls_of_beams
from estimator.sensing.flash import FlashConfig, find_flashes, flash_walls
from estimator.threads import one_blas_thread
from estimator.waveform import OfdmGrid, frequency_response

__all__ = ["ExtractConfig", "Progress", "extract", "extract_epochs", "sense_walls"]

Complex = NDArray[np.complex128]
Progress = Callable[[int, int, str], None]
"""Called with (channels done, channels in all, what is being done)."""


@dataclass(frozen=True)
class ExtractConfig:
    """Settings of the extraction.

    Parameters
    ----------
    nomp : NompConfig
        Delays from passive channels.
    flash : FlashConfig
        Walls from the beam sweep.
    batch : int
        Channels estimated together; about 64 is fastest.
    """

    nomp: NompConfig = field(default_factory=NompConfig)
    flash: FlashConfig = field(default_factory=FlashConfig)
    batch: int = 64

    def __post_init__(self) -> None:
        if self.batch < 1:
            raise ConfigurationError(f"batch: expected at least 1, got {self.batch}")


def extract(
    dataset: Dataset, config: ExtractConfig | None = None, progress: Progress | None = None
) -> MeasurementSet:
    """Estimate all delays and sense the walls at the start.

    Parameters
    ----------
    dataset : Dataset
        What ``hapslam trace`` wrote, or any dataset of that form.
    config : ExtractConfig, optional
        Settings; they are recorded in the result.
    progress : callable, optional
        See :data:`Progress`.

    Returns
    -------
    MeasurementSet
        Without the name of the dataset.

    Raises
    ------
    FileFormatError
        If shards are damaged, or manifest and shards do not fit together.
    InputError
        If channels are not finite.
    """
    settings = ExtractConfig() if config is None else config
    radio = _section(dataset.manifest, "radio")
    walls = sense_walls(dataset, settings.flash)
    epochs = extract_epochs(dataset, settings.nomp, settings.batch, progress)
    return MeasurementSet(
        anchors=tuple(str(name) for name in _entry(dataset.manifest, "anchors", "manifest")),
        walls=walls,
        epochs=epochs,
        carrier_hz=float(_entry(radio, "carrier_hz", "radio")),
        settings={
            "extract": asdict(settings),
            "name": dataset.manifest.get("name"),
            "seed": dataset.manifest.get("seed"),
        },
    )


@one_blas_thread()
def extract_epochs(
    dataset: Dataset, config: NompConfig | None = None, batch: int = 64, progress: Progress | None = None
) -> tuple[Epoch, ...]:
    """Delays of all anchors in all epochs, from the agent's first antenna.

    Parameters and errors are those of :func:`extract`.
    """
    radio = _section(dataset.manifest, "radio")
    plan = NompPlan(_grid(radio, "radio"), config)
    noise_variance = float(_entry(radio, "noise_variance", "radio"))
    anchors = len(_entry(dataset.manifest, "anchors", "manifest"))
    total = int(_entry(dataset.manifest, "epochs", "manifest")) * anchors
    epochs: list[Epoch] = []
    for shard in dataset.shards("passive"):
        cfr = _channels(shard, plan.grid)
        if cfr.shape[1:] != (anchors, plan.grid.tones):
            raise FileFormatError(
                f"{dataset.path}: expected channels of {anchors} anchors and {plan.grid.tones} tones, "
                f"as the manifest says, got {cfr.shape[1]} and {cfr.shape[2]}"
            )
        estimates: list[DelayEstimate] = []
        rows = cfr.reshape(-1, plan.grid.tones)
        for start in range(0, len(rows), batch):
            estimates += plan.estimate(rows[start : start + batch], noise_variance)
            if progress is not None:
                progress(len(epochs) * anchors + len(estimates), total, "estimating delays")
        epochs += _epochs(shard, estimates, anchors)
    if not epochs:
        raise FileFormatError(f"{dataset.path}: expected passive channels, the manifest lists none")
    return tuple(epochs)


def _channels(shard: xr.Dataset, grid: OfdmGrid) -> Complex:
    """CFRs (epoch, anchor, tone) of the first antenna; from impulse responses if it holds no others.

    Where there are several snapshots, or anchors with arrays, it is the first of those, too.
    """
    links = ("epoch", "anchor", "antenna")
    first = shard.isel({axis: 0 for axis in ("snapshot", "anchor_antenna") if axis in shard.dims})
    first = first.isel(antenna=slice(1)) if "antenna" in first.dims else first
    if "cir_re" in shard and "cfr_re" not in shard:
        cir = _complex(first, "cir", "passive", (*links, "tap"))
        if cir.shape[-1] == grid.tones:
            return frequency_response(cir[:, :, 0, :], grid)
        return cir[:, :, 0, :]
    return _complex(first, "cfr", "passive", (*links, "tone"))[:, :, 0, :]


@one_blas_thread()
def sense_walls(dataset: Dataset, config: FlashConfig | None = None) -> tuple[GaussianVrp, ...]:
    """Walls from the sweep at the start; none if the dataset holds no sweep.

    Raises
    ------
    FileFormatError
        If shards are damaged, or manifest and shards do not fit together.
    InputError
        If the first sweep is not of the first epoch, where the agent stands at the reference point.
    """
    for shard in dataset.shards("echo"):
        section = _section(dataset.manifest, "echo")
        sweep_epoch = int(shard["sweep_epoch"].values[0])
        if sweep_epoch != 0:
            raise InputError(
                f"{dataset.path}: expected a beam sweep at epoch 0, the first is at {sweep_epoch}"
            )
        echo = _complex(shard, "echo", "echo", ("sweep", "beam", "tone"))[0]
        grid, beams = _grid(section, "echo"), _beams(section)
        if echo.shape != (beams.beams, grid.tones):
            raise FileFormatError(
                f"{dataset.path}: expected an echo of {beams.beams} beams and {grid.tones} tones, "
                f"as the manifest says, got {echo.shape[0]} and {echo.shape[1]}"
            )
        noise_variance = float(_entry(section, "noise_variance", "echo"))
        if section.get("model") == "radar-equation":  # every beam hears its wall, and nothing flashes
            return walls_of_beams(echo, noise_variance, grid, beams)
        return flash_walls(find_flashes(echo, noise_variance, grid, beams, config))
    return ()


def _epochs(shard: xr.Dataset, estimates: list[DelayEstimate], anchors: int) -> Iterator[Epoch]:
    """Epochs of a shard from the estimates of its channels, anchor by anchor within an epoch."""
    times = shard["time_s"].values
    for i, index in enumerate(shard["epoch"].values):
        paths = tuple(
            AnchorPaths(e.delay_s, np.sqrt(e.variance_s2), 20.0 * np.log10(np.abs(e.gain)))
            for e in estimates[i * anchors : (i + 1) * anchors]
        )
        yield Epoch(int(index), float(times[i]), paths)


def _entry(section: Mapping[str, Any], key: str, name: str) -> Any:
    try:
        return section[key]
    except KeyError as error:
        raise FileFormatError(f"{name}: expected the entry {key!r} in the manifest, it is missing") from error


def _section(manifest: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = _entry(manifest, name, "manifest")
    if not isinstance(section, Mapping):
        raise FileFormatError(f"{name}: expected a table in the manifest, got {section!r}")
    return section


def _grid(section: Mapping[str, Any], name: str) -> OfdmGrid:
    """The tones that a section of the manifest describes."""
    return OfdmGrid(
        carrier_hz=float(_entry(section, "carrier_hz", name)),
        subcarrier_spacing_hz=float(_entry(section, "subcarrier_spacing_hz", name)),
        subcarriers=int(_entry(section, "subcarriers", name)),
        comb=int(_entry(section, "comb", name)),
        symbols=int(_entry(section, "symbols", name)),
    )


def _beams(section: Mapping[str, Any]) -> BeamSet:
    beams = _section(section, "beams")
    return BeamSet(
        panels=int(_entry(beams, "panels", "echo.beams")),
        elements=int(_entry(beams, "elements", "echo.beams")),
        beams=int(_entry(beams, "beams", "echo.beams")),
        spacing_wavelengths=float(_entry(beams, "spacing_wavelengths", "echo.beams")),
        heading_rad=float(_entry(beams, "heading_rad", "echo.beams")),
    )


def _complex(shard: xr.Dataset, name: str, kind: str, dims: tuple[str, ...]) -> Complex:
    """A complex variable stored as two real ones, with its axes checked."""
    try:
        real, imaginary = shard[f"{name}_re"], shard[f"{name}_im"]
    except KeyError as error:
        raise FileFormatError(f"{kind}: expected the variable {error} in the shard, it is missing") from error
    if real.dims != dims or imaginary.dims != dims:
        raise FileFormatError(f"{kind}: expected {name} with the axes {dims}, got {real.dims}")
    return np.asarray(real.values + 1j * imaginary.values.astype(np.float64), dtype=np.complex128)
