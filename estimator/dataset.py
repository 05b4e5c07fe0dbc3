"""The contract on disk: a directory of immutable netCDF shards and a JSON manifest.

    DATASET/
      manifest.json       configuration, seed, versions, scene name and hash, shards
      passive-00000.nc    noisy CFRs          cfr_re, cfr_im (epoch, anchor, antenna, tone)
      echo-00000.nc       noisy beam sweeps   echo_re, echo_im (sweep, beam, tone)
      paths-00000.nc      noiseless paths     delay_s, ... (epoch, anchor, path)
      truth.nc            floor plan, anchors, track: opened by `evaluate` and `plot` alone

Every file is written under a temporary name, synced and renamed, and shards are
listed in the manifest with their size and SHA-256; a manifest with
``complete = false`` belongs to a dataset whose generation did not finish. Files
hold no time stamps and no absolute paths, so equal inputs give equal bytes. A long
track is cut into shards of successive epochs, so nothing needs more memory than one.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.errors import FileFormatError, OutputExistsError
from estimator.json_objects import json_object

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Dataset",
    "DatasetWriter",
    "digest_of",
    "open_dataset",
    "publish",
    "read_manifest",
    "read_netcdf",
    "remove_temporaries",
    "require_absent",
    "temporary_name",
    "write_bytes",
    "write_netcdf",
    "write_shard",
    "write_text",
]

FORMAT = "hapslam-dataset"
VERSION = 1
MANIFEST = "manifest.json"
KINDS = ("passive", "echo", "paths", "truth")
# Units and attributes are those of the Climate and Forecast conventions, which readers look for.
_CF = "CF-1.11"


def require_absent(path: Path) -> None:
    """Raise OutputExistsError if anything stands at ``path``."""
    if path.exists() or path.is_symlink():
        raise OutputExistsError(f"{path}: expected a name that is free, but it exists; nothing was written")


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def publish(temporary: Path, path: Path) -> None:
    """Sync ``temporary``, rename it to ``path``, sync the folder."""
    handle = os.open(temporary, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
    temporary.replace(path)
    _sync_folder(path.parent)


def temporary_name(path: Path) -> Path:
    """Name beside ``path``, of this process alone, to write under before :func:`publish`."""
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


def remove_temporaries(folder: Path) -> None:
    """Remove what killed writers left in a folder under temporary names."""
    for left in folder.glob(".*.tmp"):
        left.unlink(missing_ok=True)


def write_text(text: str, path: Path) -> None:
    """Write a small text file atomically, replacing what was there."""
    write_bytes(text.encode(), path)


def write_bytes(contents: bytes, path: Path) -> None:
    """Write a small file atomically, replacing what was there."""
    temporary = temporary_name(path)
    try:
        temporary.write_bytes(contents)
        publish(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_netcdf(data: xr.Dataset, path: Path, replace: bool = False) -> None:
    """Write ``data`` to a netCDF-4 file atomically; to a new one unless it may ``replace`` one.

    Raises
    ------
    OutputExistsError
        If ``path`` exists and may not be replaced.
    FileFormatError
        If its folder does not exist.
    """
    path = Path(path)
    if not replace:
        require_absent(path)
    if not path.parent.is_dir():
        raise FileFormatError(f"{path}: expected an existing folder {path.parent}, there is none")
    from xarray.backends import H5NetCDFStore

    temporary = temporary_name(path)
    try:
        contents = io.BytesIO()  # where a disk is full, HDF5 itself ends the process
        # The lock that to_netcdf takes in a worker of Dask is named by this object, which no one else knows.
        store = H5NetCDFStore.open(contents, mode="w", lock=False)
        data.dump_to_store(store)
        store.close()
        temporary.write_bytes(contents.getbuffer())
        publish(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_netcdf(path: Path, format_name: str, version: int) -> xr.Dataset:
    """Read a whole netCDF file of ours into memory.

    Raises
    ------
    FileFormatError
        If the file is missing, not netCDF, truncated, or of another format or version.
    """
    path = Path(path)
    if not path.is_file():
        raise FileFormatError(f"{path}: expected a {format_name} file, found nothing there")
    import xarray as xr

    from estimator.hdf5_guard import check_hdf5

    check_hdf5(path)
    try:
        with xr.open_dataset(path, engine="h5netcdf") as data:
            loaded = data.load()
    except Exception as error:  # whatever the libraries make of rubbish
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(
            f"{path}: expected a complete netCDF-4 file ({format_name}), could not read it: {reason}"
        ) from error
    found = (loaded.attrs.get("format"), loaded.attrs.get("version"))
    if found[0] != format_name or found[1] != version:
        raise FileFormatError(
            f"{path}: expected format {format_name!r} version {version}, got {found[0]!r} version {found[1]}"
        )
    return loaded


def digest_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_shard(
    folder: Path, kind: str, name: str, data: xr.Dataset, replace: bool = False, **facts: Any
) -> dict[str, Any]:
    """Write a shard of one of the ``KINDS`` under the file name ``name``.

    Parameters
    ----------
    folder : Path
        The dataset's directory.
    kind, name : str
        Which kind of shard, and its file name.
    data : xarray.Dataset
        What it holds.
    replace : bool
        Whether it may take the place of a file that no manifest lists.
    **facts
        More to say of it in the manifest (JSON types); ``epochs = [first, stop]`` sets its place there.

    Returns
    -------
    dict
        Its entry for the manifest's list.
    """
    if kind not in KINDS:
        raise ValueError(f"kind: expected one of {KINDS}, got {kind!r}")
    file = folder / name
    data = data.assign_attrs(Conventions=_CF, format=f"{FORMAT}/{kind}", version=VERSION)
    write_netcdf(data, file, replace)
    return {"file": name, "kind": kind, "bytes": file.stat().st_size, "sha256": digest_of(file), **facts}


class DatasetWriter:
    """Writes a dataset shard by shard; the manifest follows each shard.

    Parameters
    ----------
    path : Path
        Directory to create; its parent must exist.
    manifest : mapping
        What the manifest says besides ``format``, ``version``, ``complete`` and
        ``shards`` (JSON types).
    shards : sequence of mapping
        Entries of shards that the directory, which then exists, holds already: their
        writing was broken off, or they are to be added to.

    Raises
    ------
    OutputExistsError
        If ``path`` exists and no shards are named.
    """

    def __init__(
        self, path: Path, manifest: Mapping[str, Any], shards: Sequence[Mapping[str, Any]] | None = None
    ) -> None:
        self.path = Path(path)
        if shards is None:
            require_absent(self.path)
            if not self.path.parent.is_dir():
                raise FileFormatError(
                    f"{self.path}: expected an existing folder {self.path.parent}, there is none"
                )
            self.path.mkdir()
        self._manifest: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "complete": False,
            **manifest,
            "shards": [dict(shard) for shard in shards or ()],
        }
        self._save()

    @property
    def shards(self) -> tuple[dict[str, Any], ...]:
        """Entries of the shards so far, by their epochs, the truth last."""
        return tuple(self._manifest["shards"])

    def write(self, kind: str, name: str, data: xr.Dataset) -> None:
        """Add a shard of one of the ``KINDS`` under the file name ``name``."""
        self.add(write_shard(self.path, kind, name, data))

    def add(self, *entries: Mapping[str, Any]) -> None:
        """List shards that :func:`write_shard` wrote into the directory."""
        shards = self._manifest["shards"]
        shards += [dict(entry) for entry in entries]
        shards.sort(key=lambda entry: (entry["kind"] == "truth", entry.get("epochs", [0])[0]))
        self._save()

    def finish(self, **more: Any) -> None:
        """Mark the dataset complete, adding ``more`` entries (statistics) to the manifest."""
        self._manifest.update(more)
        self._manifest["complete"] = True
        self._save()

    def _save(self) -> None:
        write_text(json.dumps(self._manifest, indent=2) + "\n", self.path / MANIFEST)


@dataclass(frozen=True)
class Dataset:
    """An opened dataset: its manifest, and its shards read on demand.

    Parameters
    ----------
    path : Path
        The directory.
    manifest : mapping
        The parsed manifest.
    """

    path: Path
    manifest: Mapping[str, Any]

    def shards(self, kind: str, skipped: int = 0) -> Iterator[xr.Dataset]:
        """Read the shards of one kind in order, each whole; the first few may be ``skipped``.

        Raises
        ------
        FileFormatError
            If a shard is missing, or its size or hash differs from the manifest's.
        """
        entries = [entry for entry in self.manifest["shards"] if entry["kind"] == kind]
        for entry in entries[skipped:]:
            file = self.file(entry)
            digest = digest_of(file)
            if digest != entry["sha256"]:
                raise FileFormatError(
                    f"{file}: expected SHA-256 {entry['sha256'][:12]}..., got {digest[:12]}...; "
                    "the shard was changed"
                )
            yield read_netcdf(file, f"{FORMAT}/{kind}", VERSION)

    def file(self, entry: Mapping[str, Any]) -> Path:
        """Path of the shard that an entry of the manifest lists; its hash is left unchecked.

        Raises
        ------
        FileFormatError
            If the shard is missing or its size differs from the manifest's.
        """
        file = self.path / str(entry["file"])
        if not file.is_file():
            raise FileFormatError(f"{file}: expected a shard of {entry['bytes']} bytes, found nothing there")
        size = file.stat().st_size
        if size != entry["bytes"]:
            raise FileFormatError(
                f"{file}: expected {entry['bytes']} bytes, got {size}; the shard is truncated or changed"
            )
        return file

    def truth(self) -> xr.Dataset:
        """The truth file (floor plan, anchors, track); only evaluation and plots may call this.

        Raises
        ------
        FileFormatError
            If the dataset has no truth file (it may have been removed on purpose).
        """
        for data in self.shards("truth"):
            return data
        raise FileFormatError(f"{self.path}: expected a truth file in the dataset, the manifest lists none")


def _check_shards(file: Path, shards: object) -> None:
    """Raise FileFormatError unless the manifest's ``shards`` are what a writer lists."""
    if not isinstance(shards, list):
        raise FileFormatError(f"{file}: expected a list of shards, got {type(shards).__name__}")
    for shard in shards:
        if not isinstance(shard, dict) or not {"file", "kind", "bytes", "sha256"} <= shard.keys():
            raise FileFormatError(f"{file}: expected shards with file, kind, bytes and sha256, got {shard!r}")
        if not isinstance(shard["sha256"], str):
            raise FileFormatError(f"{file}: expected a SHA-256 in hexadecimal, got {shard['sha256']!r}")
        if Path(str(shard["file"])).name != shard["file"]:
            raise FileFormatError(f"{file}: expected plain shard file names, got {shard['file']!r}")
    if len({shard["file"] for shard in shards}) != len(shards):
        raise FileFormatError(f"{file}: expected each shard once")


def read_manifest(path: Path, complete: bool = False) -> dict[str, Any]:
    """Read the manifest of a dataset directory.

    Raises
    ------
    FileFormatError
        If there is no manifest, or it is damaged, of another format or version, or
        the dataset has to be ``complete`` and is not.
    """
    path = Path(path)
    file = path / MANIFEST
    if not file.is_file():
        raise FileFormatError(f"{path}: expected a dataset directory with {MANIFEST}, found none")
    try:
        manifest = json_object(file.read_text(encoding="utf-8"), str(file))
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{file}: expected JSON, could not read it: {error}") from error
    found = manifest.get("format"), manifest.get("version")
    if found != (FORMAT, VERSION):
        raise FileFormatError(
            f"{file}: expected format {FORMAT!r} version {VERSION}, got {found[0]!r} version {found[1]}"
        )
    if complete and manifest.get("complete") is not True:
        raise FileFormatError(
            f"{path}: expected a complete dataset, its generation was interrupted "
            "(hapslam trace --resume goes on with it)"
        )
    _check_shards(file, manifest.get("shards"))
    return manifest


def open_dataset(path: Path) -> Dataset:
    """Open a dataset directory.

    Raises
    ------
    FileFormatError
        If there is no manifest, or it is damaged, of another format or version, or
        the dataset is incomplete.
    """
    return Dataset(Path(path), read_manifest(path, complete=True))
