"""Text that a file may have brought along, made safe for a terminal: the one place where that is done."""

from __future__ import annotations

import re

# Control characters (tabs apart), marks that turn the direction of writing, separators of lines and
# paragraphs, halves of characters (of file names that are no UTF-8, and of JSON).
_UNSAFE = re.compile(
    "[\x00-\x08\x0a-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)


MOST_LETTERS = 100
"""Of a name that a file gives to something."""


def is_name(text: str) -> bool:
    """Return whether a text can be a name: not empty, not long, nothing in it that steers a terminal."""
    return 0 < len(text) <= MOST_LETTERS and not _UNSAFE.search(text)


def printable(text: str, lines: bool = False) -> str:
    """Return `text` with what would steer a terminal written out, for example as \\x1b.

    Args:
        lines: line ends stay.
    """
    return _UNSAFE.sub(lambda match: _written(match[0], lines), text)


def _written(character: str, lines: bool) -> str:
    if lines and character == "\n":
        return character
    return character.encode("unicode_escape", "surrogatepass").decode()
