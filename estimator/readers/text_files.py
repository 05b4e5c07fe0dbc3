"""Text files of others, checked: lines with their numbers, and errors that name the line and the column."""

from __future__ import annotations

import gzip
import zlib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from estimator.errors import FileFormatError

__all__ = ["lines_of", "number", "seconds"]

_LARGEST = 1 << 28  # bytes of text; a packed file may not unpack to more
_LONGEST = 1 << 16  # characters of a line


def lines_of(path: Path, what: str) -> list[tuple[int, str]]:
    """The lines of a file that hold something, with their numbers, the first being 1; ``.gz`` is unpacked.

    Raises
    ------
    FileFormatError
        If there is no such file, it is no text, or larger than can be meant.
    """
    path = Path(path)
    if not path.is_file():
        raise FileFormatError(f"{path}: expected {what}, found nothing there")
    try:
        if path.suffix == ".gz":
            with gzip.open(path, "rb") as packed:
                data = packed.read(_LARGEST + 1)
        else:
            with path.open("rb") as plain:
                data = plain.read(_LARGEST + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise FileFormatError(f"{path}: expected {what}, could not read it: {error}") from error
    if len(data) > _LARGEST:
        raise FileFormatError(f"{path}: expected {what} of at most {_LARGEST >> 20} MiB, got more")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: expected {what}, a text in UTF-8, got byte {data[error.start]:#04x} at {error.start}"
        ) from error
    if "\0" in text:
        raise FileFormatError(f"{path}: expected {what}, a text, got a binary file")
    lines = [(i + 1, line.strip()) for i, line in enumerate(text.splitlines())]
    for i, line in lines:
        if len(line) > _LONGEST:
            raise FileFormatError(
                f"{path}, line {i}: expected at most {_LONGEST} characters, got {len(line)}"
            )
    return [(i, line) for i, line in lines if line]


def number(text: str, where: str, *, empty: bool = False) -> float:
    """A finite number; NaN for an empty text or ``nan`` where that may be.

    Raises
    ------
    FileFormatError
        If it is none; says ``where``.
    """
    text = text.strip()
    if empty and text.lower() in ("", "nan", "na", "null"):
        return np.nan
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise FileFormatError(f"{where}: expected a number, got {text[:40]!r}")
    return value


def seconds(text: str, where: str) -> float:
    """A time stamp in seconds: a number, or a date and time (ISO 8601, also with a space for the T).

    Raises
    ------
    FileFormatError
        If it is neither; says ``where``.
    """
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if np.isfinite(value):
        return value
    date, _, clock = text.strip().replace("T", " ").partition(" ")
    clock = clock.strip()
    if clock[1:2] == ":":
        clock = "0" + clock
    try:
        return datetime.fromisoformat(f"{date} {clock}").replace(tzinfo=UTC).timestamp()
    except (ValueError, OverflowError) as error:
        raise FileFormatError(
            f"{where}: expected seconds or a date and time (2022-08-15 09:42:24.766), got {text[:40]!r}"
        ) from error
