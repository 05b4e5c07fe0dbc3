"""JSON objects from files of strangers: what is none is refused in one line."""

from __future__ import annotations

import json
from typing import Any

from estimator.errors import FileFormatError

__all__ = ["json_object"]


def json_object(text: object, where: str) -> dict[str, Any]:
    """The object that a text says in JSON.

    Parameters
    ----------
    text : str or bytes
        What was found.
    where : str
        Where it stood, for the message.

    Raises
    ------
    FileFormatError
        If it is no text, no JSON, nested too deeply to be read, or no object.
    """
    if not isinstance(text, (str, bytes)):
        raise FileFormatError(f"{where}: expected a text of JSON, got {type(text).__name__}")
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise FileFormatError(f"{where}: expected JSON, could not read it: {reason}") from error
    if not isinstance(found, dict):
        raise FileFormatError(f"{where}: expected a JSON object, got {type(found).__name__}")
    return found
