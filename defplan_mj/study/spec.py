"""What a study file says, as plain data; whatever is wrong in one is a sentence with file and line."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.taskfile import lines
from defplan_mj.taskfile.find import MEDIA, SUFFIX, find_task, is_file, is_mesh, mesh_task_name
from defplan_mj.taskfile.source import read_source

UNTIL = ("gait", "surrogate", "planner", "evaluation", "report")
"""The stages that the runs of a study can end with."""
PAGES = ("study", "paper", "optimisers")
"""What a study's page can be: the same for all, with what else is asked of these."""
AXES = {"gait_solvers": "gait", "planners": "planner", "feedbacks": "feedback"}
"""Lists of plugins, and of which kind; left out: the task's own."""
MOST_RUNS = 1_000_000
_ROBOTS = ("tasks", "meshes", "medium")


@dataclass(frozen=True)
class Variant:
    """Options of runs under a name.

    Attributes:
        name: names the runs' folder; '' of a study without variants.
        options: fields of `pipeline.plan.RunOptions`.
    """

    name: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A matrix of runs.

    Attributes:
        name: of its folder.
        description: a sentence for the page.
        tasks: names, or paths of task files.
        meshes: paths of mesh files, whose tasks are guessed when they are run.
        medium: what these move in, or on: 'water' or 'ground'.
        seeds: of the runs.
        gait_solvers, planners, feedbacks: by name; '': the task's own.
        variants: options, at least one entry.
        leave_out: runs that are not made: those of which all entries of one of these are true.
        until: the last stage of the runs, one of `UNTIL`.
        page: one of `PAGES`.
        roles: plugins that the page asks for by what they are there for, e.g. 'bound'.
        file: that it was read from.
    """

    name: str
    tasks: tuple[str, ...]
    description: str = ""
    meshes: tuple[str, ...] = ()
    medium: str = ""
    seeds: tuple[int, ...] = (0,)
    gait_solvers: tuple[str, ...] = ("",)
    planners: tuple[str, ...] = ("",)
    feedbacks: tuple[str, ...] = ("",)
    variants: tuple[Variant, ...] = (Variant(),)
    leave_out: tuple[Mapping[str, Any], ...] = ()
    until: str = "report"
    page: str = "study"
    roles: Mapping[str, str] = field(default_factory=dict)
    file: Path = Path()


def find_study(name: str, quick: bool = False) -> Study:
    """Return the study of a file (*.toml), or the installed one of that name.

    Args:
        quick: with what the file's table [quick] says instead.

    Raises:
        DefplanError: there is none, or something in its file cannot be.
    """
    if is_file(name):
        return read_study(name, quick)
    try:
        path = registry.get_study(name)
    except DefplanError as error:
        if Path(name).is_file():
            raise DefplanError(f"{name} is no study file: such a file ends in {SUFFIX}") from error
        raise
    return read_study(path, quick)


def read_study(path: str | Path, quick: bool = False) -> Study:
    """Return the study that a file describes; see `find_study`."""
    path = Path(path)
    mends = "docs/studies.md shows how to write one"
    data, places = read_source(path, "study file", mends)
    return _Reader(path, places).study(data, quick)


class _Reader:
    """Turns plain data into a study; knows on which line everything stands."""

    def __init__(self, file: Path, places: dict[lines.Path, int]) -> None:
        self.file, self.places = file, places

    def fail(self, path: lines.Path, sentence: str) -> NoReturn:
        """Raise the sentence with file and line."""
        raise DefplanError(f"{self.file}, line {lines.line_of(path, self.places)}: {sentence}")

    def study(self, data: dict[str, Any], quick: bool) -> Study:
        """Return the whole study."""
        fields = ("name", "description", *_ROBOTS, "seeds", *AXES, "until", "page", "options")
        self.known(data, (*fields, "variants", "leave_out", "roles", "quick"), ())
        instead = self.table(data, "quick", ())
        asked = (*_ROBOTS, "seeds", *AXES, "options", "variants", "until")
        self.known(instead, asked, ("quick",))
        if quick and not instead:
            self.fail((), "this study has no quick form: it has no table [quick]")
        if not quick:
            instead = {}
        name = self.plain_name(data.get("name", self.file.stem), ("name",))

        def of(key: str) -> tuple[Any, lines.Path]:
            return (instead[key], ("quick", key)) if key in instead else (data.get(key), (key,))

        base = self.options(self.table(data, "options", ()), ("options",))
        base |= self.options(self.table(instead, "options", ("quick",)), ("quick", "options"))
        chosen = {axis: self.plugins(*of(axis), kind) for axis, kind in AXES.items()}
        meshes, medium = self.meshes(*of("meshes"), of("medium")[0])
        tasks = () if meshes and of("tasks")[0] is None else self.tasks(*of("tasks"))
        return Study(
            name=f"{name}-quick" if quick else name,
            description=self.text(data, "description", ""),
            tasks=tasks,
            meshes=meshes,
            medium=medium,
            seeds=self.seeds(*of("seeds")),
            variants=self.variants(*of("variants"), base),
            leave_out=self.leave_out(data.get("leave_out"), ("leave_out",)),
            until=self.one_of({**data, **instead}, "until", UNTIL, "report"),
            page=self.one_of(data, "page", PAGES, "study"),
            roles=self.roles(self.table(data, "roles", ())),
            file=self.file,
            **chosen,
        )

    # ---- fields

    def known(self, data: Mapping[str, Any], fields: Sequence[str], path: lines.Path) -> None:
        """Fail for a key that there is not."""
        for name in data:
            if name not in fields:
                where = f"in [{'.'.join(map(str, path))}]" if path else "at the top"
                close = difflib.get_close_matches(name, fields, n=1, cutoff=0.6)
                guess = (
                    f", did you mean {close[0]}?" if close else f"; there is: {', '.join(fields)}"
                )
                self.fail((*path, name), f"there is no field `{name}` {where}{guess}")

    def table(self, data: Mapping[str, Any], name: str, path: lines.Path) -> dict[str, Any]:
        """Return a table, or an empty one."""
        value = data.get(name, {})
        if not isinstance(value, dict):
            self.fail((*path, name), f"`{name}` is a table, not {value!r}")
        return value

    def text(self, data: Mapping[str, Any], name: str, default: str) -> str:
        """Return a text."""
        value = data.get(name, default)
        if not isinstance(value, str):
            self.fail((name,), f"`{name}` must be a text in quotes, not {value!r}")
        return value

    def plain_name(self, value: Any, path: lines.Path) -> str:
        """Return what can name a folder."""
        if not isinstance(value, str) or not re.fullmatch(r"[\w][\w.+-]{0,98}", value):
            self.fail(path, f"`name` is {value!r}: it must be letters, digits, - and _")
        return value

    def one_of(self, data: Mapping[str, Any], name: str, words: Sequence[str], default: str) -> str:
        """Return one of some words."""
        value = data.get(name, default)
        if value not in words:
            self.fail((name,), f"`{name}` is {value!r}: it must be {', '.join(words)}")
        return value

    def row(self, data: Any, path: lines.Path) -> list[Any]:
        """Return a list that is not empty and has nothing twice."""
        if not isinstance(data, list) or not data:
            self.fail(path, f"`{path[-1]}` must be a list of one or more")
        for i, value in enumerate(data):
            if value in data[:i]:
                self.fail(path, f"`{path[-1]}` has {value!r} twice")
        return data

    def tasks(self, data: Any, path: lines.Path) -> tuple[str, ...]:
        """Return the tasks; a file is named from this file's folder on."""
        if data is None:
            self.fail(
                (), "`tasks` is missing: names, or paths of task files, in a list; or `meshes`"
            )
        tasks, names = [], []
        for task in self.row(data, path):
            if not isinstance(task, str):
                self.fail(path, f"`tasks` has {task!r}: it must be names or paths in quotes")
            named = str(self.file.parent / Path(task).expanduser()) if is_file(task) else task
            name = self.asked(path, partial(find_task, named)).name
            if name in names:
                self.fail(path, f"`tasks` has two of the name {name}: their runs would mix")
            names.append(name)
            tasks.append(named)
        return tuple(tasks)

    def meshes(self, data: Any, path: lines.Path, medium: Any) -> tuple[tuple[str, ...], str]:
        """Return mesh files, from this file's folder on, and their medium; none if there are none."""
        if data is None and medium is None:
            return (), ""
        if medium not in MEDIA:
            self.fail(("medium",), f"`meshes` need a `medium`: water or ground, not {medium!r}")
        by_name: dict[str, str] = {}
        for mesh in self.row(data, path):
            if not isinstance(mesh, str) or not is_mesh(mesh):
                self.fail(path, f"`meshes` has {mesh!r}: it must be paths of mesh files in quotes")
            named = self.file.parent / Path(mesh).expanduser()
            if not named.is_file():
                self.fail(path, f"`meshes` has {mesh!r}: there is no such file")
            name = mesh_task_name(named, medium)
            if name in by_name:
                self.fail(path, f"`meshes` has two of the name {name}: their runs would mix")
            by_name[name] = str(named)
        return tuple(by_name.values()), medium

    def seeds(self, data: Any, path: lines.Path) -> tuple[int, ...]:
        """Return the seeds: a list, or how many, from 0 on."""
        if data is None:
            return (0,)
        if isinstance(data, int) and not isinstance(data, bool):
            if not 1 <= data <= MOST_RUNS:
                self.fail(path, f"`seeds` is {data}: it must be 1 or more, or a list")
            return tuple(range(data))
        for seed in self.row(data, path):
            if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
                self.fail(path, f"`seeds` has {seed!r}: it must be whole numbers, 0 or more")
        return tuple(data)

    def plugins(self, data: Any, path: lines.Path, kind: str) -> tuple[str, ...]:
        """Return plugins of a kind, which have to be installed."""
        if data is None:
            return ("",)
        for name in self.row(data, path):
            if not isinstance(name, str):
                self.fail(path, f"`{path[-1]}` has {name!r}: it must be names in quotes")
            if name:  # '' is the task's own
                self.asked(path, partial(registry.get_solver, name, kind))
        return tuple(data)

    def options(self, data: Mapping[str, Any], path: lines.Path) -> dict[str, Any]:
        """Return options of runs."""
        self.known(data, tuple(_OPTIONS), path)
        for name, value in data.items():
            least, whole = _OPTIONS[name]
            number = isinstance(value, int if whole else int | float)
            fits = number and not isinstance(value, bool) and math.isfinite(value)
            if not fits or value < least or (not whole and value <= least):
                what = "a whole number" if whole else "a number"
                bound = f"{least} or more" if whole else f"above {least}"
                self.fail((*path, name), f"`{name}` is {value!r}: it must be {what}, {bound}")
        return dict(data)

    def variants(self, data: Any, path: lines.Path, base: Mapping[str, Any]) -> tuple[Variant, ...]:
        """Return the variants, each with the options of all; one without a name if there is none."""
        if data is None:
            return (Variant("", base),)
        variants: list[Variant] = []
        for i, entry in enumerate(self.row(data, path)):
            here = (*path, i)
            if not isinstance(entry, dict) or "name" not in entry:
                self.fail(here, "a variant is a table [[variants]] with a `name` and options")
            name = self.plain_name(entry["name"], (*here, "name"))
            if name in (variant.name for variant in variants):
                self.fail((*here, "name"), f"there are two variants of the name {name}")
            own = {key: value for key, value in entry.items() if key != "name"}
            variants.append(Variant(name, {**base, **self.options(own, here)}))
        return tuple(variants)

    def leave_out(self, data: Any, path: lines.Path) -> tuple[Mapping[str, Any], ...]:
        """Return what is not made."""
        if data is None:
            return ()
        keys = ("task", "seed", "gait_solver", "planner", "feedback", "variant")
        for i, entry in enumerate(self.row(data, path)):
            if not isinstance(entry, dict) or not entry:
                self.fail((*path, i), f"leave_out is a table of {', '.join(keys)}")
            self.known(entry, keys, (*path, i))
        return tuple(data)

    def roles(self, data: Mapping[str, Any]) -> dict[str, str]:
        """Return names of plugins by role."""
        for role, name in data.items():
            if not isinstance(name, str):
                self.fail(("roles", role), f"`{role}` must be the name of a plugin, not {name!r}")
        return dict(data)

    def asked(self, path: lines.Path, look: Callable[[], Any]) -> Any:
        """Return what `look` finds; its error with file and line."""
        try:
            return look()
        except DefplanError as error:
            self.fail(path, str(error))


_OPTIONS: dict[str, tuple[int, bool]] = {
    "pairs": (1, True),
    "episodes": (1, True),
    "logged": (0, True),
    "moving": (0, True),
    "training_seconds": (0, False),
}
"""Options of `pipeline.plan.RunOptions` that a study can set: the least value, and whether it is whole."""
