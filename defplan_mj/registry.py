"""What is installed: tasks, solvers, sensors, suite domains and studies, found by entry points, named in errors.

A package adds its own by declaring an entry point in one of these groups; docs/plugins.md shows how.
A plugin that cannot be loaded is reported by its name when it is asked for; the others go on working.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.task import TaskSpec

TASKS = "defplan_mj.tasks"
SOLVERS = "defplan_mj.solvers"
DOMAINS = "defplan_mj.domains"
SENSORS = "defplan_mj.sensors"
STUDIES = "defplan_mj.studies"
CHOICES = {"gait_solver": "gait", "planner": "planner", "feedback": "feedback"}
"""What of a task names a solver, and of which kind."""
KINDS = tuple(CHOICES.values())


@dataclass(frozen=True)
class Entry:
    """One registered plugin.

    Attributes:
        name: what it is asked for by.
        package: the distribution that registered it.
        value: the loaded object; None if loading failed.
        error: why loading failed, one line; empty if it did not.
    """

    name: str
    package: str
    value: Any
    error: str = ""


def names(group: str) -> list[str]:
    """Return the names registered in `group`, sorted; loads nothing."""
    return sorted(_points(group))


def modules(group: str) -> dict[str, str]:
    """Return the module of each name registered in `group`; loads nothing."""
    return {name: point.module for name, point in _points(group).items()}


def tasks() -> list[Entry]:
    """Return all tasks, sorted by name, each loaded or with the reason why not."""
    return _entries(TASKS)


def domains() -> list[Entry]:
    """Return all suite domains (modules), sorted by name."""
    return _entries(DOMAINS)


def solvers(kind: str | None = None) -> list[Entry]:
    """Return all solvers, or those of `kind` ('gait', 'planner', 'feedback'); broken ones always."""
    return [e for e in _entries(SOLVERS) if e.error or kind is None or e.value.kind == kind]


def get_task(name: str) -> TaskSpec:
    """Return the task called `name`, e.g. 'fish-swim'.

    Raises:
        DefplanError: there is none of that name, or its plugin is broken.
    """
    spec = _get(TASKS, "task", name)
    chosen = {field: getattr(spec, field) for field in CHOICES}
    return spec if all(chosen.values()) else replace(spec, **with_defaults(chosen))


def with_defaults(chosen: Mapping[str, str]) -> dict[str, str]:
    """Return the solvers by a task's fields (`CHOICES`), the default one where none is named.

    Raises:
        DefplanError: there is no default one.
    """
    return {field: chosen[field] or default_solver(kind) for field, kind in CHOICES.items()}


def default_solver(kind: str) -> str:
    """Return the name of the solver of a kind that has `default = True`; another package's before ours.

    Raises:
        DefplanError: none has.
    """
    return _marked(kind, "default")


def quick_solver(kind: str) -> str:
    """Return the name of the solver of a kind that has `quick = True`: of tasks that are guessed from a mesh,
    since who names a mesh wants to see it move, soon. If none has, the default one.

    Raises:
        DefplanError: there is neither.
    """
    return _marked(kind, "quick", "default")


def _marked(kind: str, *marks: str) -> str:
    for mark in marks:
        marked = [e for e in solvers(kind) if not e.error and getattr(e.value, mark, False)]
        if marked:
            return min(marked, key=lambda entry: entry.package == "defplan").name
    raise DefplanError(f"no {kind} solver is the default one: name one in the task")


def get_domain(name: str) -> Any:
    """Return the suite domain (a module) called `name`, e.g. 'fish'; raises as `get_task`."""
    return _get(DOMAINS, "domain", name)


def sensors() -> list[Entry]:
    """Return all sensors, sorted by name."""
    return _entries(SENSORS)


def get_sensor(name: str) -> Any:
    """Return the sensor called `name`, e.g. 'planar-laser'; raises as `get_task`."""
    return _get(SENSORS, "sensor", name)


def studies() -> list[Entry]:
    """Return all study files (paths), sorted by name."""
    return _entries(STUDIES)


def get_study(name: str) -> Path:
    """Return the study file called `name`, e.g. 'paper'; raises as `get_task`."""
    return _get(STUDIES, "study", name)


def get_solver(name: str, kind: str) -> Any:
    """Return the solver called `name`, which must be of `kind`; raises as `get_task`."""
    label = "planner" if kind == "planner" else f"{kind} solver"
    if name not in _points(SOLVERS):
        raise DefplanError(_unknown(label, name, (e.name for e in solvers(kind) if not e.error)))
    solver = _get(SOLVERS, label, name)
    if solver.kind != kind:
        there = ", ".join(e.name for e in solvers(kind) if not e.error) or "none"
        raise DefplanError(f"{name} is a {solver.kind} solver, not a {label}; there is: {there}")
    return solver


def modules_of(solver: Any) -> list[str]:
    """Return the modules whose entry points name this solver."""
    point = _points(SOLVERS).get(getattr(solver, "name", ""))
    if point is None or point.module not in sys.modules:
        return []
    return [point.module] if point.load() is solver else []


def _points(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of `group` by name; of two with one name, our own stays out."""
    points: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        if point.name not in points or _package(points[point.name]) == "defplan":
            points[point.name] = point
    return points


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist else "unknown"


def _load(point: EntryPoint, group: str) -> Entry:
    package = _package(point)
    try:
        value = point.load()
        _check(group, value)
    except Exception as error:  # a plugin may fail in any way; it must not take others down
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        return Entry(point.name, package, None, reason)
    return Entry(point.name, package, value)


def _check(group: str, value: Any) -> None:
    """Raise TypeError unless `value` is what the group promises."""
    if group == TASKS and not isinstance(value, TaskSpec):
        raise TypeError(f"expected a TaskSpec, got {type(value).__name__}")
    if group == SENSORS and not hasattr(value, "measure"):
        raise TypeError("it has no method `measure`")
    if group == STUDIES and not isinstance(value, Path):
        raise TypeError(f"expected the path of a study file, got {type(value).__name__}")
    if group == SOLVERS and getattr(value, "kind", None) not in KINDS:
        raise TypeError(f"its `kind` must be one of {', '.join(KINDS)}")


def _entries(group: str) -> list[Entry]:
    points = _points(group)
    return [_load(points[name], group) for name in sorted(points)]


def _get(group: str, label: str, name: str) -> Any:
    points = _points(group)
    if name not in points:
        raise DefplanError(_unknown(label, name, points))
    entry = _load(points[name], group)
    if entry.error:
        raise DefplanError(
            f"the {label} {name} of package {entry.package} cannot be loaded ({entry.error})"
        )
    return entry.value


def _unknown(label: str, name: str, known: Iterable[str]) -> str:
    """Return the sentence for an unknown name: what was probably meant, and what there is."""
    known = sorted(known)
    close = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
    guess = f", did you mean {close[0]}?" if close else ";"
    return f"there is no {label} {name}{guess} There is: {', '.join(known) or 'none'}".replace(
        "; There", "; there"
    )
