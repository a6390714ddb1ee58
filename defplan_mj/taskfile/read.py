"""Reads a task file; whatever is wrong is one sentence with the file, the line and what was probably meant."""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
import typing
from collections.abc import Callable
from dataclasses import MISSING, replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE, SPACES
from defplan_mj.body.orientation import frame_of
from defplan_mj.dynamics.terrain import SIZES
from defplan_mj.task import TaskSpec
from defplan_mj.taskfile import lines
from defplan_mj.taskfile.fields import (
    BOUNDS,
    LEFT_OUT,
    NONE,
    Bound,
    Field,
    all_fields,
    fields_of,
    optional,
    table_of,
)
from defplan_mj.taskfile.source import read_source

MOST_WHOLE, MOST_SIZE, MOST_LETTERS = 1_000_000, 1e15, 1000
"""Of a whole number, of any other number, of a text."""
_WORDS: dict[type, str] = {
    int: "a whole number",
    float: "a number",
    str: "a text in quotes",
    bool: "true or false",
    Path: "a path in quotes",
}


def read_task(path: str | Path, mesh_needed: bool = True) -> TaskSpec:
    """Return the task that a file describes, its solvers filled in.

    Args:
        mesh_needed: the mesh, and files made before, have to be there.

    Raises:
        DefplanError: something in the file cannot be; nothing was done yet.
    """
    path = Path(path)
    data, places = read_source(path, "task file", f"`defplan new MESH -o {path}` writes one")
    return _Reader(path, places).task(data, mesh_needed)


class _Reader:
    """Turns plain data into a task; knows on which line everything stands."""

    def __init__(self, file: Path, places: dict[lines.Path, int]) -> None:
        self.file, self.places = file, places

    def fail(self, path: lines.Path, sentence: str) -> NoReturn:
        """Raise the sentence with file and line."""
        raise DefplanError(f"{self.file}, line {lines.line_of(path, self.places)}: {sentence}")

    def task(self, data: dict[str, Any], mesh_needed: bool) -> TaskSpec:
        """Return the whole task."""
        data.setdefault("name", self.file.stem)
        values = self.table(data, TaskSpec, ())
        for name in LEFT_OUT:
            if name not in values:
                values[name] = "" if name == "description" else fields_default(name)
        try:
            spec = TaskSpec(**values, file=Path(os.path.abspath(self.file)))
        except DefplanError as error:  # medium and terrain do not agree
            self.fail(("terrain",), str(error))
        self._check(spec)
        if mesh_needed:
            self._check_files(spec)
        return self._with_solvers(spec)

    # ---- values

    def table(self, data: Any, cls: type, path: lines.Path) -> dict[str, Any]:
        """Return the arguments of a dataclass from a table."""
        if not isinstance(data, dict):
            self.fail(path, f"{_called(path)} is a table, not {_shown(data)}")
        fields = {field.name: field for field in fields_of(cls, _table_name(path))}
        for name in data:
            if name not in fields:
                self.fail((*path, name), self._unknown(name, path, fields))
        values = {}
        for name, field in fields.items():
            if name in data:
                values[name] = self.value(data[name], field, (*path, name), BOUNDS.get(cls, {}))
            elif field.default is MISSING:
                self.fail(path, f"{_called((*path, name))} is missing: {field.text}")
        return values

    def value(self, data: Any, field: Field, path: lines.Path, bounds: dict[str, Bound]) -> Any:
        """Return the value of a field, of its type and within its bounds."""
        kind, may_be_none = optional(field.kind)
        if may_be_none and data == NONE:
            return None
        special: dict[str, Callable[[Any, lines.Path], Any]] = {
            "skin": self.skin,
            "paper": self.anything,
        }
        if field.path in special:
            return special[field.path](data, path)
        value = self.typed(data, kind, path, may_be_none)
        bound = bounds.get(field.name)
        if bound is not None and not bound.fits(value):
            self.fail(path, f"{_called(path)} is {_shown(data)}: it must be {bound.words}")
        return value

    def typed(self, data: Any, kind: Any, path: lines.Path, may_be_none: bool = False) -> Any:
        """Return data as a type."""
        if dataclasses.is_dataclass(kind):
            assert isinstance(kind, type)
            return kind(**self.table(data, kind, path))
        if kind is np.ndarray:
            return self.grid(data, path)
        if typing.get_origin(kind) is tuple:
            return self.row(data, typing.get_args(kind), path)
        kinds = _WORDS[kind] + (f", or '{NONE}'" if may_be_none else "")
        if isinstance(data, bool) is not (kind is bool):
            self.fail(path, f"{_called(path)} is {_shown(data)}: it must be {kinds}")
        if kind is float and isinstance(data, int | float):
            return self.number(data, path)
        if isinstance(data, str) and len(data) > MOST_LETTERS:
            self.fail(path, f"{_called(path)} is longer than {MOST_LETTERS} letters")
        if kind is Path and isinstance(data, str):
            if "\0" in data or not data:
                self.fail(path, f"{_called(path)} is {_shown(data)}: it must be {kinds}")
            return Path(os.path.abspath(self.file.parent / Path(data).expanduser()))
        if not isinstance(data, kind):
            self.fail(path, f"{_called(path)} is {_shown(data)}: it must be {kinds}")
        if kind is int and abs(data) > MOST_WHOLE:
            self.fail(path, f"{_called(path)} is {_shown(data)}: it can be {MOST_WHOLE} at most")
        return data

    def number(self, data: int | float, path: lines.Path) -> float:
        """Return a finite number."""
        try:
            value = float(data)
        except OverflowError:
            value = math.inf
        if not abs(value) <= MOST_SIZE:
            self.fail(
                path,
                f"{_called(path)} is {_shown(data)}: it must be a finite number, {MOST_SIZE:g} at most",
            )
        return value

    def row(self, data: Any, kinds: tuple[Any, ...], path: lines.Path) -> tuple:
        """Return an array as a tuple: of as many entries as there are kinds, or of any number."""
        many = kinds[-1] is Ellipsis
        inner = table_of(kinds[0])
        if not isinstance(data, list):
            what = "an array of tables, each " + _brackets(path) if inner else "an array"
            self.fail(path, f"{_called(path)} is {_shown(data)}: it must be {what}")
        if not many and len(data) != len(kinds):
            self.fail(path, f"{_called(path)} has {len(data)} entries: it must have {len(kinds)}")
        each = kinds[:1] * len(data) if many else kinds
        return tuple(
            self.typed(entry, kind, (*path, i))
            for i, (entry, kind) in enumerate(zip(data, each, strict=True))
        )

    def grid(self, data: Any, path: lines.Path) -> np.ndarray:
        """Return rows of numbers."""
        rows = data if isinstance(data, list) else []
        size = len(rows[0]) if rows and isinstance(rows[0], list) else -1
        if any(not isinstance(row, list) or len(row) != size for row in rows) or size < 1:
            self.fail(path, f"{_called(path)} must be rows of numbers, all of one length")
        return np.array([[self.typed(x, float, path) for x in row] for row in rows])

    def skin(self, data: Any, path: lines.Path) -> Any:
        """Return what makes the picture of an installed task's body."""
        if not isinstance(data, str):
            self.fail(path, f"{_called(path)} is {_shown(data)}: it must be a task's name")
        if len(data) > MOST_LETTERS:
            self.fail(path, f"{_called(path)} is longer than {MOST_LETTERS} letters")
        try:
            return registry.get_task(data).skin
        except DefplanError as error:
            self.fail(path, str(error))

    def anything(self, data: Any, path: lines.Path) -> dict[str, Any]:
        """Return a table of numbers and texts, its arrays as tuples."""
        if not isinstance(data, dict):
            self.fail(path, f"{_called(path)} is a table, not {_shown(data)}")
        return {name: self.plain(value, (*path, name)) for name, value in data.items()}

    def plain(self, value: Any, path: lines.Path) -> Any:
        """Return a number, a text, or arrays and tables of these."""
        if isinstance(value, list):
            return tuple(self.plain(entry, path) for entry in value)
        if isinstance(value, dict):
            return self.anything(value, path)
        if isinstance(value, float):
            return self.number(value, path)
        if not isinstance(value, str | int):
            self.fail(path, f"{_called(path)} is {_shown(value)}: it must be a number or a text")
        return value

    def _unknown(self, name: str, path: lines.Path, fields: dict[str, Field]) -> str:
        """Return the sentence for a field that there is not: what was probably meant, and where."""
        where = f"in {_brackets(path)}" if path else "at the top"
        sentence = f"there is no field `{name}` {where}"
        if close := difflib.get_close_matches(name.lower(), fields, n=1, cutoff=0.6):
            return f"{sentence}, did you mean {close[0]}?"
        elsewhere = [f for f in all_fields() if f.name == name]
        if elsewhere:
            table = elsewhere[0].table
            return f"{sentence}: it belongs {f'in [{table}]' if table else 'at the top, before any table'}"
        every = {f.name: f for f in all_fields()}
        if close := difflib.get_close_matches(name.lower(), every, n=1, cutoff=0.7):
            table = every[close[0]].table
            return (
                f"{sentence}, did you mean {close[0]} {f'in [{table}]' if table else 'at the top'}?"
            )
        return f"{sentence}; there is: {', '.join(fields)}"

    # ---- what has to fit together

    def _check(self, spec: TaskSpec) -> None:
        """Fail for what is right by itself, and wrong together."""
        names = [task.name for task in spec.gait_tasks]
        planar = SPACES[spec.navigation.space] is PLANE
        for i, task in enumerate(spec.gait_tasks):
            here: lines.Path = ("gait_tasks", i)
            if task.name in names[:i]:
                self.fail((*here, "name"), f"there are two gait tasks of the name {task.name}")
            if not task.advance and not task.angle:
                self.fail(here, f"the gait {task.name} wants nothing: give it a turn or a move")
            if planar and any(task.turn[:2]):
                self.fail(
                    (*here, "turn"),
                    f"the gait {task.name} turns out of the plane: only the third number of"
                    " turn can be other than 0 where the space is 'planar'",
                )
        try:
            if spec.body.up and spec.body.forward:
                frame_of(spec.body.up, spec.body.forward)
        except DefplanError as error:
            self.fail(("body", "forward"), str(error))
        for i, geom in enumerate(spec.terrain.geoms if spec.terrain else ()):
            if len(geom.size) != SIZES[geom.shape]:
                self.fail(
                    ("terrain", "geoms", i, "size"),
                    f"a {geom.shape} has {SIZES[geom.shape]} sizes, not {len(geom.size)}",
                )
        if spec.terrain and not spec.terrain.geoms and spec.terrain.heightfield is None:
            self.fail(("terrain", "geoms"), "the terrain has neither geoms nor a heightfield")

    def _check_files(self, spec: TaskSpec) -> None:
        """Fail if a file that the task names is not there."""
        files = [("mesh", spec.mesh, "mesh file")]
        files += [("shipped", path, "file") for path in spec.shipped or ()]
        for name, path, what in files:
            if not os.path.isfile(path):  # False, too, if there can be no such name
                near = _nearest_file(path)
                self.fail((name,), f"the {what} {path} does not exist{near}")

    def _with_solvers(self, spec: TaskSpec) -> TaskSpec:
        """Return the task with the default solvers where it names none; fail if one is unknown."""
        chosen = {name: getattr(spec, name) for name in registry.CHOICES}
        filled: dict[str, Any] = {**registry.with_defaults(chosen)}
        for name, kind in registry.CHOICES.items():
            if chosen[name]:
                self._asked((name,), partial(registry.get_solver, chosen[name], kind))
        for i, rival in enumerate(spec.rivals):
            self._asked(("rivals", i), partial(registry.get_solver, rival, "gait"))
        sensor, space = spec.navigation.sensor, spec.navigation.space
        if sensor:
            plugin = self._asked(("navigation", "sensor"), partial(registry.get_sensor, sensor))
            spaces = getattr(plugin, "spaces", (space,))
            if space not in spaces:
                self.fail(
                    ("navigation", "sensor"),
                    f"the sensor {sensor} is for a {' or '.join(spaces)} space, not for a {space} one",
                )
        return replace(spec, **filled)

    def _asked(self, path: lines.Path, look: Callable[[], Any]) -> Any:
        try:
            return look()
        except DefplanError as error:
            self.fail(path, str(error))


def fields_default(name: str) -> Any:
    """Return what a table of a task is that the file leaves out."""
    kind = typing.get_type_hints(TaskSpec)[name]
    return kind()


def _table_name(path: lines.Path) -> str:
    return ".".join(part for part in path if isinstance(part, str))


def _brackets(path: lines.Path) -> str:
    """Return a table as its header names it."""
    name = _table_name(path)
    named = next((field for field in all_fields() if field.path == name), None)
    many = named is not None and typing.get_origin(optional(named.kind)[0]) is tuple
    return f"[[{name}]]" if many else f"[{name}]"


def _called(path: lines.Path) -> str:
    """Return a field as sentences name it."""
    if not path:
        return "the file"
    names = [part for part in path if isinstance(part, str)]
    if path[-1] != names[-1]:
        return f"an entry of {_called(path[: path.index(names[-1]) + 1])}"
    return f"`{names[-1]}`" + (f" in {_brackets(path[:-1])}" if len(names) > 1 else "")


def _shown(value: Any) -> str:
    """Return a value as sentences show it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "an array"
    if isinstance(value, dict):
        return "a table"
    try:
        text = repr(value) if isinstance(value, str) else str(value)
    except ValueError:  # more digits than Python prints
        return "a number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _nearest_file(path: Path) -> str:
    """Return ', did you mean NAME?' if there is a file of about that name beside it."""
    try:
        there = [entry.name for entry in path.parent.iterdir() if entry.is_file()]
    except OSError:
        return f": there is no folder {path.parent}"
    close = difflib.get_close_matches(path.name, there, n=1, cutoff=0.6)
    return f", did you mean {close[0]}?" if close else ""
