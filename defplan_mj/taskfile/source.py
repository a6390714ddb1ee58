"""Reads a TOML file of the user's: its data, and on which line each key stands; or one sentence."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.taskfile import lines

MOST_BYTES = 1_000_000
MOST_BRACKETS = 20_000  # of tables and arrays
# tables in tables by a dotted key: reading it takes the square of its length
_DEEP = re.compile(r"(?:\.[^.,=\[\]{}\n]+){64}")


def read_source(path: Path, what: str, mends: str) -> tuple[dict[str, Any], dict[lines.Path, int]]:
    """Return what a TOML file says, and the line of each of its keys (`lines.key_lines`).

    Args:
        what: the file is, for sentences: 'task file'.
        mends: what to do if there is none.

    Raises:
        DefplanError: there is none, it cannot be read, or it is no TOML.
    """
    text = _text_of(path, what, mends)
    if text.count("[") > MOST_BRACKETS:
        raise DefplanError(f"{path} cannot be read: it has more than {MOST_BRACKETS} brackets")
    if _DEEP.search(text):
        raise DefplanError(f"{path} cannot be read: it is nested too deeply")
    try:
        data = tomllib.loads(text)
    except RecursionError as error:
        raise DefplanError(f"{path} cannot be read: it is nested too deeply") from error
    except ValueError as error:
        raise DefplanError(_syntax_sentence(path, error)) from error
    return data, lines.key_lines(text)


def _text_of(path: Path, what: str, mends: str) -> str:
    try:
        if path.is_dir():
            raise DefplanError(f"{path} is a folder: name the {what} in it")
        if path.stat().st_size > MOST_BYTES:
            raise DefplanError(f"{path} is too large for a {what}")
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError as error:
        raise DefplanError(f"{what} {path} does not exist: {mends}") from error
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise DefplanError(f"{what} {path} cannot be read: {reason}") from error


def _syntax_sentence(path: Path, error: ValueError) -> str:
    """Return the sentence for a file that is no TOML."""
    message, _, place = str(error).rpartition(" (at ")
    if not message:
        message, place = str(error), ""
    line = f", {place.rstrip(')').partition(',')[0]}" if place.startswith("line") else ""
    ending = " (at its end)" if place and not line else ""
    message = message.splitlines()[0][:120]
    return f"{path}{line}: this is no TOML: {message[:1].lower()}{message[1:]}{ending}"
