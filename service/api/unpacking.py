"""Packed bodies (gzip, zstd), unpacked piece by piece within the limit of a plain body."""

from __future__ import annotations

import gzip
import io
import sys
import zlib
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Protocol

from service.errors import TooLargeError, UnsupportedMediaError, ValidationError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

__all__ = ["ENCODINGS", "unpacked_body"]

ENCODINGS = ("gzip", "zstd")
_PIECE_BYTES = 2**20
_WINDOW_LOG = 23  # of zstd, 8 MiB: as much as RFC 9659 asks of a receiver
_ERRORS = (OSError, EOFError, zlib.error, zstd.ZstdError)


class Run(Protocol):
    """Runs a function in a thread."""

    def __call__(self, function: Callable[[], bytes]) -> Awaitable[bytes]:
        """What it returns."""
        ...


async def unpacked_body(
    body: bytes, encoding: str, limit: int, claim: Callable[[int], None], run: Run
) -> bytes:
    """A body as it was before it was packed.

    Parameters
    ----------
    body : bytes
        As it came.
    encoding : str
        One of `ENCODINGS`.
    limit : int
        Most that it may unpack to, bytes.
    claim : callable
        Told of each piece's bytes; may raise.
    run : callable
        Runs a piece of the work in a thread.

    Raises
    ------
    TooLargeError
        If it unpacks to more.
    ValidationError
        If it is not packed so, or incomplete.
    UnsupportedMediaError
        If the encoding is another.
    """
    if encoding not in ENCODINGS:
        raise UnsupportedMediaError(
            f"body: expected no content encoding, or {' or '.join(ENCODINGS)}, got {encoding[:64]}"
        )
    pieces, size = list[bytes](), 0
    reader = _reader(body, encoding)
    while True:
        try:
            piece = await run(partial(reader.read, _PIECE_BYTES))
        except _ERRORS as error:
            raise ValidationError(f"body: expected all of it packed as {encoding}, it is not") from error
        if not piece:
            return b"".join(pieces)
        size += len(piece)
        if size > limit:
            raise TooLargeError(f"body: expected to unpack to at most {limit} bytes, got more")
        claim(len(piece))
        pieces.append(piece)


def _reader(body: bytes, encoding: str) -> gzip.GzipFile | zstd.ZstdFile:
    if encoding == "gzip":
        return gzip.GzipFile(fileobj=io.BytesIO(body))
    options = {int(zstd.DecompressionParameter.window_log_max): _WINDOW_LOG}
    return zstd.ZstdFile(io.BytesIO(body), options=options)
