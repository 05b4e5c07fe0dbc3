"""Walls and slabs of a plan, materials beyond those of the ITU, and how rough ones scatter."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from raytrace.plan.devices import Name, Point2
from raytrace.plan.links import NonNegative, Part, Positive

__all__ = ["Fraction", "Material", "ScatteringPattern", "Slab", "Wall"]

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Exponent = Annotated[int, Field(ge=1, le=1000)]


class Wall(Part):
    """A vertical wall: a segment of the plan, a single flat surface with the thickness of a slab."""

    name: Name
    from_m: Point2
    to_m: Point2
    height_m: Positive = 3.0
    material: str = "concrete"
    thickness_m: Positive = 0.2


class Slab(Part):
    """A floor or a ceiling over the whole plan; a plan without one has open air there."""

    enabled: bool = True
    material: str = "concrete"
    thickness_m: Positive = 0.2


class Material(Part):
    """A material of one's own, the same at all frequencies."""

    relative_permittivity: Annotated[float, Field(ge=1.0, allow_inf_nan=False)]
    conductivity_s_m: NonNegative = 0.0


class ScatteringPattern(Part):
    """Where a rough surface scatters to; see the models of Degli-Esposti et al. (2007).

    ``lambertian`` scatters with the cosine from the normal, ``directive`` in a lobe about the
    specular direction, the narrower the larger ``alpha_r``, ``backscattering`` in two: the
    ``specular_share`` of the power in that one, the rest back to where it came from, as
    ``alpha_i`` says. ``cross_polarised`` is the share of the scattered power that changes polarisation.
    """

    pattern: Literal["lambertian", "directive", "backscattering"] = "lambertian"
    alpha_r: Exponent = 1
    alpha_i: Exponent = 1
    specular_share: Fraction = 1.0
    cross_polarised: Fraction = 0.0

    def parameters(self) -> dict[str, Any]:
        """The pattern and its parameters by Sionna RT's names."""
        lobes: dict[str, Any] = {"alpha_r": self.alpha_r} if self.pattern != "lambertian" else {}
        if self.pattern == "backscattering":
            lobes |= {"alpha_i": self.alpha_i, "lambda_": self.specular_share}
        return {"scattering_pattern": self.pattern, "xpd_coefficient": self.cross_polarised, **lobes}
