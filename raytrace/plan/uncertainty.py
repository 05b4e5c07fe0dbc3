"""How sure a floor plan is that was estimated: its ends, materials, anchors and frame."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from raytrace.plan.devices import Name
from raytrace.plan.links import Count, Finite, NonNegative, Part

__all__ = ["AnchorUncertainty", "EndKind", "ObstacleUncertainty", "Uncertainty", "WallUncertainty"]

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
EndKind = Literal["corner", "open", "assumed"]


class WallUncertainty(Part):
    """Of one wall, by its name: what its ends are, how well they and its material are known.

    An end is a ``corner`` where another wall is met; ``open`` where the wall was seen to stop or nothing is
    known of how it goes on; ``assumed`` where a wall that nobody saw is taken to join it. Deviations of
    ends are left out
    where they were not observed.
    ``bounces`` tell the material; it is ``resolved`` where many of them arrived apart from all other paths.
    """

    wall: Name
    from_end: EndKind = "corner"
    to_end: EndKind = "corner"
    from_std_m: NonNegative | None = None
    to_std_m: NonNegative | None = None
    assumed: bool = False
    bounces: Annotated[int, Field(ge=0)] = 0
    resolved: bool = False
    material_probabilities: dict[str, Probability] = Field(default_factory=dict)


class AnchorUncertainty(Part):
    """Of one anchor, by its name: deviations of place and height, and its gain beyond the link's."""

    anchor: Name
    position_std_m: NonNegative
    height_std_m: NonNegative
    gain_offset_db: Finite = 0.0
    gain_offset_std_db: NonNegative | None = None


class ObstacleUncertainty(Part):
    """Of one obstacle: the names of its walls, and the probability that it is there."""

    walls: Annotated[tuple[Name, ...], Field(min_length=1, strict=False)]
    existence: Probability


class Uncertainty(Part):
    """Of a plan that was estimated, in the estimator's frame: RP is its origin.

    ``rotation_std_rad`` is the standard deviation of the plan's rotation about RP, ``epochs`` how many it
    rests on.
    """

    rotation_std_rad: NonNegative = 0.0
    epochs: Count = 1
    walls: Annotated[tuple[WallUncertainty, ...], Field(strict=False)] = ()
    anchors: Annotated[tuple[AnchorUncertainty, ...], Field(strict=False)] = ()
    obstacles: Annotated[tuple[ObstacleUncertainty, ...], Field(strict=False)] = ()

    def gain_offset_db(self, anchor: str) -> float:
        """An anchor's gain beyond what the link states, dB; 0 of one that is not listed."""
        return next((entry.gain_offset_db for entry in self.anchors if entry.anchor == anchor), 0.0)
