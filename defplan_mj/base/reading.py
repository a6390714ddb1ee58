"""Reading what others may have written: every size is known and bounded before memory is taken for it."""

from __future__ import annotations

import json
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defplan_mj.base.errors import DefplanError

MOST_JSON_BYTES = 64 << 20
MOST_JSON_GROUPS = 250_000  # lists and objects, about 100 bytes each when they are read
MOST_JSON_VALUES = 2_000_000
MOST_JSON_DEPTH = 64
_DIGITS = 19  # of the largest whole number of 64 bits

_MANY_DIGITS = re.compile(r"\d{19}")


@dataclass(frozen=True)
class Packed:
    """A file that lies in memory, for example in a log.

    Attributes:
        name: what messages call it.
        data: its bytes.
    """

    name: str
    data: bytes

    def __str__(self) -> str:
        return self.name


def read_bytes(path: str | Path, what: str, most: int) -> bytes:
    """Return the bytes of a regular file.

    Args:
        what: what messages call it, e.g. 'log'.
        most: bytes that it may have.

    Raises:
        DefplanError: it is missing, no regular file (a device or a pipe may have no end), or too large.
    """
    path = Path(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise DefplanError(f"cannot read {what} {path}: it is a folder")
        if not stat.S_ISREG(status.st_mode):
            raise DefplanError(f"cannot read {what} {path}: it is no regular file")
        if status.st_size > most:
            raise DefplanError(
                f"{what} {path} is too large: {status.st_size} bytes, at most {most} are read"
            )
        with open(path, "rb") as stream:
            return stream.read(most)
    except FileNotFoundError as error:
        raise DefplanError(f"{what} {path} does not exist") from error
    except OSError as error:
        raise DefplanError(f"cannot read {what} {path}: {error.strerror or error}") from error
    except ValueError as error:  # a zero byte in its name
        raise DefplanError(f"cannot read {what} {path}: that is no name of a file") from error


def parse_json(text: str | bytes, most_values: int = MOST_JSON_VALUES) -> Any:
    """Return what a JSON text says.

    Args:
        most_values: numbers, texts, lists and objects that it may hold.

    Raises:
        ValueError: it is no JSON, too large, nested too deeply, or has a whole number of more than 64 bits.
    """
    if len(text) > MOST_JSON_BYTES:
        raise ValueError(f"it is larger than {MOST_JSON_BYTES} bytes")
    if isinstance(text, bytes):
        text = text.decode("utf-8")
    groups = text.count("[") + text.count("{")
    if groups > MOST_JSON_GROUPS or groups + text.count(",") + text.count(":") > most_values:
        raise ValueError("it holds too many values")
    integer = _integer if _MANY_DIGITS.search(text) else None
    try:
        value = json.loads(text, parse_int=integer)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if groups > MOST_JSON_DEPTH:
        _check_depth(value)
    return value


def read_json(path: str | Path, what: str) -> dict[str, Any]:
    """Return the object that a JSON file holds.

    Raises:
        DefplanError: it is missing or holds none.
    """
    try:
        value = parse_json(read_bytes(path, what, MOST_JSON_BYTES))
    except ValueError as error:
        raise DefplanError(f"{what} {path} cannot be read: {first_line(error)}") from error
    if not isinstance(value, dict):
        raise DefplanError(f"{what} {path} holds no object: make it anew")
    return value


def first_line(error: BaseException) -> str:
    """Return the first line of what an error says, cut at 200 characters; else its kind."""
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__


def _integer(digits: str) -> int:
    if len(digits.lstrip("-")) > _DIGITS:
        raise ValueError(f"it has a whole number of {len(digits)} digits")
    return int(digits)


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(MOST_JSON_DEPTH):
        level = [
            inner
            for outer in level
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, dict | list)
        ]
        if not level:
            return
    raise ValueError(f"it is nested more than {MOST_JSON_DEPTH} deep")
