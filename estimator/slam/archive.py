"""States of the engines as bytes without pickles, equal states to equal bytes.

A head in JSON names each array with its type and shape; their bytes follow in that order, then the CRC-32 of
all. A ZIP archive of sixty small arrays takes longer than a step, and a service saves at each epoch.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from estimator.errors import FileFormatError

__all__ = ["Columns", "pack", "unpack"]

Columns = Mapping[str, Any]
State = TypeVar("State")
_LENGTH = struct.Struct("<Q")  # of the head, bytes
_CHECK = struct.Struct("<I")
_PLAIN = "biufcU"  # kinds of arrays that are their bytes: no objects


def pack(kind: str, columns: Mapping[str, ArrayLike]) -> bytes:
    """Named arrays, and what ``kind`` of state they are, as bytes.

    Raises
    ------
    ValueError
        If an array holds anything but numbers, truth values or text.
    """
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    for name, array in arrays.items():
        if array.dtype.kind not in _PLAIN:
            raise ValueError(f"{name}: expected numbers or text, got {array.dtype}")
    described = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    head = json.dumps([kind, described], separators=(",", ":")).encode()
    content = b"".join([_LENGTH.pack(len(head)), head, *(array.tobytes() for array in arrays.values())])
    return content + _CHECK.pack(zlib.crc32(content))


def unpack(kind: str, data: bytes, build: Callable[[Columns], State]) -> State:
    """What ``build`` makes of the arrays that :func:`pack` made ``data`` from.

    Raises
    ------
    FileFormatError
        If ``data`` is truncated, another kind of state or something else.
    """
    try:
        found, columns = _read(data)
        if found != kind:
            raise FileFormatError(f"state: expected {kind}, got {found}")
        return build(columns)
    except (ValueError, KeyError, TypeError, AttributeError, struct.error) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"state: expected {kind}, could not read {len(data)} bytes: {error}") from error


def _read(data: bytes) -> tuple[str, Columns]:
    """Kind and arrays; raises ValueError or struct.error where these are not bytes of a state."""
    end = len(data) - _CHECK.size
    if end < _LENGTH.size or _CHECK.unpack_from(data, end)[0] != zlib.crc32(memoryview(data)[:end]):
        raise ValueError("expected their checksum at their end")
    (length,), at = _LENGTH.unpack_from(data), _LENGTH.size
    kind, described = json.loads(data[at : at + length])
    at, columns = at + length, dict[str, Any]()
    for name, text, shape in described:
        dtype, count = np.dtype(text), math.prod(shape)
        if dtype.kind not in _PLAIN:
            raise ValueError(f"{name}: expected numbers or text, got {dtype}")
        if at + count * dtype.itemsize > end:
            raise ValueError(f"{name}: expected {count} entries of {dtype}")
        columns[name] = np.ndarray(shape, dtype, data, at).copy()
        at += count * dtype.itemsize
    return str(kind), columns
