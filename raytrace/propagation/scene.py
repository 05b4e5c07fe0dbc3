"""A floor plan as a scene of Sionna RT.

Surfaces of one material and thickness share one mesh (a solve costs time per object,
not per wall); which wall a triangle belongs to follows from its number. For diffraction,
walls of one mesh that meet share the vertices of the corner. Geometry is that of
:func:`raytrace.propagation.reflectors.surfaces_of`. Call :func:`raytrace.propagation.backend.prepare`
before; this module imports the ray tracer when its functions run.

Specular paths are looked for in a scene that is stretched upwards until it is as high as it is wide.
Mirrors that stand or lie send an image the same way in both, so every path has its counterpart, with
bounces on the same surfaces; but of rays shot in all directions many times as many meet the walls.

The tracer is single precision: at a kilometre from its origin it knows a wall to a tenth of a
millimetre, at UTM's distances to half a metre. So the scene is the plan moved near the origin
(:attr:`RadioScene.origin_m`); paths are the same wherever a plan lies.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytrace.plan.floorplan import FloorPlan, Slab, Wall
from raytrace.propagation.backend import prepare
from raytrace.propagation.paths import NO_SURFACE
from raytrace.propagation.reflectors import surfaces_of

__all__ = ["RadioScene", "build_scene"]

_TRIANGLES = ((0, 1, 2), (0, 2, 3))
# Origins are multiples of a power of two, so that moving a plan loses no bit, and those near 0 stay.
_ORIGIN_GRID_M = 256.0


@dataclass(frozen=True, eq=False)
class RadioScene:
    """A scene that can be traced, and the way back from triangles to surfaces.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    scene : sionna.rt.Scene
        Its scene at one carrier, without transmitters and receivers.
    carrier_hz : float
        This carrier, hertz.
    surfaces_by_object : dict of int to ndarray of int16
        For each object's identity, the surface (an index of
        ``FloorPlan.surface_names``) of every pair of triangles.
    stretch : float
        Heights in the scene over those in the plan.
    origin_m : ndarray, shape (3,)
        Point of the plan that is the scene's origin, metres.
    """

    plan: FloorPlan
    scene: Any
    carrier_hz: float
    surfaces_by_object: dict[int, NDArray[np.int16]]
    stretch: float = 1.0
    origin_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def placed(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the plan, shape (..., 3), in the scene."""
        return np.asarray((points_m - self.origin_m) * np.array([1.0, 1.0, self.stretch]))

    @cached_property
    def tall(self) -> RadioScene:
        """The same, stretched until it is as high as it is wide, if it is not; built when first asked for."""
        width = np.ptp(np.vstack(self.plan.walls_m()), axis=0).max()
        height = max(wall.height_m for wall in self.plan.walls)
        return build_scene(self.plan, self.carrier_hz, stretch=max(1.0, float(width / height)))

    def surfaces(self, objects: NDArray[np.uint32], primitives: NDArray[np.uint32]) -> NDArray[np.int16]:
        """Surfaces that paths met, of any shape; ``NO_SURFACE`` where there was no bounce."""
        found = np.full(objects.shape, NO_SURFACE, dtype=np.int16)
        for identity, surfaces in self.surfaces_by_object.items():
            mine = objects == identity
            found[mine] = surfaces[primitives[mine] // len(_TRIANGLES)]
        return found


def build_scene(plan: FloorPlan, carrier_hz: float, stretch: float = 1.0) -> RadioScene:
    """Build the scene of a plan at one carrier frequency, with all heights multiplied by ``stretch``.

    Raises
    ------
    BackendError
        If the ray tracer cannot run on this machine.
    """
    prepare()
    import drjit as dr
    import mitsuba as mi
    import sionna.rt as rt

    origin = _origin(plan)
    corners = (surfaces_of(plan).corners() - origin) * np.array([1.0, 1.0, stretch])
    groups: dict[tuple[str, float], list[int]] = {}
    for index, slab in enumerate(plan.surface_slabs):
        groups.setdefault((slab.material, slab.thickness_m), []).append(index)

    scene = rt.Scene()
    scene.frequency = dr.opaque(mi.Float, carrier_hz)
    objects = []
    for number, members in enumerate(groups.values()):
        slab = plan.surface_slabs[members[0]]
        name = f"slab-{number}"
        objects.append(
            rt.SceneObject(
                mi_mesh=_mesh(name, corners[members]),
                name=name,
                radio_material=_material(plan, slab, number),
                remove_duplicate_vertices=plan.tracing.diffraction,
            )
        )
    scene.add(objects)
    members_of = {
        scene.objects[f"slab-{number}"].object_id: np.array(members, dtype=np.int16)
        for number, members in enumerate(groups.values())
    }
    return RadioScene(plan, scene, carrier_hz, members_of, stretch, origin)


def _origin(plan: FloorPlan) -> NDArray[np.float64]:
    """The point of the grid of origins next to the middle of the walls, shape (3,)."""
    ends = np.vstack(plan.walls_m())
    middle = 0.5 * (ends.min(axis=0) + ends.max(axis=0))
    return np.array([*(_ORIGIN_GRID_M * np.round(middle / _ORIGIN_GRID_M)), 0.0])


def _material(plan: FloorPlan, slab: Wall | Slab, number: int) -> Any:
    import sionna.rt as rt

    common = {
        "name": f"{slab.material}-{number}",
        "thickness": slab.thickness_m,
        "scattering_coefficient": plan.scattering_of(slab.material),
        **plan.scattering_pattern_of(slab.material).parameters(),
    }
    own = plan.materials.get(slab.material)
    if own is None:
        return rt.ITURadioMaterial(itu_type=slab.material, **common)
    return rt.RadioMaterial(
        relative_permittivity=own.relative_permittivity, conductivity=own.conductivity_s_m, **common
    )


def _mesh(name: str, corners: NDArray[np.float64]) -> Any:
    """A mesh of rectangles (n, 4, 3), two triangles each."""
    import mitsuba as mi

    count = len(corners)
    faces = (4 * np.arange(count)[:, None, None] + np.array(_TRIANGLES)).reshape(-1, 3)
    mesh = mi.Mesh(name, vertex_count=4 * count, face_count=len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(corners.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    return mesh
