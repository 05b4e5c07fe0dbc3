"""How a dataset is cut and what it holds: part of its configuration, recorded in its manifest."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

from estimator.errors import ConfigurationError
from raytrace.plan.floorplan import FloorPlan

__all__ = ["CONTENTS", "Output"]

CONTENTS = ("cfr", "cir", "both")
_MOST_EPOCHS = 1024
# Bytes that the complex channels of one shard may take while it is made.
_MOST_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Output:
    """What is written, and in which shards.

    Parameters
    ----------
    shard_epochs : int
        Epochs of a shard; 0 takes 1024, or fewer where their channels would need more
        than 64 MiB. Noise is drawn shard by shard, so equal bytes need equal shards.
    content : {"cfr", "cir", "both"}
        Whether passive channels are written as frequency responses, impulse responses
        or both.
    licence : str
        Terms under which the data may be used, for the data card.
    joints : tuple of int
        Epochs at which the dataset ended before it was appended to; a shard starts there.
    """

    shard_epochs: int = 0
    content: str = "cfr"
    licence: str = ""
    joints: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.shard_epochs < 0:
            raise ConfigurationError(
                f"shard_epochs: expected at least 1, or 0 to choose, got {self.shard_epochs}"
            )
        if self.content not in CONTENTS:
            raise ConfigurationError(f"content: expected one of {', '.join(CONTENTS)}, got {self.content!r}")

    def chosen(self, plan: FloorPlan) -> Output:
        """The same with ``shard_epochs`` chosen for a plan if it is 0."""
        if self.shard_epochs:
            return self
        radio = plan.radio
        channel = (
            16
            * radio.snapshots
            * radio.anchor_array.antennas
            * radio.agent_array.antennas
            * radio.grid().tones
        )
        fitting = _MOST_BYTES // (channel * len(plan.anchors))
        return replace(self, shard_epochs=max(1, min(_MOST_EPOCHS, fitting)))

    def ranges(self, epochs: int) -> list[tuple[int, int]]:
        """First epoch, and the one after the last, of every shard of a track of some epochs."""
        return [
            (first, min(first + self.shard_epochs, end))
            for begin, end in pairwise((0, *self.joints, epochs))
            for first in range(begin, end, self.shard_epochs)
        ]

    def as_dict(self) -> dict[str, Any]:
        """JSON types, for the manifest."""
        return {**asdict(self), "joints": list(self.joints)}
