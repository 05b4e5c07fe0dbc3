"""Zip archives of strangers: what they would unpack to, checked before anything is unpacked."""

from __future__ import annotations

import io
import math
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from estimator.errors import FileFormatError, FileTooLargeError

__all__ = ["ZIP", "ArchiveLimits", "npz_arrays", "opened_archive"]

ZIP = b"PK\x03\x04"
_END, _END_BYTES = b"PK\x05\x06", 22
_NPY = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@dataclass(frozen=True)
class ArchiveLimits:
    """How much an archive may hold.

    Parameters
    ----------
    bytes : int
        All members unpacked, bytes.
    directory_bytes : int
        The list of members: a member takes some hundred bytes of it, a dataset has some hundred.
    """

    bytes: int
    directory_bytes: int = 256 * 2**10


@contextmanager
def opened_archive(body: bytes, limits: ArchiveLimits) -> Iterator[zipfile.ZipFile]:
    """An archive that is within the limits.

    Raises
    ------
    FileFormatError
        If it is no zip archive.
    FileTooLargeError
        If its list of members is too long, or they would unpack to too much.
    """
    end = body.rfind(_END)
    if end < 0 or len(body) < end + _END_BYTES:
        raise FileFormatError("file: expected a complete zip archive, its end is missing")
    directory = struct.unpack_from("<I", body, end + 12)[0]
    if directory > limits.directory_bytes:
        raise FileTooLargeError(
            f"file: expected a list of members of at most {limits.directory_bytes} bytes, got {directory}"
        )
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
        if size > limits.bytes:
            raise FileTooLargeError(f"file: expected to unpack to at most {limits.bytes} bytes, got {size}")
        yield archive


def npz_arrays(archive: zipfile.ZipFile, names: tuple[str, ...]) -> dict[str, Any]:
    """Arrays of an npz archive by name; pickled objects are refused.

    Raises
    ------
    FileFormatError
        If one is missing, or is not an array whose bytes are all there.
    """
    return {name: _array(archive, name) for name in names}


def _array(archive: zipfile.ZipFile, name: str) -> Any:
    try:
        entry = archive.getinfo(f"{name}.npy")
    except KeyError as error:
        raise FileFormatError(f"file: expected the array {name}, it is missing") from error
    with archive.open(entry) as member:
        _check_head(member, name, entry.file_size)
    with archive.open(entry) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _check_head(member: IO[bytes], name: str, size: int) -> None:
    """An array's head says how much memory it takes, whatever follows."""
    version = np.lib.format.read_magic(member)
    if version not in _NPY:
        raise FileFormatError(f"file, {name}: expected an array of npy version 1 or 2, got {version}")
    shape, _, dtype = _NPY[version](member)
    stated = dtype.itemsize * math.prod(shape)
    if stated > size:
        raise FileFormatError(f"file, {name}: expected an array within its {size} bytes, it states {stated}")
