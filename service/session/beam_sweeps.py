"""Active sensing in the service: raw beam sweeps and reflection points become walls, in a worker process.

What the log keeps are the walls, as of every sweep, so that a session's state stays the fold of
its log.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimator.arrays import BeamSet
from estimator.errors import FileFormatError, InputError
from estimator.measurements import GaussianVrp
from estimator.threads import one_blas_thread
from service.errors import ConflictError
from service.session.files import columns, evenly_spaced, read_arrays
from service.session.tasks import TaskContext

__all__ = ["EchoModel", "EchoTask", "PointsTask"]

EchoModel = Literal["flash", "beams"]
_VARIABLES = ("echo_re", "echo_im", "tone_offset_hz", "sweep_epoch")


@dataclass(frozen=True)
class PointsTask:
    """Walls through reflection points: segmentation and line fit.

    Parameters
    ----------
    range_m, range_std_m, azimuth_rad : tuple of float
        Distances from the agent, metres, their standard deviations, and directions, radians; one
        entry a beam, in any order.
    """

    range_m: tuple[float, ...]
    range_std_m: tuple[float, ...]
    azimuth_rad: tuple[float, ...]

    @one_blas_thread()
    def run(self, context: TaskContext) -> tuple[GaussianVrp, ...]:
        """Find them, the nearest first; raises InputError if the points are too few."""
        del context
        from estimator.sensing.segmentation import segment_walls

        return segment_walls(self.range_m, self.range_std_m, self.azimuth_rad).walls


@dataclass(frozen=True)
class EchoTask:
    """Walls from the raw channels of a beam sweep.

    Parameters
    ----------
    body : bytes
        netCDF or npz with ``echo_re``, ``echo_im`` (sweep, beam, tone), ``tone_offset_hz`` and
        ``sweep_epoch``: what `hapslam trace` writes as an echo shard. The first sweep counts.
    carrier_hz : float
        Carrier frequency.
    noise_variance : float
        Variance of the channels' noise per tone.
    beams : BeamSet
        The agent's beams.
    model : str
        ``"flash"``: walls return what meets them at normal incidence; ``"beams"``: every beam hears the
        wall that it looks at.
    max_unpacked_bytes : int
        Most that the file may unpack to.
    """

    body: bytes
    carrier_hz: float
    noise_variance: float
    beams: BeamSet
    model: EchoModel
    max_unpacked_bytes: int

    @one_blas_thread()
    def run(self, context: TaskContext) -> tuple[GaussianVrp, ...]:
        """Read the file and look for walls.

        Raises
        ------
        FileFormatError
            If the file is not what was expected.
        InputError
            If the channels are not finite.
        ConflictError
            If the sweep is not of epoch 0, where the agent stands at the reference point.
        """
        del context
        from estimator.sensing.beam_ranges import walls_of_beams
        from estimator.sensing.flash import find_flashes, flash_walls

        data = columns(read_arrays(self.body, self.max_unpacked_bytes, _VARIABLES))
        real, imaginary = data["echo_re"], data["echo_im"]
        grid = evenly_spaced(data["tone_offset_hz"], self.carrier_hz)
        wanted = (self.beams.beams, grid.tones)
        if real.ndim != 3 or not len(real) or real.shape[1:] != wanted or real.shape != imaginary.shape:
            raise FileFormatError(
                f"echo_re, echo_im: expected shape (sweeps, {wanted[0]}, {wanted[1]}), "
                f"got {real.shape} and {imaginary.shape}"
            )
        if data["sweep_epoch"].shape != real.shape[:1]:
            raise FileFormatError(f"sweep_epoch: expected {len(real)} epochs, one a sweep")
        if data["sweep_epoch"][0] != 0:
            raise ConflictError(
                f"sweep_epoch: expected a sweep of epoch 0 first, got one of {data['sweep_epoch'][0]}"
            )
        echo = real[0] + 1j * imaginary[0]
        if not np.all(np.isfinite(echo)):
            raise InputError("echo_re, echo_im: expected finite channels")
        if self.model == "beams":
            return walls_of_beams(echo, self.noise_variance, grid, self.beams)
        return flash_walls(find_flashes(echo, self.noise_variance, grid, self.beams))
