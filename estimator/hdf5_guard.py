"""What an HDF5 file is made of, checked before anything in it is read.

HDF5 is more than a container of arrays: a file may keep a dataset's bytes in any other file that the
reader can open (external storage), show datasets of other files as its own (external links, virtual
layouts), and unpack a few bytes to terabytes. The measurement and dataset files here are flat netCDF-4:
arrays of numbers and of strings under hard links of the root group. Everything else is refused by its
structure; no element of an array is read for that, except strings, one by one, to add up their lengths.

What the structure cannot tell is how far a damaged compressed chunk expands: who reads files of
strangers in numbers does so in a process with a memory limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from h5py import h5a, h5d, h5f, h5l, h5o, h5s, h5t, h5z

from estimator.errors import FileFormatError, FileTooLargeError

__all__ = ["Hdf5Limits", "check_hdf5"]

_FILTERS = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
_LAYOUTS = {h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED}
_NUMBERS = {h5t.INTEGER, h5t.FLOAT}
_SCALES = {b"DIMENSION_LIST", b"REFERENCE_LIST"}  # of netCDF-4: which variables are axes of which


@dataclass(frozen=True)
class Hdf5Limits:
    """How much a file may hold.

    Parameters
    ----------
    bytes : int
        All arrays unpacked, bytes. A shard of a dataset stays below the memory of a laptop.
    variables : int
        Arrays; a file of ours has about twenty.
    attributes : int
        Attributes of one array or of the file.
    attribute_bytes : int
        Size of one attribute; the settings of a run are some kilobytes.
    strings : int
        Strings in an array: names of anchors and walls.
    string_bytes : int
        All strings of an array together, bytes.
    chunks : int
        Pieces in which an array may be stored: each costs a search and a buffer.
    """

    bytes: int = 16 * 2**30
    variables: int = 256
    attributes: int = 64
    attribute_bytes: int = 2**20
    strings: int = 10_000
    string_bytes: int = 2**20
    chunks: int = 1_000_000


def check_hdf5(path: Path, limits: Hdf5Limits | None = None) -> int:
    """Refuse an HDF5 file that is not a flat collection of arrays with their bytes in the file itself.

    Parameters
    ----------
    path : Path
        The file.
    limits : Hdf5Limits, optional
        How much it may hold.

    Returns
    -------
    int
        Bytes that all its arrays unpack to.

    Raises
    ------
    FileFormatError
        If it is not HDF5, or holds anything but arrays of numbers and strings: groups, links that are not
        hard, external storage, virtual layouts, types or filters of its own.
    FileTooLargeError
        If it would unpack to more than the limits allow.
    """
    allowed = Hdf5Limits() if limits is None else limits
    with _opened(path) as file:
        try:
            return _Walk(path.name, allowed).file(file)
        except FileFormatError:
            raise
        except Exception as error:  # whatever the library makes of rubbish
            raise FileFormatError(
                f"{path.name}: expected a complete netCDF-4 file, could not read its structure"
            ) from error


@contextmanager
def _opened(path: Path) -> Iterator[h5f.FileID]:
    try:
        file = h5f.open(str(path).encode(), h5f.ACC_RDONLY)
    except Exception as error:
        raise FileFormatError(f"{path.name}: expected a complete netCDF-4 file, could not open it") from error
    try:
        yield file
    finally:
        file.close()


class _Walk:
    """A walk over a file that adds up what it would unpack to."""

    def __init__(self, name: str, limits: Hdf5Limits) -> None:
        self._name, self._limits, self._unpacked = name, limits, 0

    def file(self, file: h5f.FileID) -> int:
        """Check everything in a file; what it unpacks to, bytes."""
        root = h5o.open(file, b"/")
        count = root.get_num_objs()
        if count > self._limits.variables:
            raise FileTooLargeError(
                f"{self._name}: expected at most {self._limits.variables} variables, got {count}"
            )
        self._attributes(root, "the file")
        for name in [root.get_objname_by_idx(i) for i in range(count)]:
            self._variable(root, name)
        return self._unpacked

    def _refuse(self, name: str, expected: str, got: str) -> FileFormatError:
        return FileFormatError(f"{self._name}, {name}: expected {expected}, got {got}")

    def _variable(self, root: h5py.h5g.GroupID, key: bytes) -> None:
        name = _shown(key)
        if root.links.get_info(key).type != h5l.TYPE_HARD:
            raise self._refuse(name, "a variable of this file", "a link to elsewhere")
        if h5o.get_info(root, key).type != h5o.TYPE_DATASET:
            raise self._refuse(name, "a flat file of variables", "a group or a named type")
        dataset = h5d.open(root, key)
        properties = dataset.get_create_plist()
        if properties.get_layout() not in _LAYOUTS:
            raise self._refuse(name, "an array of this file", "a virtual array of others")
        if properties.get_external_count() != 0:
            raise self._refuse(name, "an array of this file", "one stored in another file")
        for i in range(properties.get_nfilters()):
            if properties.get_filter(i)[0] not in _FILTERS:
                raise self._refuse(
                    name, "no compression but deflate", f"filter {properties.get_filter(i)[0]}"
                )
        space = dataset.get_space()
        if space.get_simple_extent_type() == h5s.NULL:
            raise self._refuse(name, "an array", "an empty dataspace")
        shape = tuple(int(size) for size in space.shape)
        kind = dataset.get_type()
        self._type(kind, name)
        self._size(name, shape, kind.get_size(), properties)
        if _is_text(kind):
            self._strings(dataset, name, shape)
        self._attributes(dataset, name)

    def _type(self, kind: h5t.TypeID, name: str) -> None:
        if kind.committed() or not (kind.get_class() in _NUMBERS or kind.get_class() == h5t.STRING):
            raise self._refuse(name, "numbers or strings", "a type of its own")

    def _size(self, name: str, shape: tuple[int, ...], item: int, properties: h5py.h5p.PropDCID) -> None:
        """Add up what a variable unpacks to; chunks overlap its edges."""
        size = item * math.prod(shape)
        if properties.get_layout() == h5d.CHUNKED:
            chunk = properties.get_chunk()
            chunks = math.prod(-(-length // step) for length, step in zip(shape, chunk, strict=True))
            if chunks > self._limits.chunks:
                raise FileTooLargeError(
                    f"{self._name}, {name}: expected at most {self._limits.chunks} chunks, got {chunks}"
                )
            size = max(size, item * math.prod(chunk))
        self._unpacked += size
        if self._unpacked > self._limits.bytes:
            raise FileTooLargeError(
                f"{self._name}: expected to unpack to at most {self._limits.bytes} bytes, "
                f"got {self._unpacked} up to {name}"
            )

    def _strings(self, dataset: h5d.DatasetID, name: str, shape: tuple[int, ...]) -> None:
        """Add up the lengths of strings, which may all be the same long one."""
        count, total = math.prod(shape), 0
        if count > self._limits.strings:
            raise FileTooLargeError(
                f"{self._name}, {name}: expected at most {self._limits.strings} strings, got {count}"
            )
        texts = h5py.Dataset(dataset)
        for place in np.ndindex(shape):
            total += len(texts[place])
            if total > self._limits.string_bytes:
                raise FileTooLargeError(
                    f"{self._name}, {name}: expected strings of at most {self._limits.string_bytes} bytes"
                )

    def _attributes(self, owner: h5py.h5g.GroupID | h5d.DatasetID, name: str) -> None:
        count = h5a.get_num_attrs(owner)
        if count > self._limits.attributes:
            raise FileTooLargeError(
                f"{self._name}, {name}: expected at most {self._limits.attributes} attributes, got {count}"
            )
        for i in range(count):
            attribute = h5a.open(owner, index=i)
            label, kind = f"{name}, attribute {_shown(attribute.name)}", attribute.get_type()
            if attribute.name not in _SCALES:
                self._type(kind, label)
                if _is_text(kind) and math.prod(attribute.shape) != 1:
                    raise self._refuse(label, "one string", f"{math.prod(attribute.shape)} of them")
            size = kind.get_size() * math.prod(attribute.shape)
            if size > self._limits.attribute_bytes:
                most = self._limits.attribute_bytes
                raise FileTooLargeError(f"{self._name}, {label}: expected at most {most} bytes, got {size}")


def _is_text(kind: h5t.TypeID) -> bool:
    """Whether values are strings of any length, which lie elsewhere in the file."""
    return bool(kind.get_class() == h5t.STRING and kind.is_variable_str())


def _shown(name: bytes) -> str:
    return ascii(name.decode("utf-8", "replace")[:64])
