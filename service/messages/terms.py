"""What a session's configuration says that its epochs are read by: names of anchors, identities of TRPs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = ["SessionTerms"]

_NEAREST_M = 10.0  # what the earliest pseudo-range of an epoch is taken to be: any length, the clock is free


@dataclass(frozen=True)
class SessionTerms:
    """The terms of a session.

    Parameters
    ----------
    anchors : tuple of str
        Names of the anchors.
    trp_ids, dl_prs_ids : tuple of int
        What NRPPa (``tRP-ID``) and LPP (``dl-PRS-ID-r16``) call them; empty if the session does not say.
    eirp_dbm : tuple of float
        Their radiated powers, with which received powers become gains; empty if the session does not say.
    free_clock : bool
        Whether a clock error common to all anchors is free in every epoch, so that time differences do.
    """

    anchors: tuple[str, ...]
    trp_ids: tuple[int, ...] = ()
    dl_prs_ids: tuple[int, ...] = ()
    eirp_dbm: tuple[float, ...] = ()
    free_clock: bool = False

    @classmethod
    def of(cls, config: Mapping[str, Any]) -> SessionTerms:
        """The terms that a session's configuration states."""
        nr = config.get("nr") or {}
        return cls(
            tuple(config["anchors"]),
            tuple(nr.get("trp_ids") or ()),
            tuple(nr.get("dl_prs_ids") or ()),
            tuple(nr.get("eirp_dbm") or ()),
            nr.get("clock") == "free",
        )

    def eirp(self, place: int) -> float | None:
        """Radiated power of an anchor, dBm."""
        return self.eirp_dbm[place] if self.eirp_dbm else None

    def pseudorange_bias_s(self, arrivals_s: Sequence[float]) -> float | None:
        """What makes times of arrival of an epoch times of flight, but for the clock's error, seconds.

        None where the clocks are taken to agree.
        """
        if not self.free_clock or not arrivals_s:
            return None
        return _NEAREST_M / SPEED_OF_LIGHT_M_S - min(arrivals_s)
