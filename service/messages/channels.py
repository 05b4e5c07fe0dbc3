"""What raw channels do not tell of themselves."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from estimator.arrays import AntennaArray, UniformLinearArray, UniformPlanarArray
from service.messages.fields import Request

__all__ = ["ChannelsQuery"]


class ChannelsQuery(Request):
    """What raw channels do not tell of themselves; the array in the words of a dataset's manifest."""

    noise_variance: Annotated[
        float, Field(gt=0.0, le=1e6, allow_inf_nan=False, description="Of the channels' noise, per tone.")
    ]
    elements: Annotated[int, Field(ge=2, le=1024)] | None = Field(
        None, description="Of the agent's array, in a row; without it nothing is known of several antennas."
    )
    rows: Annotated[int, Field(ge=1, le=64)] = 1
    spacing_wavelengths: Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)] = 0.5
    row_spacing_wavelengths: Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)] = 0.5
    boresight_rad: Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)] = 0.0
    lying: bool = Field(False, description="Whether rows are one ahead of, not above, the other.")
    orientation: Literal["fixed", "travel"] = Field(
        "fixed", description="Whether the agent keeps its axes or turns them with its track."
    )

    def array(self) -> AntennaArray | None:
        """The agent's array, if it was described."""
        if self.elements is None:
            return None
        if self.rows == 1:
            return UniformLinearArray(self.elements, self.spacing_wavelengths, self.boresight_rad)
        return UniformPlanarArray(
            self.rows,
            self.elements,
            self.row_spacing_wavelengths,
            self.spacing_wavelengths,
            self.boresight_rad,
            self.lying,
        )
