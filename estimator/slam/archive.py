"""States of the engines as bytes: npz archives without pickles, equal states to equal bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from estimator.errors import FileFormatError

__all__ = ["Columns", "pack", "unpack"]

Columns = Mapping[str, Any]
State = TypeVar("State")


def pack(kind: str, columns: Mapping[str, ArrayLike]) -> bytes:
    """Named arrays, and what ``kind`` of state they are, as bytes."""
    stream = io.BytesIO()
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    np.savez(stream, allow_pickle=False, format=np.array(kind), **arrays)
    return stream.getvalue()


def unpack(kind: str, data: bytes, build: Callable[[Columns], State]) -> State:
    """What ``build`` makes of the arrays that :func:`pack` made ``data`` from.

    Raises
    ------
    FileFormatError
        If ``data`` is truncated, another kind of state or something else.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            columns = {name: archive[name] for name in archive.files}
        found = str(columns["format"])
        if found != kind:
            raise FileFormatError(f"state: expected {kind}, got {found}")
        return build(columns)
    except (ValueError, OSError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"state: expected {kind}, could not read {len(data)} bytes: {error}") from error
