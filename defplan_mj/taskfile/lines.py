"""On which line of a TOML file each of its keys stands; for files that `tomllib` has accepted."""

from __future__ import annotations

import re
from collections.abc import Mapping

Path = tuple[str | int, ...]
"""Of keys, and of numbers in arrays of tables: ('gait_tasks', 1, 'move')."""

_KEY = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_DOTTED = re.compile(rf"\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*")
_SKIPPED = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}' r"|'''.*?'{3,5}" r'|"(?:[^"\\\n]|\\.)*"' r"|'[^'\n]*'" r"|#[^\n]*",
    re.DOTALL,
)


def key_lines(text: str) -> dict[Path, int]:
    """Return the line, from 1 on, of every table's header and of every key that stands on its own.

    What is written in braces or in an array has the line of its key: ask `line_of`.
    """
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
    place, number = 0, 1
    text = text.replace("\r\n", "\n")
    while place < len(text):
        end = _statement_end(text, place)
        statement = text[place:end]
        line = number
        stripped = statement.strip()
        if stripped.startswith("[["):
            names = _names(stripped[2:])
            where = _within(names[:-1], counts) + (names[-1],)
            counts[where] = counts.get(where, -1) + 1
            table = (*where, counts[where])
            lines.setdefault(where, line)
            lines[table] = line
        elif stripped.startswith("["):
            table = _within(_names(stripped[1:]), counts)
            lines[table] = line
        elif stripped and not stripped.startswith("#"):
            names = _names(stripped)
            for i in range(1, len(names) + 1):
                lines.setdefault((*table, *names[:i]), line)
        number += statement.count("\n") + 1
        place = end + 1
    return lines


def line_of(path: Path, lines: Mapping[Path, int]) -> int:
    """Return the line of a key, or of the nearest thing around it that has one."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def _statement_end(text: str, place: int) -> int:
    """Return where the statement that begins at `place` ends: at a newline outside brackets and strings."""
    depth = 0
    header = text[place:].lstrip(" \t").startswith("[")
    while place < len(text):
        skipped = _SKIPPED.match(text, place)
        if skipped:
            place = skipped.end()
            continue
        letter = text[place]
        if letter == "\n" and (depth <= 0 or header):
            return place
        depth += (letter in "[{") - (letter in "]}")
        place += 1
    return place


def _names(text: str) -> list[str]:
    """Return the names of a dotted key at the beginning of `text`."""
    match = _DOTTED.match(text)
    names = re.findall(_KEY, match.group(1)) if match else []
    return [name[1:-1] if name[0] in "\"'" else name for name in names] or [""]


def _within(names: list[str], counts: Mapping[Path, int]) -> Path:
    """Return the path of a table: in an array of tables it is in the last one."""
    path: Path = ()
    for name in names:
        path = (*path, name)
        if path in counts:
            path = (*path, counts[path])
    return path
