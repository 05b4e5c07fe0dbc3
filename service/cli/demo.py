"""`hapslam demo`: the whole chain in one folder, from tracing to the picture."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from estimator.dataset import require_absent, write_text
from estimator.pipeline import evaluate_file, extract_file, plot_file, slam_file
from service.cli.progress import Advance, Reporter

__all__ = ["claim_folder", "new_folder", "run_demo"]


def new_folder(name: str, parent: Path = Path("demo-output")) -> Path:
    """Make ``parent/name``, or ``parent/name-2`` and so on if it is taken."""
    parent.mkdir(exist_ok=True)
    number = 1
    while True:
        folder = parent / (name if number == 1 else f"{name}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            return folder


def run_demo(
    trace: Callable[[Path, Advance], object],
    out: Path,
    seed: int,
    title: str,
    reporter: Reporter,
    command: str | None = None,
) -> dict[str, Any]:
    """Trace, extract, run SLAM, evaluate and plot into a folder.

    Parameters
    ----------
    trace : callable
        Writes the dataset to a path, telling its progress.
    out : Path
        Folder, empty.
    seed : int
        Seed of the SLAM run.
    title : str
        Head of the picture.
    reporter : Reporter
        Tells the progress and times the stages.
    command : str, optional
        The command line, for the record.

    Returns
    -------
    dict
        As :func:`estimator.evaluation.comparison.evaluate`, and ``seconds`` by stage.

    Raises
    ------
    HapslamError
        As the stages do; a note says which files are there.
    """
    dataset, measurements, result = out / "dataset", out / "measurements.nc", out / "result.nc"
    try:
        with reporter.stage("trace") as advance:
            trace(dataset, advance)
        with reporter.stage("extract") as advance:
            extract_file(dataset, measurements, advance)
        with reporter.stage("slam") as advance:
            slam_file(measurements, result, seed=seed, progress=advance, command=command)
        with reporter.stage("evaluate"):
            numbers = evaluate_file(result)
        with reporter.stage("plot"):
            for suffix in ("png", "svg"):
                plot_file(result, out / f"map.{suffix}", title=title)
        numbers["seconds"] = dict(reporter.seconds)
        write_text(json.dumps(numbers, indent=2) + "\n", out / "evaluation.json")
    except BaseException as error:
        there = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
        done = ", ".join(reporter.seconds) or "none"
        error.add_note(f"stages finished: {done}; {out} holds: {', '.join(there) or 'nothing'}")
        raise
    return numbers


def claim_folder(out: Path) -> Path:
    """Make the folder that the user named, which must not exist.

    Raises
    ------
    OutputExistsError
        If it exists; nothing is changed.
    """
    require_absent(out)
    out.mkdir(parents=True)
    return out
