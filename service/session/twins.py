"""A session's twin: its estimated map as a floor plan, and the coverage that this predicts."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Row

from estimator.errors import InputError
from estimator.threads import one_blas_thread
from service.errors import TooLargeError
from service.messages.documents import dump, read_epoch, read_sweep
from service.session.fold import measurement_set
from service.session.reads import Read
from service.session.results import latest_epoch, session_result
from service.session.smoothing import explained
from service.session.twin_plan import passive_link, refined, twin_plan
from service.storage.store import Store

if TYPE_CHECKING:
    from estimator.measurements import MeasurementSet
    from estimator.result import SlamResult
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["CoverageRead", "TwinRead"]


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
    def twin(
        self, store: Store, row: Row[Any], connection: Connection
    ) -> tuple[FloorPlan, NDArray[np.float64]]:
        """The twin, and the smoothed track (T, 2), metres, both in the estimator's frame.

        Raises
        ------
        ConflictError
            If there is no epoch yet.
        TooLargeError
            If there are too many.
        InputError
            If nothing can be made of them: no wall, or no anchor, or too little measured.
        """
        latest_epoch(row, None)
        if row.next_epoch > self.max_epochs:
            raise TooLargeError(
                f"expected a session of at most {self.max_epochs} epochs for a twin, it has {row.next_epoch}"
            )
        sweeps, epochs = (store.log(row.id, kind, connection) for kind in ("sweep", "epoch"))
        walls = [wall for text in sweeps for wall in read_sweep(text)]
        measured = replace(
            measurement_set(json.loads(row.config), walls), epochs=tuple(read_epoch(text) for text in epochs)
        )
        name = (row.name or row.id)[:100]
        with explained():
            return _built(measured, session_result(store, row, connection), name, self.agent_height_m)


def _built(
    measured: MeasurementSet, result: SlamResult, name: str, agent_height_m: float
) -> tuple[FloorPlan, NDArray[np.float64]]:
    from estimator.slam.smoothing.refine import refine
    from estimator.twin.build import build_twin

    found = refine(measured, result)
    built = build_twin(found, measured)
    plan = twin_plan(built, name, passive_link(measured), agent_height_m)
    return refined(plan, built, measured), found.agent_mean[:, :2]


@dataclass(frozen=True)
class TwinRead(_TwinOf):
    """The twin as a floor plan, TOML."""

    def look(self, store: Store, row: Row[Any], connection: Connection) -> str:
        """The file."""
        from raytrace.plan.files import floorplan_text

        return floorplan_text(self.twin(store, row, connection)[0])


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
        plan, track = self.twin(store, row, connection)
        start, end = plan.walls_m()
        size = np.ptp(np.concatenate([start, end]), axis=0)
        points = int(np.prod(np.ceil(size / self.step_m)))
        if points > self.max_points:
            least = self.step_m * float(np.sqrt(points / self.max_points))
            raise InputError(
                f"step_m: expected at most {self.max_points} points, got {points}; {least:.2g} m gives fewer"
            )
        if self.form == "png":
            return _picture(plan, track, self.step_m)
        return _document(plan, self.step_m)


def _document(plan: FloorPlan, step_m: float) -> str:
    from raytrace.prediction.coverage import coverage

    x, y, gain_db = coverage(plan, step_m)
    rows = [[None if np.isnan(value) else round(value, 2) for value in row] for row in gain_db.tolist()]
    return dump(
        {"frame": "estimator", "step_m": step_m, "x_m": x.tolist(), "y_m": y.tolist(), "gain_db": rows}
    )


def _picture(plan: FloorPlan, track_m: NDArray[np.float64], step_m: float) -> bytes:
    from raytrace.prediction.pictures import draw_coverage

    stream = io.BytesIO()
    draw_coverage(plan, track_m, step_m).savefig(stream, format="png", dpi=150, metadata={"Software": None})
    return stream.getvalue()
