"""Writes a task as a file: every field, with what it means; what is read from it is the same task."""

from __future__ import annotations

import json
import math
import os
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj import registry
from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.task import TaskSpec
from defplan_mj.taskfile.fields import NONE, Field, fields_of, optional, table_of

WIDTH = 100
_FARTHEST = 3  # folders up that a relative path may climb

_HEAD = """\
# A task of defplan: {name}. Run it with
#
#     defplan run {file}
#
# Every field is here with its unit; what is left out has its default (docs/plugins.md has the table).
# Frame of the body: x ahead, y left, z up. Metres, kilograms, seconds, radians.
"""


def write_task(spec: TaskSpec, path: str | Path, notes: Sequence[str] = ()) -> Path:
    """Write a task file, atomically.

    Args:
        notes: sentences for its head: what was guessed.

    Raises:
        DefplanError: something of the task cannot be said in a file.
    """
    path = Path(path)
    files.write_text(path, task_text(spec, path, notes))
    return path


def task_text(spec: TaskSpec, path: str | Path, notes: Sequence[str] = ()) -> str:
    """Return what `write_task` writes."""
    path = Path(path)
    text = _HEAD.format(name=_comment(spec.name), file=_comment(path.name))
    for note in notes:
        text += "\n".join(["#", *_wrapped(note), ""])
    text += "\n" + "\n".join(_table(spec, TaskSpec, "", path.parent))
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise DefplanError(f"{path} cannot be written: a path in it is no text") from error
    return text.rstrip("\n") + "\n"


def _table(
    value: Any, cls: type, name: str, folder: Path, brackets: str = "", explained: bool = True
) -> list[str]:
    """Return the lines of a table and of those within it."""
    lines = [brackets] if brackets else []
    fields = fields_of(cls, name)
    plain = [f for f in fields if table_of(f.kind) is None and f.path != "paper"]
    for field in plain:
        lines += _entry(field, getattr(value, field.name), folder, explained)
    filled = [f for f in fields if f not in plain and getattr(value, f.name) != ()]
    lines += [f"{f.name} = []" for f in fields if f not in plain and f not in filled]
    for field in filled:
        lines += _inner(field, getattr(value, field.name), folder)
    return lines


def _inner(field: Field, value: Any, folder: Path) -> list[str]:
    """Return the lines of a field that is a table, or several."""
    text = f"{field.text[:1].upper()}{field.text[1:]}"
    if value is None or value == {}:
        return ["", *_wrapped(f"{text}: [{field.path}]")]
    head = ["", *_wrapped(text)]
    if field.path == "paper":
        return [*head, f"[{field.path}]", *_free(value)]
    cls = table_of(field.kind)
    assert cls is not None
    if isinstance(value, tuple):
        lines = head
        for i, entry in enumerate(value):
            lines += [""] * (i > 0)
            lines += _table(entry, cls, field.path, folder, f"[[{field.path}]]", i == 0)
        return lines
    return [*head, *_table(value, cls, field.path, folder, f"[{field.path}]")]


def _entry(field: Field, value: Any, folder: Path, explained: bool) -> list[str]:
    """Return the lines of one value and its comment."""
    said = _said(field, value, folder)
    _, may_be_none = optional(field.kind)
    if said is None:
        said = _string(NONE) if may_be_none else '""'
    line = f"{field.name} = {said}"
    if not field.text or not explained:
        return [line]
    short = f"{line}  # {field.text}"
    return [short] if len(short) <= WIDTH else [*_wrapped(field.text), line]


def _said(field: Field, value: Any, folder: Path) -> str | None:
    """Return a value in TOML; None: it has none."""
    if field.path == "skin" and value is not None:
        return _string(_wearer(value))
    if value is None:
        return None
    return _toml(value, folder)


def _wearer(skin: Any) -> str:
    """Return the name of the first installed task whose body wears a skin."""
    for entry in registry.tasks():
        if not entry.error and entry.value.skin is skin:
            return entry.name
    raise DefplanError(
        "the task's skin is a function of no installed task: a task file can only name a task whose"
        " skin its body wears"
    )


def _toml(value: Any, folder: Path) -> str:
    """Return numbers, texts, paths and arrays of them in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        number = float(value)
        if not math.isfinite(number):
            raise DefplanError(f"a task file cannot say {number}")
        return repr(number)
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, Path):
        return _string(_path(value, folder))
    if isinstance(value, np.ndarray):
        return _toml(value.tolist(), folder)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(entry, folder) for entry in value)}]"
    raise DefplanError(f"a task file cannot say a {type(value).__name__}")


def _free(value: Mapping[str, Any]) -> list[str]:
    """Return the lines of a table that may hold anything plain."""
    lines = []
    for name, entry in value.items():
        if isinstance(entry, Mapping):
            pairs = ", ".join(line for line in _free(entry))
            lines.append(f"{_string(str(name))} = {{{pairs}}}")
        else:
            key = name if name.isidentifier() and name.isascii() else _string(str(name))
            lines.append(f"{key} = {_toml(entry, Path())}")
    return lines


def _path(path: Path, folder: Path) -> str:
    """Return a path from a folder on, unless that climbs far."""
    absolute = os.path.abspath(path)
    try:
        near = os.path.relpath(absolute, os.path.abspath(folder))
    except ValueError:  # another drive
        return absolute
    climbs = Path(near).parts[: _FARTHEST + 1] == (os.pardir,) * (_FARTHEST + 1)
    return absolute if climbs else Path(near).as_posix()


def _string(text: str) -> str:
    """Return a text as TOML's basic string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _comment(text: str) -> str:
    """Return a text for a comment: in one line, without what cannot be printed."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _wrapped(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(_comment(text), WIDTH - 2)]
