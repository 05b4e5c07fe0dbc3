"""What is done of a long stage, kept beside the file that it will end in: a killed run goes on from there.

    OUT.parts/
      work.json             what is computed: input and settings, as digests and JSON
      passive-000000012.nc  what has been computed up to step 12, since the part before
      slam-000012000.state  where SLAM stands at that step

A part is written when the last one is half a minute old, so that short runs write none. The folder goes when
the stage has written its file.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from estimator.dataset import remove_temporaries, require_absent, write_bytes, write_text
from estimator.errors import FileFormatError, OutputExistsError
from estimator.json_objects import json_object

__all__ = ["PERIOD_S", "Part", "Parts"]

PERIOD_S = 30.0
"""Least time between two parts, seconds of wall clock: what a kill may cost."""
_WORK, _STATE = "work.json", ".state"


@dataclass(frozen=True)
class Part:
    """A piece of a stage that is done.

    Parameters
    ----------
    path : Path
        Its file.
    done : int
        Steps of the stage that are done with it.
    """

    path: Path
    done: int


class Parts:
    """The parts of one stage.

    Parameters
    ----------
    out : Path
        The file that the stage will end in.
    work : mapping
        What is computed (JSON types): parts of other work are not taken up.
    resume : bool
        Whether to take up what an interrupted run left.
    period_s : float
        Least time between two parts, seconds of wall clock.

    Raises
    ------
    OutputExistsError
        If the file is there, or parts are that are not to be taken up.
    FileFormatError
        If the parts there are those of other work.
    """

    def __init__(
        self, out: Path, work: Mapping[str, Any], resume: bool = False, period_s: float = PERIOD_S
    ) -> None:
        self.out, self.folder = out, out.with_name(f"{out.name}.parts")
        self._work = {**work, "version": metadata.version("hapslam")}
        self._period_s, self._last = period_s, time.monotonic()
        left = self.folder.exists()
        if not (resume and left):
            require_absent(out)
        if not left:
            return
        if not resume:
            raise OutputExistsError(
                f"{out}: an interrupted run left {self.folder}; go on with it by --resume, or remove it"
            )
        self._check()
        remove_temporaries(self.folder)

    def of(self, kind: str) -> list[Part]:
        """The parts of one kind, in their order."""
        found = sorted(self.folder.glob(f"{kind}-*.nc"))
        return [Part(path, int(path.stem.rpartition("-")[2])) for path in found]

    def state(self, part: Part) -> bytes:
        """The state that was kept with a part.

        Raises
        ------
        FileFormatError
            If it is missing.
        """
        path = part.path.with_suffix(_STATE)
        try:
            return path.read_bytes()
        except OSError as error:
            raise FileFormatError(
                f"{path}: expected the state at step {part.done}, could not read it"
            ) from error

    def finished(self) -> bool:
        """Whether the stage's file is there and only its parts have not been removed: they are now."""
        if not (self.folder.exists() and self.out.exists()):
            return False
        self.remove()
        return True

    @property
    def due(self) -> bool:
        """Whether what has been done since the last part should be kept now."""
        return time.monotonic() - self._last >= self._period_s

    def keep(self, kind: str, done: int, write: Callable[[Path], None], state: bytes | None = None) -> None:
        """Keep a part, and the state from which to go on if there is one.

        Parameters
        ----------
        kind : str
            Which stage.
        done : int
            Steps done with it.
        write : callable
            Makes its file, atomically, under the name that it is given.
        state : bytes, optional
            The state after it; those of parts before are removed.
        """
        if not self.folder.exists():
            self.folder.mkdir()
            write_text(json.dumps(self._work, indent=2, sort_keys=True) + "\n", self.folder / _WORK)
        path = self.folder / f"{kind}-{done:09d}.nc"
        if state is not None:
            write_bytes(state, path.with_suffix(_STATE))
        write(path)
        for old in self.folder.glob(f"{kind}-*{_STATE}"):
            if old.stem != path.stem:
                old.unlink()
        self._last = time.monotonic()

    def remove(self) -> None:
        """Remove all parts: the stage has written its file."""
        if self.folder.exists():
            shutil.rmtree(self.folder)

    def _check(self) -> None:
        """Raise FileFormatError unless the parts there are those of this work."""
        file = self.folder / _WORK
        if not file.exists():
            if any(self.folder.glob("*.nc")):
                raise FileFormatError(f"{self.folder}: expected {_WORK} beside the parts, it is missing")
            shutil.rmtree(self.folder)  # killed before there was any
            return
        try:
            found = json_object(file.read_bytes(), str(file))
        except (OSError, FileFormatError) as error:
            raise FileFormatError(
                f"{file}: expected a JSON object that says whose parts these are; remove the folder to begin "
                "anew"
            ) from error
        wanted = json.loads(json.dumps(self._work))
        other = sorted(key for key in wanted.keys() | found.keys() if wanted.get(key) != found.get(key))
        if other:
            raise FileFormatError(
                f"{self.folder}: expected parts of the same work, got others in {', '.join(other)}; "
                "remove the folder to begin anew"
            )
