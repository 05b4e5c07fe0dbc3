"""The rows of a run held against those of an earlier one, as far as the machine's own unrest lets them be.

Before every row a small NumPy operation is timed, in both runs. Times are compared in units of it, so that
a slower machine, or a busy minute, is no slower code; how much the operation itself varied in either run says
how far a ratio may be from one by chance: the noise band. Sizes are compared as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimator.errors import FileFormatError

__all__ = ["Compared", "Comparison", "ComparisonConfig"]

_TIMES = frozenset({"s", "ms", "us"})


@dataclass(frozen=True)
class ComparisonConfig:
    """What counts as noise.

    Parameters
    ----------
    deviations : float
        Half width of the band in standard deviations of the logarithm of a ratio.
    least_std : float
        Relative standard deviation of a time from run to run on a machine at rest, caches and placement of
        memory included.
    size_std : float
        The same of a size in memory or on disk.
    """

    deviations: float = 3.0
    least_std: float = 0.07
    size_std: float = 0.05


@dataclass(frozen=True)
class Compared:
    """A row beside an earlier one.

    Parameters
    ----------
    ratio : float
        Now over then, times in units of the small operation.
    low, high : float
        The noise band.
    """

    ratio: float
    low: float
    high: float

    @property
    def beyond(self) -> bool:
        """Whether it is worse than noise explains."""
        return self.ratio > self.high

    def __str__(self) -> str:
        side = "worse" if self.beyond else "better" if self.ratio < self.low else "same"
        return f"x {self.ratio:.2f} ({self.low:.2f} to {self.high:.2f}): {side}"


class Comparison:
    """An earlier run, to hold rows against.

    Parameters
    ----------
    document : mapping
        What ``hapslam bench --json`` printed.
    quick : bool
        Whether the run now is a quick one; both have to be.
    config : ComparisonConfig, optional
        What counts as noise.

    Raises
    ------
    FileFormatError
        If the document is none of the bench's, or of the other kind.
    """

    def __init__(
        self, document: Mapping[str, Any], quick: bool, config: ComparisonConfig | None = None
    ) -> None:
        self._config = config or ComparisonConfig()
        try:
            if bool(document["quick"]) != quick:
                kind = "a quick run" if quick else "a run in full"
                raise FileFormatError(f"compare: expected {kind}, got the other kind")
            self._before = {
                str(row["name"]): (float(row["value"]), float(row["small_operation_us"]))
                for row in document["rows"]
            }
        except (KeyError, TypeError, ValueError) as error:
            raise FileFormatError(
                f"compare: expected what `hapslam bench --json` printed, got {error!r}"
            ) from error

    def unrest(self, operations_us: Sequence[float]) -> float:
        """Relative standard deviation of a ratio of times, given the small operation before each row now.

        The scatter of the middle half of each run counts, so that one interruption does not widen the band.
        """
        before = [operation for _, operation in self._before.values()]
        scatter = [max(_scatter(run), self._config.least_std) for run in (before, operations_us)]
        return math.hypot(*scatter)

    def of(self, name: str, unit: str, value: float, operation_us: float, unrest: float) -> Compared | None:
        """A row beside the earlier one of its name; None if there was none, or it was zero."""
        then, operation_then = self._before.get(name, (0.0, 1.0))
        if then <= 0.0:
            return None
        timed = unit in _TIMES
        ratio = value / then * (operation_then / operation_us if timed else 1.0)
        std = unrest if timed else math.sqrt(2.0) * self._config.size_std
        width = math.exp(self._config.deviations * std)
        return Compared(ratio, 1.0 / width, width)


def _scatter(values: Sequence[float]) -> float:
    """Standard deviation of the logarithms, from their quartiles."""
    if len(values) < 4:
        return 0.0
    low, high = np.quantile(np.log(values), (0.25, 0.75))
    return float(high - low) / 1.349
