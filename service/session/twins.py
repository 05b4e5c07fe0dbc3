"""A session's twin: its estimated map as a floor plan, and the coverage that this predicts."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Row

from estimator.errors import InputError
from estimator.threads import one_blas_thread
from service.messages.documents import dump
from service.session.reads import Read, check_smoothable
from service.session.results import session_measurements, session_result
from service.session.smoothing import explained
from service.session.twin_plan import twin_of
from service.storage.store import Store

if TYPE_CHECKING:
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["CoverageRead", "TwinRead"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _TwinOf(Read):
    """A read that needs the twin.

    Parameters
    ----------
    agent_height_m : float
        Height of the agent over the floor, metres: nothing tells it.
    max_epochs : int
        Longest session that is smoothed.
    """

    agent_height_m: float
    max_epochs: int

    @one_blas_thread()
    def twin(self, store: Store, row: Row[Any], connection: Connection) -> FloorPlan:
        """The twin, in the estimator's frame.

        Raises
        ------
        ConflictError
            If there is no epoch yet.
        TooLargeError
            If there are too many.
        InputError
            If nothing can be made of them: no wall, or no anchor, or too little measured.
        """
        from estimator.slam.smoothing.refine import refine

        check_smoothable(row, self.max_epochs)
        measured = session_measurements(store, row, connection)
        with explained():
            found = refine(measured, session_result(store, row, connection))
            return twin_of(found, measured, (row.name or row.id)[:100], self.agent_height_m)


@dataclass(frozen=True)
class TwinRead(_TwinOf):
    """The twin as a floor plan, TOML."""

    def look(self, store: Store, row: Row[Any], connection: Connection) -> str:
        """The file."""
        from raytrace.plan.files import floorplan_text

        return floorplan_text(self.twin(store, row, connection))


@dataclass(frozen=True)
class CoverageRead(_TwinOf):
    """The coverage that the twin predicts, as a picture or as JSON.

    Parameters
    ----------
    step_m : float
        Distance between points, metres.
    max_points : int
        Bound of the points.
    form : str
        ``png`` or ``json``.
    """

    step_m: float
    max_points: int
    form: Literal["png", "json"]

    def look(self, store: Store, row: Row[Any], connection: Connection) -> bytes | str:
        """The picture, or the document."""
        from raytrace.propagation.coverage import lattice

        plan = self.twin(store, row, connection)
        x, y = lattice(plan, self.step_m)
        points = len(x) * len(y)
        if points > self.max_points:
            least = self.step_m * float(np.sqrt(points / self.max_points))
            raise InputError(
                f"step_m: expected at most {self.max_points} points, got {points}; {least:.2g} m gives fewer"
            )
        if self.form == "png":
            return _picture(plan, self.step_m)
        return _document(plan, x, y, self.step_m)


def _document(plan: FloorPlan, x: Array, y: Array, step_m: float) -> str:
    from raytrace.propagation.coverage import path_gains

    gain = path_gains(plan, x, y).max(axis=-1).T
    known = gain > 0.0  # nothing outside of the walls, and nothing where no path arrives
    gain_db = 10.0 * np.log10(gain, where=known, out=np.zeros_like(gain))
    rows = [
        [round(value, 2) if there else None for value, there in zip(*row, strict=True)]
        for row in zip(gain_db.tolist(), known.tolist(), strict=True)
    ]
    return dump(
        {"frame": "estimator", "step_m": step_m, "x_m": x.tolist(), "y_m": y.tolist(), "gain_db": rows}
    )


def _picture(plan: FloorPlan, step_m: float) -> bytes:
    from raytrace.pictures.plans import draw_coverage

    stream = io.BytesIO()
    figure = draw_coverage(plan, plan.tracing.depth, step_m=step_m, over_sent=True)
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
