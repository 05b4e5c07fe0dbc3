"""What a dataset directory holds, told from its manifest and the sizes of its files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from estimator.dataset import read_manifest

__all__ = ["inventory"]


def inventory(path: Path) -> dict[str, Any]:
    """Take stock of a dataset, be it complete or not; no shard is opened.

    Parameters
    ----------
    path : Path
        A dataset directory.

    Returns
    -------
    dict
        JSON types: ``name``, ``complete``, ``epochs`` (in all), ``epochs_there``,
        ``sweeps`` (shards of echo), ``files``, ``bytes``, ``damaged`` (names of files that
        are missing or of another size than listed), and from the manifest ``seed``,
        ``anchors``, ``scene``, ``content``, ``radio``, ``echo``, ``statistics``,
        ``versions`` as far as it says so.

    Raises
    ------
    FileFormatError
        If there is no manifest, or it cannot be read.
    """
    path = Path(path)
    manifest = read_manifest(path)
    shards = manifest["shards"]
    sizes = {entry["file"]: _size(path / str(entry["file"])) for entry in shards}
    spans = {tuple(entry["epochs"]) for entry in shards if "epochs" in entry}
    copied = ("seed", "anchors", "scene", "radio", "echo", "statistics", "versions")
    return {
        "name": manifest.get("name"),
        "complete": manifest.get("complete") is True,
        "epochs": manifest.get("epochs"),
        "epochs_there": sum(stop - first for first, stop in spans),
        "sweeps": sum(entry["kind"] == "echo" for entry in shards),
        "content": manifest.get("output", {}).get("content", "cfr"),
        "files": len(shards),
        "bytes": sum(size or 0 for size in sizes.values()),
        "damaged": sorted(entry["file"] for entry in shards if sizes[entry["file"]] != entry["bytes"]),
        **{key: manifest.get(key) for key in copied},
    }


def _size(file: Path) -> int | None:
    return file.stat().st_size if file.is_file() else None
