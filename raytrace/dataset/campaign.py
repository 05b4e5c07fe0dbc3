"""Many datasets from one file: every scene, in every set-up, with every seed.

    format = "hapslam-campaign"
    version = 1
    scenes = ["l-room", "plans/mine.toml"]     # shipped, or files beside this one
    seeds = [1, 2, 3]
    content = "cfr"                            # and shard_epochs, licence: as of one dataset

    [[setups]]
    name = "wide"
    set = { "radio.subcarriers" = 3276 }       # values of the plan, by dotted names

Each dataset goes to a folder of its own, ``<scene>-<setup>-seed<seed>``. All plans are made
and checked before anything is traced, and a campaign that was broken off goes on.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from estimator.errors import FileFormatError
from estimator.executors import Workers
from raytrace.dataset.agents import generate_agents
from raytrace.dataset.journal import require_place
from raytrace.dataset.output import Output
from raytrace.dataset.shard_task import Progress
from raytrace.plan.errors import one_line
from raytrace.plan.files import FloorPlanError, load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.links import Part

__all__ = ["Campaign", "Setup", "load_campaign", "run_campaign"]

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=60)]
Seed = Annotated[int, Field(ge=0)]


class Setup(Part):
    """A named change of plans."""

    name: Name
    set: dict[str, Any] = Field(default_factory=dict)


class Campaign(Part):
    """What a campaign file says."""

    format: Literal["hapslam-campaign"]
    version: Literal[1]
    scenes: Annotated[tuple[str, ...], Field(min_length=1, strict=False)]
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1, strict=False)] = (1,)
    setups: Annotated[tuple[Setup, ...], Field(strict=False)] = ()
    shard_epochs: Annotated[int, Field(ge=0)] = 0
    content: Literal["cfr", "cir", "both"] = "cfr"
    licence: str = ""


@dataclass(frozen=True)
class _Run:
    folder: str
    plan: FloorPlan
    seed: int


def load_campaign(path: Path) -> Campaign:
    """Read a campaign file.

    Raises
    ------
    FileFormatError
        If it is missing, no TOML, or says something that is not understood.
    """
    try:
        return Campaign.model_validate(tomllib.loads(path.read_text(encoding="utf-8-sig")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileFormatError(f"{path}: expected a campaign in TOML, could not read it: {error}") from error
    except ValidationError as error:
        raise FileFormatError(f"{path}: {one_line(error)}") from error


def run_campaign(
    path: Path, out: Path, progress: Progress | None = None, crew: Workers | None = None
) -> tuple[Path, ...]:
    """Make all datasets of a campaign file.

    Parameters
    ----------
    path : Path
        The campaign.
    out : Path
        Folder for the datasets; made if it is not there. Those in it that are complete are
        left alone, those that were broken off are gone on with.
    progress : callable, optional
        Called with (datasets done, datasets in all, the next one's name).
    crew : Workers, optional
        Who makes the shards; by default this process.

    Returns
    -------
    tuple of Path
        The datasets.

    Raises
    ------
    FileFormatError, FloorPlanError
        If the campaign or one of its plans is not valid, or two runs have the same name;
        nothing is traced then.
    ConfigurationError
        If a folder holds another dataset of that name.
    """
    campaign = load_campaign(path)
    output = Output(campaign.shard_epochs, campaign.content, campaign.licence)
    runs = list(_runs(campaign, path.parent))
    names = [run.folder for run in runs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise FileFormatError(f"{path}: expected scenes, setups and seeds that differ, got {twice} twice")
    if not out.is_dir():
        require_place(out)
        out.mkdir()
    made: list[Path] = []
    for done, run in enumerate(runs):
        if progress is not None:
            progress(done, len(runs), run.folder)
        made += generate_agents(run.plan, out / run.folder, run.seed, output=output, resume=True, crew=crew)
    if progress is not None:
        progress(len(runs), len(runs), "done")
    return tuple(made)


def _runs(campaign: Campaign, folder: Path) -> Iterator[_Run]:
    """Every combination, its plan loaded and checked."""
    for scene in campaign.scenes:
        beside = folder / scene
        plan = load_floorplan(beside if beside.is_file() else scene)
        for setup in campaign.setups or (None,):
            try:
                changed = plan if setup is None else updated(plan, setup.set)
            except FloorPlanError as error:
                where = f"{beside if beside.is_file() else scene}, setup {setup.name!r}" if setup else scene
                raise FloorPlanError(f"{where}: {error}") from error
            stem = Path(scene).stem if setup is None else f"{Path(scene).stem}-{setup.name}"
            for seed in campaign.seeds:
                yield _Run(f"{stem}-seed{seed}", changed, seed)
