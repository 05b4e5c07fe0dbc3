"""Floor plans as frozen models, metres: where walls, anchors and the agent are and how they signal.

The plan frame is right-handed, z up from the floor; azimuths count counter-clockwise
from its x axis. :mod:`raytrace.plan.files` reads, checks and writes plans.
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, model_validator

from raytrace.plan.devices import Agent, Anchor, FurtherAgent, Name, Point2
from raytrace.plan.links import Echo, Part, Radio, added
from raytrace.plan.materials import permittivity, relative_permittivity
from raytrace.plan.sound_walls import Repairs
from raytrace.plan.surfaces import Fraction, Material, ScatteringPattern, Slab, Wall
from raytrace.plan.targets import Target
from raytrace.plan.trajectory import smoothed_track, travel_azimuths
from raytrace.plan.uncertainty import Uncertainty

__all__ = [
    "Agent",
    "Anchor",
    "FloorPlan",
    "Georeference",
    "Slab",
    "Target",
    "Tracing",
    "Wall",
]

FORMAT = "hapslam-floorplan"
VERSION = 1


class Georeference(Part):
    """Where on Earth a plan lies: the point of a coordinate reference system that is the plan's (0, 0).

    ``crs`` names the system, such as ``EPSG:25832``; ``EPSG:4326`` has degrees (east, north), in which
    case the plan's axes are metres to the east and north of the origin. ``unknown`` is a drawing's own.
    """

    crs: Annotated[str, Field(min_length=1, max_length=200)] = "unknown"
    origin: Point2


class Tracing(Part):
    """How paths are searched for: bounces, rays, and which mechanisms besides specular reflection.

    ``refraction`` adds paths through walls (each wall counts as a bounce), ``diffraction``
    those around the corners at which two walls meet, ``edge_diffraction`` those around free
    ends and rims, too. Geometry proves those of the first two that bend once.

    The ``engine`` is ``sionna``, the ray tracer, or ``images``, the image method by itself: for
    specular paths alone, and where the ray tracer is not installed.
    """

    depth: Annotated[int, Field(ge=0, le=3)] = 2
    samples: Annotated[int, Field(ge=1000, le=10_000_000)] = 6_000
    diffuse: bool = True
    diffuse_samples: Annotated[int, Field(ge=100, le=1_000_000)] = 2_000
    refraction: bool = added(False)
    diffraction: bool = added(False)
    edge_diffraction: bool = added(False)
    engine: Literal["sionna", "images"] = added("sionna")

    @property
    def bends(self) -> bool:
        """Whether paths through walls or around corners are to be traced."""
        return self.refraction or self.diffraction

    @model_validator(mode="after")
    def _fits_together(self) -> Tracing:
        if self.edge_diffraction and not self.diffraction:
            raise ValueError("expected diffraction = true with edge_diffraction, got false")
        if self.engine == "images" and self.bends:
            raise ValueError('expected engine = "sionna" with refraction or diffraction, got "images"')
        return self


class FloorPlan(Part):
    """A whole plan. Build one with :func:`~raytrace.plan.files.load_floorplan`."""

    format: Literal["hapslam-floorplan"]
    version: Literal[1]
    name: Name
    description: str = ""
    walls: Annotated[tuple[Wall, ...], Field(min_length=1, strict=False)]
    floor: Slab | None = None
    ceiling: Slab | None = None
    materials: dict[str, Material] = added({})
    scattering: dict[str, Fraction] = Field(default_factory=dict)
    scattering_patterns: dict[str, ScatteringPattern] = added({})
    anchors: Annotated[tuple[Anchor, ...], Field(min_length=1, strict=False)]
    agent: Agent
    agents: Annotated[tuple[FurtherAgent, ...], Field(strict=False)] = added(())
    targets: Annotated[tuple[Target, ...], Field(strict=False)] = added(())
    radio: Radio = Radio()
    echo: Echo = Echo()
    tracing: Tracing = Tracing()
    georeference: Georeference | None = added(None)
    uncertainty: Uncertainty | None = added(None)
    _repairs: Repairs = PrivateAttr(default=Repairs())

    @property
    def repairs(self) -> Repairs:
        """What was changed in the walls when the plan was loaded."""
        return self._repairs

    def repaired(self, walls: tuple[Wall, ...], repairs: Repairs) -> FloorPlan:
        """The same with other walls, and a record of why."""
        plan = self.model_copy(update={"walls": walls})
        plan._repairs = repairs
        return plan

    @property
    def has_floor(self) -> bool:
        """Whether the floor reflects."""
        return self.floor is not None and self.floor.enabled

    @property
    def has_ceiling(self) -> bool:
        """Whether the ceiling reflects; it lies at the height of the highest wall."""
        return self.ceiling is not None and self.ceiling.enabled

    @property
    def ceiling_height_m(self) -> float:
        """Height of the highest wall, metres."""
        return max(wall.height_m for wall in self.walls)

    @property
    def surface_names(self) -> tuple[str, ...]:
        """Names of all reflecting surfaces: the walls in order, then ``floor``, then ``ceiling``.

        Their places in this tuple are the indices that traced paths use.
        """
        names = [wall.name for wall in self.walls]
        return tuple(names + ["floor"] * self.has_floor + ["ceiling"] * self.has_ceiling)

    @property
    def surface_slabs(self) -> tuple[Wall | Slab, ...]:
        """What each surface is made of, in the order of :attr:`surface_names`."""
        slabs = [slab for slab in (self.floor, self.ceiling) if slab is not None and slab.enabled]
        return (*self.walls, *slabs)

    def walls_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Both ends of every wall, two arrays of shape (walls, 2), metres."""
        ends = np.array([(wall.from_m, wall.to_m) for wall in self.walls])
        return ends[:, 0], ends[:, 1]

    def anchors_m(self) -> NDArray[np.float64]:
        """Anchor positions, shape (anchors, 3), metres."""
        return np.array([anchor.position_m for anchor in self.anchors])

    @property
    def polarised(self) -> bool:
        """Whether any antenna of the passive link is other than isotropic, vertical and upright."""
        ends = self.radio.anchor_array, self.radio.agent_array
        plain = all(end.pattern == "iso" and end.polarization == "V" for end in ends)
        return not plain or any(anchor.downtilt_deg for anchor in self.anchors)

    @property
    def has_bodies(self) -> bool:
        """Whether any target has a size: shadows, and scatters what anchors send."""
        return any(target.body_m is not None for target in self.targets)

    def by_agent(self) -> dict[str, FloorPlan]:
        """A plan of one agent for each agent, by its name; the first is called ``agent``."""
        plans = {"agent": self.model_copy(update={"agents": ()})}
        for other in self.agents:
            agent = Agent.model_validate(other.model_dump(exclude={"name"}))
            plans[other.name] = self.model_copy(update={"agent": agent, "agents": ()})
        return plans

    def track(self) -> NDArray[np.float64]:
        """The agent's positions, shape (epochs, 3), metres; row 0 is the reference point."""
        agent = self.agent
        plane = smoothed_track(agent.waypoints_m, agent.smoothing_m, agent.step_m, agent.epochs)
        return np.column_stack([plane, np.full(agent.epochs, agent.height_m)])

    def headings_rad(self) -> NDArray[np.float64]:
        """Azimuth of the agent's x axis in the plan at every epoch, shape (epochs,), radians."""
        agent = self.agent
        mounted = np.full(agent.epochs, float(np.deg2rad(agent.heading_deg)))
        return mounted if agent.orientation == "fixed" else mounted + self._travel_azimuths()

    @property
    def heading_rad(self) -> float:
        """Azimuth of the estimator's x axis in the plan: the agent's heading at the start, radians."""
        return float(self.headings_rad()[0])

    def body_azimuths_rad(self) -> NDArray[np.float64]:
        """Direction of the agent's body in the plan at every epoch, shape (epochs,), radians.

        It is that of the estimator's x axis at the start and turns as the direction of travel does.
        """
        travel = self._travel_azimuths()
        return np.asarray(self.heading_rad + travel - travel[0])

    def velocities_m_s(self) -> NDArray[np.float64]:
        """The agent's velocity at every epoch, plan frame, shape (epochs, 3), metres per second."""
        azimuth = self._travel_azimuths()
        ahead = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)])
        return np.asarray(self.agent.speed_m_s * ahead)

    def _travel_azimuths(self) -> NDArray[np.float64]:
        agent = self.agent
        return travel_azimuths(agent.waypoints_m, agent.smoothing_m, agent.step_m, agent.epochs)

    def gain_offsets_db(self) -> NDArray[np.float64]:
        """Gains beyond what the link states, as an estimated plan tells them, shape (anchors,), dB."""
        known = self.uncertainty
        return np.array([0.0 if known is None else known.gain_offset_db(a.name) for a in self.anchors])

    @property
    def sweep_epochs(self) -> tuple[int, ...]:
        """Epochs of the beam sweeps, ascending as given or every so many."""
        every = self.echo.sweep_every
        return self.echo.sweep_epochs if every is None else tuple(range(0, self.agent.epochs, every))

    def clock_errors_s(self) -> NDArray[np.float64]:
        """What the clocks add to every delay, shape (epochs, anchors), seconds: agent's less anchor's."""
        times = self.times_s()
        anchors = np.stack([anchor.clock.error_s(times) for anchor in self.anchors], axis=1)
        return np.asarray(self.agent.clock.error_s(times)[:, None] - anchors)

    def times_s(self) -> NDArray[np.float64]:
        """Time of every epoch since the first, shape (epochs,), seconds."""
        return np.arange(self.agent.epochs, dtype=np.float64) * (self.agent.step_m / self.agent.speed_m_s)

    def permittivity_of(self, material: str, frequency_hz: float) -> complex:
        """Complex relative permittivity of a material of the plan's own or of the ITU's table.

        Raises
        ------
        InputError
            If the material is unknown, or not defined at this frequency.
        """
        own = self.materials.get(material)
        if own is None:
            return permittivity(material, frequency_hz)
        return relative_permittivity(own.relative_permittivity, own.conductivity_s_m, frequency_hz)

    def scattering_of(self, material: str) -> float:
        """Scattering coefficient S of a material (zero unless the plan sets one)."""
        return self.scattering.get(material, 0.0)

    def scattering_pattern_of(self, material: str) -> ScatteringPattern:
        """Scattering pattern of a material (Lambertian unless the plan sets one)."""
        return self.scattering_patterns.get(material, ScatteringPattern())

    @property
    def scatters(self) -> bool:
        """Whether any surface of the plan scatters and scattering is to be traced."""
        return self.tracing.diffuse and any(
            self.scattering_of(slab.material) > 0 for slab in self.surface_slabs
        )

    def canonical_json(self) -> str:
        """The plan with all defaults filled in, as JSON with sorted keys."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))

    def sha256(self) -> str:
        """Hash of :meth:`canonical_json`; two spellings of one plan have the same hash."""
        return hashlib.sha256(self.canonical_json().encode("utf-8")).hexdigest()
