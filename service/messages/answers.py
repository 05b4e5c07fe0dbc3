"""What the service answers with, described: states, maps, tracks, sessions, jobs, problems.

Answers are written as text by what computes them; these models describe that text in the interface's
description, and generated clients read it with them.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.messages.session_requests import SessionRequest, StartFrame

__all__ = [
    "Coverage",
    "EpochsAnswer",
    "Job",
    "JobList",
    "Map",
    "Method",
    "Problem",
    "Session",
    "SessionPage",
    "Share",
    "Smoothed",
    "State",
    "SweepAnswer",
    "Track",
]

Pair = list[float]
Matrix = list[list[float]]


class Answer(BaseModel):
    """Base: fields may be added."""

    model_config = ConfigDict(extra="allow")


class AgentState(Answer):
    """The agent, estimator's frame."""

    position_m: Pair
    velocity_m_s: Pair
    covariance: Matrix = Field(description="4 x 4, of position and velocity, the map's rotation included.")


class AnchorState(Answer):
    """An anchor."""

    name: str
    located: bool
    position_m: Pair | None
    covariance_m2: Matrix | None
    existence: float = Field(description="Probability that it stands there.")
    clock_bias_m: float | None = Field(
        None, description="Clock bias as a path length, where the noise model has one."
    )
    clock_bias_std_m: float | None = None
    height_m: float | None = Field(None, description="Above or below the agent, where it is estimated.")
    height_std_m: float | None = None


class WallState(Answer):
    """A wall by its virtual reference point, the mirror image of the agent's start."""

    id: int
    vrp_m: Pair
    covariance_m2: Matrix
    existence: float


class CandidateWall(Answer):
    """A wall of a hypothesis."""

    id: int
    vrp_m: Pair


class Candidate(Answer):
    """One of the likeliest hypotheses."""

    weight: float
    position_m: Pair
    walls: list[CandidateWall]


class Integrity(Answer):
    """Whether the estimate may be relied on."""

    state: Literal["ok", "doubtful", "lost", "unknown"]
    probability: float | None = Field(
        description="That the agent is within a metre of where it is thought to be."
    )
    protection_level_m: float | None = Field(description="The error is smaller with 99.9 % probability.")
    reasons: list[str] = Field(description="What speaks against it.")


class State(Answer):
    """Agent, anchors and walls after an epoch."""

    epoch: int
    time_s: float
    agent: AgentState
    rotation_std_rad: float = Field(description="Standard deviation of the map's rotation about the start.")
    anchors: list[AnchorState]
    walls: list[WallState]
    hypotheses: int
    candidates: list[Candidate]
    log_evidence: float
    integrity: Integrity


class EpochsAnswer(Answer):
    """What became of a request with epochs."""

    first_epoch: int
    last_epoch: int
    state: State


class SweepAnswer(Answer):
    """What became of a sweep."""

    sweep: int
    walls: int


class Method(Answer):
    """What a session's method and engine may be."""

    method: str
    engine: str


class Session(SessionRequest):
    """A session: its configuration, and what it expects next."""

    model_config = ConfigDict(extra="allow")

    id: str
    created_at: str
    updated_at: str
    next_sweep: int
    next_epoch: int
    time_s: float | None = Field(description="Of the last epoch.")
    integrity: Literal["ok", "doubtful", "lost", "unknown"] | None = Field(
        None, description="Whether the last epoch may be relied on; null before the first."
    )
    start_frame: StartFrame | None
    warnings: list[str] = Field(default_factory=list, description="What will keep it from giving estimates.")


class SessionPage(Answer):
    """Sessions, the newest first."""

    sessions: list[Session]
    next: str | None = Field(description="`before` of the next page.")


class Share(Answer):
    """A key to one session that only reads and expires."""

    key: str
    expires_at: str
    link: str


class Track(Answer):
    """The track as columns of equal length."""

    epoch: list[int]
    time_s: list[float]
    x_m: list[float]
    y_m: list[float]
    variance_x_m2: list[float]
    covariance_xy_m2: list[float]
    variance_y_m2: list[float]
    rotation_std_rad: list[float]
    hypotheses: list[int] | None = None
    walls: list[int] | None = None


class MapWall(Answer):
    """A wall as the segment on which reflections were seen."""

    id: int
    vrp_m: Pair
    covariance_m2: Matrix
    segment_m: Matrix
    std_along_segment_m: list[float]


class MapAgent(Answer):
    """The agent in the map's frame."""

    position_m: Pair
    velocity_m_s: Pair
    covariance_m2: Matrix


class MapAnchor(Answer):
    """An anchor in the map's frame."""

    name: str
    located: bool
    position_m: Pair | None
    covariance_m2: Matrix | None


class MapIntegrity(Answer):
    """Whether the map may be relied on; `state` of the session has the reasons."""

    state: Literal["ok", "doubtful", "lost", "unknown"]
    protection_level_m: float | None


class Map(Answer):
    """Walls, anchors, agent and track in one frame; other members in other formats."""

    epoch: int | None = None
    time_s: float | None = None
    frame: Literal["estimator", "plan"] | None = None
    integrity: MapIntegrity | None = None
    agent: MapAgent | None = None
    anchors: list[MapAnchor] | None = None
    walls: list[MapWall] | None = None
    track_m: Matrix | None = None


class Coverage(Answer):
    """Predicted coverage on a grid, estimator's frame."""

    frame: Literal["estimator"]
    step_m: float
    x_m: list[float]
    y_m: list[float]
    gain_db: list[list[float | None]] = Field(
        description="A row for each y: power of all paths of the strongest anchor over its EIRP, dB; "
        "null outside."
    )


class Smoothed(Answer):
    """Track and map given all measurements."""

    trajectory: Track
    map: Map


class Violation(Answer):
    """Where a request is not what was expected."""

    where: str
    expected: str
    got: str


class Problem(Answer):
    """Why a request was refused (RFC 9457)."""

    type: str
    title: str
    status: int
    detail: str = Field(description="What was expected, and what came.")
    request_id: str
    expected: dict[str, Any] | None = Field(None, description="Of a conflict: what comes next.")
    errors: list[Violation] | None = None


class Job(Answer):
    """A file that was answered for at once, and what became of it."""

    id: str
    kind: Literal["upload", "dataset", "channels"]
    state: Literal["queued", "running", "done", "failed"]
    created_at: str
    updated_at: str
    session: str | None = Field(description="The session that it is for, or that was made.")
    last_epoch: int | None
    problem: Problem | None


class JobList(Answer):
    """Jobs, the newest first."""

    jobs: list[Job]
