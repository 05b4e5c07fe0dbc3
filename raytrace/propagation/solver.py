"""One call of Sionna's path solver: points in, a list of paths out.

The targets are the elements of one receive array, the source that of a transmit array,
and positions travel as data: the kernels that Dr.Jit compiles for one set of points
then serve every other of the same size. (The position of a device, set as three numbers,
becomes part of the kernel's code, which is then compiled anew for each.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.propagation.paths import NO_INTERACTION, NO_SURFACE, PathList
from raytrace.propagation.scene import RadioScene

__all__ = ["Bends", "solve"]

# Paths that a call can hold; memory is about 0.2 kB each, and what does not fit is lost.
_MOST_PATHS = 200_000
# Of no effect on specular paths, which involve no chance; fixes where diffuse ones scatter.
_SEED = 1


@dataclass(frozen=True)
class Bends:
    """What a path may do besides reflection: pass walls, or turn around corners and free edges."""

    refraction: bool = False
    diffraction: bool = False
    edge_diffraction: bool = False


def solve(
    radio: RadioScene,
    source_m: NDArray[np.float64],
    targets_m: NDArray[np.float64],
    *,
    depth: int,
    samples: int,
    los: bool = True,
    diffuse: bool = False,
    polarised: bool = False,
    bends: Bends | None = None,
    most_paths: int = _MOST_PATHS,
) -> PathList:
    """Trace paths from one source to every target.

    Parameters
    ----------
    radio : RadioScene
        Scene, at its carrier.
    source_m, targets_m : ndarray, shapes (3,) and (n, 3)
        End points in the plan, metres; ``PathList.epoch`` counts the targets, and
        ``PathList.anchor`` is 0.
    depth : int
        Most bounces.
    samples : int
        Rays shot from the source.
    los : bool
        Whether to include the line of sight.
    diffuse : bool
        Trace diffuse reflections alone (all rays go into them) in place of specular ones.
    polarised : bool
        Compute ``PathList.transfer``, the gains between all polarisations.
    bends : Bends, optional
        Whether to trace paths through walls and around corners, too; by default neither.
    most_paths : int
        Most paths to all targets together; further ones are lost.

    Returns
    -------
    PathList
        In no particular order. In a stretched scene delays, directions and gains are those of the
        stretched paths; surfaces are the same.
    """
    paths = _sionna_paths(
        radio,
        radio.placed(source_m),
        radio.placed(targets_m),
        depth,
        samples,
        los,
        diffuse,
        most_paths,
        "VH" if polarised else "V",
        bends or Bends(),
    )
    return _path_list(radio, paths, depth)


def _sionna_paths(
    radio: RadioScene,
    source_m: NDArray[np.float64],
    targets_m: NDArray[np.float64],
    depth: int,
    samples: int,
    los: bool,
    diffuse: bool,
    most_paths: int,
    polarization: str = "V",
    bends: Bends = Bends(),
) -> Any:
    import sionna.rt as rt

    scene = radio.scene
    for device in (*scene.transmitters, *scene.receivers):
        scene.remove(device)
    wavelength = SPEED_OF_LIGHT_M_S / radio.carrier_hz
    scene.tx_array = _array(source_m[None] / wavelength, polarization)
    scene.rx_array = _array(targets_m / wavelength, polarization)
    scene.add([rt.Transmitter("source", [0.0, 0.0, 0.0]), rt.Receiver("targets", [0.0, 0.0, 0.0])])
    return rt.PathSolver()(
        scene,
        max_depth=depth,
        samples_per_src=samples,
        max_num_paths_per_src=most_paths,
        synthetic_array=False,
        los=los,
        specular_reflection=not diffuse,
        diffuse_reflection=diffuse,
        refraction=bends.refraction,
        diffraction=bends.diffraction,
        edge_diffraction=bends.edge_diffraction,
        seed=_SEED,
    )


def _array(positions: NDArray[np.float64], polarization: str) -> Any:
    """Isotropic elements at positions (n, 3) in wavelengths, in each of some polarisations."""
    import mitsuba as mi
    import sionna.rt as rt
    from sionna.rt.antenna_pattern import antenna_pattern_registry

    pattern = antenna_pattern_registry.get("iso")(polarization=polarization)
    columns = np.ascontiguousarray(positions.T, dtype=np.float32)
    return rt.AntennaArray(pattern, mi.Point3f(*(mi.Float(column) for column in columns)))


def _path_list(radio: RadioScene, paths: Any, depth: int) -> PathList:
    """Sionna's tensors as one row per path.

    Their axes are (rx, polarisation x target, tx, polarisation of the one source, path).
    """
    modes = int(paths.valid.shape[3])

    def by_mode(tensor: Any) -> NDArray[Any]:  # (received, target, sent, path)
        whole = tensor.numpy()[0, :, 0]
        return np.asarray(whole.reshape(modes, whole.shape[0] // modes, *whole.shape[1:]))

    valid = by_mode(paths.valid)[0, :, 0]  # (target, path)
    target, _ = np.nonzero(valid)

    def pick(tensor: Any) -> NDArray[np.float64]:
        return np.asarray(by_mode(tensor)[0, :, 0][valid], dtype=np.float64)

    delay = pick(paths.tau)
    real, imaginary = (
        np.moveaxis(by_mode(part), (0, 2), (-2, -1))[valid].astype(np.float64) for part in paths.a
    )
    turn = np.exp(-2j * np.pi * radio.carrier_hz * delay)
    transfer = (real + 1j * imaginary) * turn[:, None, None]  # (path, received, sent)
    if depth == 0 or not len(delay):
        walls = np.full((len(delay), max(depth, 1)), NO_SURFACE, dtype=np.int16)
        interactions = np.full(walls.shape, NO_INTERACTION, dtype=np.int8)
    else:
        targets = valid.shape[0]
        objects, primitives, kinds = (
            tensor.numpy()[:, 0, :targets, 0, 0][:, valid].T
            for tensor in (paths.objects, paths.primitives, paths.interactions)
        )
        walls, interactions = radio.surfaces(objects, primitives), kinds.astype(np.int8)
    return PathList(
        epoch=target.astype(np.int64),
        anchor=np.zeros(len(target), dtype=np.int64),
        delay_s=delay,
        amplitude=transfer[:, 0, 0],
        departure_azimuth_rad=pick(paths.phi_t),
        departure_elevation_rad=0.5 * np.pi - pick(paths.theta_t),
        arrival_azimuth_rad=pick(paths.phi_r),
        arrival_elevation_rad=0.5 * np.pi - pick(paths.theta_r),
        order=np.sum(walls != NO_SURFACE, axis=1, dtype=np.int16),
        walls=walls,
        interactions=interactions,
        transfer=transfer if modes > 1 else transfer[:, :0, :0],
    )
