"""The writing of a dataset that can be broken off at any moment and gone on with.

The journal is the manifest: a shard counts once its files are renamed into place and
the manifest that lists them is. What was under way at the break is made again, into the
same bytes. One process writes a dataset at a time.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from estimator.dataset import MANIFEST, DatasetWriter, read_manifest, remove_temporaries, require_absent
from estimator.errors import ConfigurationError, FileFormatError, OutputExistsError

__all__ = ["claimed", "journal", "require_place", "require_same", "whole_shards"]


@contextmanager
def journal(out: Path, head: Mapping[str, Any], resume: bool = False) -> Iterator[DatasetWriter | None]:
    """Begin a dataset, or go on with it.

    If the block fails before the first shard is written, what was begun is removed.

    Parameters
    ----------
    out : Path
        The dataset's directory.
    head : mapping
        What its manifest says besides shards and statistics.
    resume : bool
        Go on with what is there; begin if nothing is.

    Yields
    ------
    DatasetWriter or None
        With the shards that are there; None if the dataset is complete.

    Raises
    ------
    OutputExistsError
        If ``out`` exists and is not to be gone on with, or another process writes it.
    ConfigurationError
        If it was begun with another ``head``.
    FileFormatError
        If there is no folder to put it in, or what is there is no dataset.
    """
    fresh = not (resume and out.exists())
    if fresh:
        require_place(out)
        out.mkdir()
    with claimed(out):
        shards: list[dict[str, Any]] = []
        if (out / MANIFEST).exists():
            manifest = read_manifest(out)
            require_same(out, manifest, head)
            if manifest.get("complete") is True:
                yield None
                return
            shards = whole_shards(out, manifest)
        remove_temporaries(out)
        if not shards and not (out / MANIFEST).exists() and any(out.iterdir()):
            raise FileFormatError(f"{out}: expected a dataset to go on with, found a folder of other files")
        writer = DatasetWriter(out, head, shards)
        try:
            yield writer
        except BaseException:
            if fresh and not writer.shards:
                shutil.rmtree(out)
            raise


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Hold a folder against other writers; the hold ends with this process at the latest.

    Raises
    ------
    OutputExistsError
        If another process holds it.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise OutputExistsError(
            f"{folder}: expected to write it alone, another process is at it; nothing was written"
        ) from error
    finally:
        os.close(handle)


def require_same(out: Path, manifest: Mapping[str, Any], head: Mapping[str, Any]) -> None:
    """Raise ConfigurationError unless a manifest was begun with a head."""
    wanted = json.loads(json.dumps(head))
    different = [key for key, value in wanted.items() if manifest.get(key) != value]
    if different:
        raise ConfigurationError(
            f"{out}: expected it to be of the same plan, seed, settings and versions; "
            f"it differs in {', '.join(different)}"
        )


def whole_shards(out: Path, manifest: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Entries of the shards whose files all are there in their size; the truth is left out."""
    groups: defaultdict[tuple[int, ...], list[dict[str, Any]]] = defaultdict(list)
    for entry in manifest["shards"]:
        if entry["kind"] != "truth":
            groups[tuple(entry.get("epochs", ()))].append(entry)

    def there(entry: Mapping[str, Any]) -> bool:
        file: Path = out / str(entry["file"])
        return file.is_file() and file.stat().st_size == int(entry["bytes"])

    return [entry for group in groups.values() if all(map(there, group)) for entry in group]


def require_place(out: Path) -> None:
    """Raise OutputExistsError if ``out`` exists, FileFormatError if there is no folder to put it in."""
    try:
        require_absent(out)
    except OutputExistsError as error:
        if (out / MANIFEST).is_file() and read_manifest(out).get("complete") is False:
            error.add_note("it is a dataset whose generation was interrupted: --resume goes on with it")
        raise
    if not out.parent.is_dir():
        raise FileFormatError(f"{out}: expected an existing folder {out.parent}, there is none")
