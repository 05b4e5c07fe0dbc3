"""Matrices of MATLAB files (version 5 to 7.2), read byte by byte: SciPy's reader crashes on damaged ones.

The layout is that of "MAT-File Format" (MathWorks): a header of 128 bytes, then elements, each with a type
and a number of bytes, padded to eight; a matrix is an element of elements: flags, dimensions, name, numbers.
Real numbers alone are read; cells, structures, text and objects are left out.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError

__all__ = ["read_matrices"]

Array = NDArray[np.float64]
_LARGEST = 1 << 28  # bytes of a file, and of what it unpacks to
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_REAL_CLASSES = range(6, 16)  # double, single and the integers
_COMPLEX = 0x0800


class _Damaged(Exception):
    """The bytes are none of such a file."""


class _Element(NamedTuple):
    """Type and bytes of an element."""

    kind: int
    data: bytes


def read_matrices(path: Path, names: tuple[str, ...]) -> dict[str, Array]:
    """The named matrices of a file, as far as it has them as real matrices of two dimensions.

    Parameters
    ----------
    path : Path
        The file.
    names : tuple of str
        The variables that are wanted; those beside cost nothing but their bytes.

    Raises
    ------
    FileFormatError
        If the file is missing, larger than 256 MiB, or damaged.
    """
    path, wanted = Path(path), f"a MATLAB file (version 5 to 7.2) with {', '.join(names)}"
    if not path.is_file():
        raise FileFormatError(f"{path}: expected {wanted}, found nothing there")
    if path.stat().st_size > _LARGEST:
        raise FileFormatError(f"{path}: expected {wanted} of at most {_LARGEST >> 20} MiB")
    data = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or data[124:126] not in (b"\x00\x01", b"\x01\x00"):
        raise FileFormatError(f"{path}: expected {wanted}, got another header")
    found: dict[str, Array] = {}
    try:
        for element in _elements(data[_HEADER:], order, padded=False):
            matrix = element
            if element.kind == _COMPRESSED:
                matrix = next(_elements(_unpacked(element.data), order, padded=True), element)
            if matrix.kind == _MATRIX:
                name, values = _matrix(matrix.data, order, names)
                if values is not None:
                    found[name] = values
    except (_Damaged, zlib.error) as error:
        raise FileFormatError(f"{path}: expected {wanted}, it is damaged: {error}") from error
    return found


def _unpacked(data: bytes) -> bytes:
    stream = zlib.decompressobj()
    unpacked = stream.decompress(data, _LARGEST)
    if stream.unconsumed_tail:
        raise _Damaged(f"expected at most {_LARGEST >> 20} MiB unpacked")
    return unpacked


def _elements(data: bytes, order: str, *, padded: bool) -> Iterator[_Element]:
    """The elements of some bytes, one after the other; compressed ones are not padded."""
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise _Damaged(f"expected 8 bytes of an element's head, got {len(data) - at}")
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small element has both in four bytes
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise _Damaged(f"expected at most 4 bytes in a small element, got {size}")
            yield _Element(kind, data[at + 4 : at + 4 + size])
            at += 8
            continue
        if size > len(data) - at - 8:
            raise _Damaged(f"expected {size} bytes of an element, got {len(data) - at - 8}")
        yield _Element(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
        if padded or kind != _COMPRESSED:
            at += -size % 8


def _matrix(data: bytes, order: str, names: tuple[str, ...]) -> tuple[str, Array | None]:
    """Name and values of a matrix; no values if it is not wanted, or no real matrix of two dimensions."""
    parts = _elements(data, order, padded=True)
    flags, size, label = (next(parts, None) for _ in range(3))
    if flags is None or size is None or label is None or len(flags.data) < 4 or len(size.data) % 4:
        raise _Damaged("expected flags, dimensions and a name of a matrix")
    name = label.data.decode("latin-1")
    (word,) = struct.unpack_from(f"{order}I", flags.data)
    if name not in names:
        return name, None
    shape = struct.unpack(f"{order}{len(size.data) // 4}i", size.data)
    if word & 0xFF not in _REAL_CLASSES or word & _COMPLEX or len(shape) != 2 or min(shape) < 0:
        return name, None
    numbers = next(parts, _Element(9, b""))
    if numbers.kind not in _NUMBERS:
        raise _Damaged(f"expected numbers of {name}, got type {numbers.kind}")
    kind = np.dtype(order + _NUMBERS[numbers.kind])
    if len(numbers.data) != shape[0] * shape[1] * kind.itemsize:
        raise _Damaged(f"expected {shape[0]} x {shape[1]} numbers of {name}, got {len(numbers.data)} bytes")
    return name, np.frombuffer(numbers.data, kind).reshape(shape, order="F").astype(np.float64)
