"""Names that read as what they are: no control characters, none that turn the direction of the text."""

from __future__ import annotations

import unicodedata

__all__ = ["plain_text"]

_REFUSED = {"Cc", "Cf", "Cs", "Zl", "Zp"}  # controls, invisible and turning ones, halves, ends of lines
_JOINERS = {"\u200c", "\u200d"}  # that Persian, Indian scripts and emoji are written with


def plain_text(name: str) -> str:
    """A name in its composed form (NFC).

    Raises
    ------
    ValueError
        If it has control characters, or such that are not seen or turn the direction of what follows.
    """
    composed = unicodedata.normalize("NFC", name)
    for letter in composed:
        if unicodedata.category(letter) in _REFUSED and letter not in _JOINERS:
            raise ValueError(f"expected letters that can be seen, got U+{ord(letter):04X}")
    return composed
