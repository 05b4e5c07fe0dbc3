"""Raw channels in the service: their delays and directions become epochs, in a worker process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import AntennaArray
from estimator.errors import FileFormatError, InputError
from estimator.measurements import Epoch
from estimator.threads import one_blas_thread
from estimator.waveform import OfdmGrid
from service.session.entries import EpochEntry, EpochLimits, entries_of
from service.session.files import columns, evenly_spaced, read_arrays
from service.session.tasks import TaskContext

__all__ = ["ChannelsTask"]

_BATCH, _LEAST_BATCH = 64, 8  # channels estimated together
_VARIABLES = ("cfr_re", "cfr_im", "time_s", "epoch", "anchor", "tone_offset_hz")


@dataclass(frozen=True)
class ChannelsTask:
    """Estimate the paths in raw channels, from all antennas and snapshots together.

    Parameters
    ----------
    body : bytes
        netCDF or npz with ``cfr_re``, ``cfr_im`` (epoch, anchor, [snapshot,] [anchor antenna,] antenna,
        tone), ``time_s``, ``epoch``, ``anchor`` (names) and ``tone_offset_hz`` (ascending, evenly spaced).
    anchors : tuple of str
        The session's anchors.
    carrier_hz : float
        Carrier frequency.
    noise_variance : float
        Variance of the channels' noise per tone.
    array : AntennaArray or None
        The agent's antennas, in its axes; where nothing is known of them, paths have the same delays at
        all of them and nothing else in common.
    heading_held : bool
        Whether the agent keeps its axes, so that directions of arrival tell of the map.
    max_unpacked_bytes : int
        Most that the file may unpack to.
    limits : EpochLimits
        How much a request may bring.
    """

    body: bytes
    anchors: tuple[str, ...]
    carrier_hz: float
    noise_variance: float
    array: AntennaArray | None
    heading_held: bool
    max_unpacked_bytes: int
    limits: EpochLimits

    @one_blas_thread()
    def run(self, context: TaskContext) -> tuple[EpochEntry, ...]:
        """Read the file and estimate; raises FileFormatError or InputError."""
        del context
        from estimator.channel.nomp import NompPlan  # of the workers alone: the server starts sooner
        from estimator.extract import paths_of

        channels = self._read()
        self.limits.check_count(len(channels.epoch))
        plan = NompPlan(channels.grid, array=self.array)
        rows = channels.cfr.reshape(-1, *channels.cfr.shape[2:])
        batch = max(_LEAST_BATCH, _BATCH // int(np.prod(rows.shape[1:-1])))
        found = [
            paths_of(estimate, self.array)
            for first in range(0, len(rows), batch)
            for estimate in plan.estimate(rows[first : first + batch], self.noise_variance)
        ]
        count = len(self.anchors)
        epochs = (
            Epoch(
                int(index),
                float(time_s),
                tuple(found[i * count : (i + 1) * count]),
                heading_held=self.heading_held,
            )
            for i, (index, time_s) in enumerate(zip(channels.epoch, channels.time_s, strict=True))
        )
        return entries_of(epochs, self.limits)

    def _read(self) -> _Channels:
        """The file's content, checked; anchors in the session's order."""
        data = columns(read_arrays(self.body, self.max_unpacked_bytes, _VARIABLES))
        real, imaginary, epoch, time_s = (data[name] for name in ("cfr_re", "cfr_im", "epoch", "time_s"))
        if real.shape != imaginary.shape:
            raise FileFormatError(f"cfr_im: expected shape {real.shape} as cfr_re, got {imaginary.shape}")
        names = [str(name) for name in data["anchor"].ravel()]
        grid = evenly_spaced(data["tone_offset_hz"], self.carrier_hz)
        outer, shape = (len(epoch), len(self.anchors)), real.shape
        antennas = "antennas" if self.array is None else self.array.elements
        if (
            len(shape) not in (4, 5, 6)
            or (shape[:2], shape[-1]) != (outer, grid.tones)
            or 0 in shape
            or (self.array is not None and shape[-2] != self.array.elements)
        ):
            raise FileFormatError(
                f"cfr: expected shape ({outer[0]}, {outer[1]}, [snapshots,] [anchor antennas,] {antennas}, "
                f"{grid.tones}), got {shape}"
            )
        if sorted(names) != sorted(self.anchors):
            raise InputError(f"anchor: expected {', '.join(self.anchors)}, got {', '.join(names[:20])}")
        if time_s.shape != epoch.shape or not np.all(np.isfinite(time_s)):
            raise FileFormatError("time_s: expected a finite time for each epoch")
        if np.any(epoch < 0) or np.any(epoch > 2**31 - 2):
            raise FileFormatError("epoch: expected numbers from 0 on")
        cfr = (real + 1j * imaginary)[:, [names.index(name) for name in self.anchors]]
        looks = (-1,) if self.array is None else (-1, self.array.elements)
        return _Channels(cfr.reshape(*outer, *looks, grid.tones), epoch, time_s, grid)


@dataclass(frozen=True)
class _Channels:
    """``cfr`` (epoch, anchor, look, [antenna,] tone): looks at the same delays and directions."""

    cfr: NDArray[np.complex128]
    epoch: NDArray[np.int64]
    time_s: NDArray[np.float64]
    grid: OfdmGrid
