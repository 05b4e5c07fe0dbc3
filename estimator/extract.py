"""From a dataset's channels to measurements: the stage ``hapslam extract``.

All channel frequency responses go through NOMP (:mod:`estimator.channel.nomp`), all beam
sweeps through the search for flashes (:mod:`estimator.sensing.flash`): that of the first epoch
gives the walls at the start, each later one belongs to its epoch. The dataset's paths and truth
are not opened.

Where the agent has an array, delays and directions are estimated together. Directions of arrival
become part of the measurements if the array tells all azimuths apart (a lying planar array does): of a
linear array, one of front and back would be wrong, and a map does not survive that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import AntennaArray, BeamSet, UniformLinearArray, UniformPlanarArray
from estimator.channel.diffuse import DiffuseConfig, DiffusePlan
from estimator.channel.nomp import DelayEstimate, NompConfig, NompPlan
from estimator.dataset import Dataset
from estimator.errors import ConfigurationError, FileFormatError
from estimator.kept_epochs import KeptEpochs
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.odometry import odometry_of
from estimator.parts import Parts
from estimator.sensing.beam_ranges import walls_of_beams
from estimator.sensing.flash import FlashConfig, find_flashes, flash_walls
from estimator.threads import one_blas_thread
from estimator.waveform import OfdmGrid, frequency_response

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ExtractConfig", "Progress", "extract", "extract_epochs", "paths_of", "sense_sweeps"]

Complex = NDArray[np.complex128]
_LEAST_BATCH = 8  # channels of many antennas are long enough by themselves
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
    diffuse : DiffuseConfig, optional
        Delays with the diffuse tail of each channel instead, of one antenna and one snapshot: for measured
        channels.
    """

    nomp: NompConfig = field(default_factory=NompConfig)
    flash: FlashConfig = field(default_factory=FlashConfig)
    batch: int = 64
    diffuse: DiffuseConfig | None = None

    def __post_init__(self) -> None:
        if self.batch < 1:
            raise ConfigurationError(f"batch: expected at least 1, got {self.batch}")


def extract(
    dataset: Dataset,
    config: ExtractConfig | None = None,
    progress: Progress | None = None,
    parts: Parts | None = None,
) -> MeasurementSet:
    """Estimate all delays and sense the walls in all sweeps.

    Parameters
    ----------
    dataset : Dataset
        What ``hapslam trace`` wrote, or any dataset of that form.
    config : ExtractConfig, optional
        Settings; they are recorded in the result.
    progress : callable, optional
        See :data:`Progress`.
    parts : Parts, optional
        Where what is done is kept, and what is done already.

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
    sweeps = sense_sweeps(dataset, settings.flash, progress, parts)
    epochs = extract_epochs(dataset, settings.nomp, settings.batch, progress, parts, settings.diffuse)
    strayed = sweeps.keys() - {epoch.index for epoch in epochs}
    if strayed:
        raise FileFormatError(
            f"{dataset.path}: expected beam sweeps at epochs with channels, got one at epoch {min(strayed)}"
        )
    first = epochs[0].index  # where the agent stands at the reference point
    epochs = tuple(
        replace(epoch, sweep=sweeps.get(epoch.index, ())) if epoch.index != first else epoch
        for epoch in epochs
    )
    speed = dataset.manifest.get("agent", {}).get("max_speed_m_s")
    return MeasurementSet(
        anchors=tuple(str(name) for name in _entry(dataset.manifest, "anchors", "manifest")),
        walls=sweeps.get(first, ()),
        epochs=epochs,
        carrier_hz=float(_entry(radio, "carrier_hz", "radio")),
        settings={
            "extract": asdict(settings),
            "name": dataset.manifest.get("name"),
            "seed": dataset.manifest.get("seed"),
            "radio": dict(radio),
        },
        max_speed_m_s=None if speed is None else float(speed),
        echo_bias_std_m=settings.flash.common_range_std_m,
    )


@one_blas_thread()
def extract_epochs(
    dataset: Dataset,
    config: NompConfig | None = None,
    batch: int = 64,
    progress: Progress | None = None,
    parts: Parts | None = None,
    diffuse: DiffuseConfig | None = None,
) -> tuple[Epoch, ...]:
    """Delays of all anchors in all epochs, and directions of arrival where the agent's array tells them.

    Parameters and errors are those of :func:`extract`. Where the manifest describes no array, the
    channels of the agent's first antenna are used.
    """
    radio = _section(dataset.manifest, "radio")
    array = _agent_array(radio)
    grid = _grid(radio, "radio")
    plan = NompPlan(grid, config, array) if diffuse is None else DiffusePlan(grid, diffuse)
    if diffuse is not None and array is not None:
        raise ConfigurationError(
            f"diffuse: expected channels of one antenna, to estimate a tail, got {array.elements}"
        )
    antennas = 1 if array is None else array.elements
    heading_held = radio.get("agent_array", {}).get("orientation", "fixed") == "fixed"
    batch = max(min(batch, _LEAST_BATCH), batch // antennas)
    noise_variance = float(_entry(radio, "noise_variance", "radio"))
    anchors = len(_entry(dataset.manifest, "anchors", "manifest"))
    total = int(_entry(dataset.manifest, "epochs", "manifest")) * anchors
    kept = KeptEpochs(dataset, "passive", parts)
    epochs = kept.epochs
    for shard in dataset.shards("passive", kept.shards):
        cfr = _channels(shard, plan.grid, antennas)
        if (cfr.shape[1], *cfr.shape[3:]) != (anchors, antennas, plan.grid.tones):
            raise FileFormatError(
                f"{dataset.path}: expected channels of {anchors} anchors and {plan.grid.tones} tones"
                + (f" at {antennas} antennas" if array is not None else "")
                + f", as the manifest says, got {cfr.shape[1]} and {cfr.shape[4]}"
                + (f" at {cfr.shape[3]}" if array is not None else "")
            )
        estimates: list[DelayEstimate] = []
        rows = cfr.reshape(-1, *(cfr.shape[2:] if array is not None else cfr[:, :, :, 0].shape[2:]))
        if diffuse is not None:
            if rows.shape[1] != 1:
                raise ConfigurationError(f"diffuse: expected one snapshot of a channel, got {rows.shape[1]}")
            rows = rows[:, 0]
        for start in range(0, len(rows), batch):
            estimates += plan.estimate(rows[start : start + batch], noise_variance)
            if progress is not None:
                progress(len(epochs) * anchors + len(estimates), total, "estimating delays")
        epochs += _epochs(shard, [paths_of(found, array) for found in estimates], anchors, heading_held)
        kept.shard_done()
    if not epochs:
        raise FileFormatError(f"{dataset.path}: expected passive channels, the manifest lists none")
    return tuple(epochs)


def _channels(shard: xr.Dataset, grid: OfdmGrid, antennas: int) -> Complex:
    """CFRs (epoch, anchor, snapshot, antenna, tone); from impulse responses if it holds no others.

    Snapshots of a path share delay and direction, and so do the antennas of an anchor with an
    array, whose channels follow each other as further snapshots.
    """
    looks = [axis for axis in ("snapshot", "anchor_antenna") if axis in shard.dims]
    links = ("epoch", "anchor", *looks, "antenna")
    used = shard.isel(antenna=slice(1)) if antennas == 1 and "antenna" in shard.dims else shard
    if "cir_re" in shard and "cfr_re" not in shard:
        cir = _complex(used, "cir", "passive", (*links, "tap"))
        cfr = frequency_response(cir, grid) if cir.shape[-1] == grid.tones else cir
    else:
        cfr = _complex(used, "cfr", "passive", (*links, "tone"))
    snapshots = int(np.prod(cfr.shape[2:-2], dtype=np.int64))
    return cfr.reshape(*cfr.shape[:2], snapshots, *cfr.shape[-2:])


@one_blas_thread()
def sense_sweeps(
    dataset: Dataset,
    config: FlashConfig | None = None,
    progress: Progress | None = None,
    parts: Parts | None = None,
) -> dict[int, tuple[GaussianVrp, ...]]:
    """Walls that each beam sweep saw, by its epoch: relative to the agent there, in its axes.

    Parameters and errors are those of :func:`extract`; a dataset without echoes has no sweeps.
    """
    kept = KeptEpochs(dataset, "echo", parts)
    silent = tuple(AnchorPaths.none() for _ in _entry(dataset.manifest, "anchors", "manifest"))
    files = sum(1 for entry in dataset.manifest.get("shards", ()) if entry.get("kind") == "echo")
    for shard in dataset.shards("echo", kept.shards):
        section = _section(dataset.manifest, "echo")
        grid, beams = _grid(section, "echo"), _beams(section)
        noise_variance = float(_entry(section, "noise_variance", "echo"))
        echoes = _complex(shard, "echo", "echo", ("sweep", "beam", "tone"))
        if echoes.shape[1:] != (beams.beams, grid.tones):
            raise FileFormatError(
                f"{dataset.path}: expected an echo of {beams.beams} beams and {grid.tones} tones, "
                f"as the manifest says, got {echoes.shape[1]} and {echoes.shape[2]}"
            )
        for epoch, echo in zip(shard["sweep_epoch"].values, echoes, strict=True):
            if section.get("model") == "radar-equation":  # every beam hears its wall, and nothing flashes
                walls = walls_of_beams(echo, noise_variance, grid, beams)
            else:
                walls = flash_walls(find_flashes(echo, noise_variance, grid, beams, config))
            kept.epochs.append(Epoch(int(epoch), float(epoch), silent, walls))
        kept.shard_done()
        if progress is not None:
            progress(kept.shards, files, "sensing walls")
    return {epoch.index: epoch.sweep for epoch in kept.epochs}


def paths_of(estimate: DelayEstimate, array: AntennaArray | None = None) -> AnchorPaths:
    """The measurements that an estimate is: delays, gains (mean power of several snapshots), and azimuths.

    Azimuths are there if the array tells all of them apart.

    Parameters
    ----------
    estimate : DelayEstimate
        Paths of one channel.
    array : AntennaArray, optional
        The agent's antennas, in its axes.
    """
    power = np.mean(np.abs(np.atleast_2d(estimate.gain)) ** 2, axis=0)
    std, gain_db = np.sqrt(estimate.variance_s2), 10.0 * np.log10(power)
    if array is None or estimate.directions is None or not array.tells_azimuth:
        return AnchorPaths(estimate.delay_s, std, gain_db)
    found = estimate.directions
    return AnchorPaths(estimate.delay_s, std, gain_db, found.azimuth_rad, found.azimuth_std_rad)


def _epochs(shard: xr.Dataset, paths: list[AnchorPaths], anchors: int, heading_held: bool) -> Iterator[Epoch]:
    """Epochs of a shard from the paths in its channels, anchor by anchor within an epoch."""
    times, moved = shard["time_s"].values, odometry_of(shard)
    for i, index in enumerate(shard["epoch"].values):
        heard = tuple(paths[i * anchors : (i + 1) * anchors])
        yield Epoch(int(index), float(times[i]), heard, heading_held=heading_held, odometry=moved[i])


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


def _agent_array(radio: Mapping[str, Any]) -> AntennaArray | None:
    """The agent's array, if the manifest describes one with more than one antenna side by side."""
    if "agent_array" not in radio:
        return None
    section = _section(radio, "agent_array")
    columns, rows = int(_entry(section, "elements", "radio.agent_array")), int(section.get("rows", 1))
    spacing = float(_entry(section, "spacing_wavelengths", "radio.agent_array"))
    boresight = float(_entry(section, "boresight_rad", "radio.agent_array"))
    if columns == 1:
        return None
    if rows == 1:
        return UniformLinearArray(columns, spacing, boresight)
    row_spacing, lying = float(section.get("row_spacing_wavelengths", 0.5)), bool(section.get("lying", False))
    return UniformPlanarArray(rows, columns, row_spacing, spacing, boresight, lying)


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
