"""Epochs taken from the shards of a dataset, of this run and of those before it that were interrupted."""

from __future__ import annotations

from estimator.dataset import Dataset
from estimator.measurement_files import load_measurements, save_measurements
from estimator.measurements import Epoch, MeasurementSet
from estimator.parts import Parts

__all__ = ["KeptEpochs"]


class KeptEpochs:
    """Epochs of the shards that are done.

    Parameters
    ----------
    dataset : Dataset
        Whose shards.
    kind : str
        Which of them.
    parts : Parts, optional
        Where what is done is kept, and what is done already.

    Attributes
    ----------
    epochs : list of Epoch
        Those done, to which those of the next shard are added.
    shards : int
        How many shards are done.
    """

    def __init__(self, dataset: Dataset, kind: str, parts: Parts | None) -> None:
        self.epochs: list[Epoch] = []
        self.shards = 0
        self._manifest, self._kind, self._parts = dataset.manifest, kind, parts
        for part in [] if parts is None else parts.of(kind):
            self.epochs += load_measurements(part.path).epochs
            self.shards = part.done
        self._written = len(self.epochs)

    def shard_done(self) -> None:
        """Count a shard whose epochs have been added, and keep what is new if it is time."""
        self.shards += 1
        if self._parts is not None and self._parts.due:
            anchors = tuple(str(name) for name in self._manifest["anchors"])
            new = MeasurementSet(anchors, (), tuple(self.epochs[self._written :]), 1.0)
            self._parts.keep(self._kind, self.shards, lambda path: save_measurements(new, path))
            self._written = len(self.epochs)
