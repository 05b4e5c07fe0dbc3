"""What tracing lost, said aloud: a warning line for every dataset that misses paths, and a status for it."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from estimator.dataset import read_manifest

__all__ = ["STRICT_STATUS", "Strict", "tell_missing"]

# Exit status under `--strict` where paths are missing: neither bad input nor a failure of the system.
STRICT_STATUS = 3
Strict = Annotated[
    bool, typer.Option("--strict", help=f"End with status {STRICT_STATUS} if a path is missing.")
]


def tell_missing(datasets: Iterable[Path]) -> bool:
    """Print a line on the standard error for every dataset with missing or unexplained paths.

    Returns
    -------
    bool
        Whether there was one.
    """
    told = False
    for dataset in datasets:
        counts: Counter[str] = Counter()
        for entry in read_manifest(dataset).get("shards", ()):
            counts.update({**entry.get("check", {})})
            bent = entry.get("others", {})
            counts.update({"expected": bent.get("bent_once", 0), "missing": bent.get("bent_once_missing", 0)})
            echo = entry.get("returns", {})
            counts.update({name: echo.get(name, 0) for name in ("expected", "missing", "extra")})
        faults = [f"{counts[fault]} {fault}" for fault in ("missing", "extra") if counts[fault]]
        if faults:
            told = True
            sys.stderr.write(
                f"hapslam: warning: {dataset}: of {counts['expected']} paths {' and '.join(faults)}; "
                f"`hapslam verify {dataset}` names them\n"
            )
    return told
