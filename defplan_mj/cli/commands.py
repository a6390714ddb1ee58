"""The commands: each takes the parsed arguments and the console, and returns the exit code.

What is heavy to import is imported where it is used, so that `defplan --help` answers at once.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.cli.console import Console, table
from defplan_mj.errors import DefplanError

if TYPE_CHECKING:
    from defplan_mj.body.model import Body
    from defplan_mj.task import BodyOptions


def list_installed(arguments: argparse.Namespace, console: Console) -> int:
    """Name the tasks, solvers and suite domains that are installed, broken ones with the reason."""
    from defplan_mj import registry

    tasks, solvers, domains = registry.tasks(), registry.solvers(), registry.domains()
    data = {
        "tasks": [_entry(e, "description") for e in tasks],
        "solvers": [_entry(e, "summary", "kind") for e in solvers],
        "domains": [_entry(e) for e in domains],
    }
    rows = [
        ["task", d["name"], d.get("description", "")] for d in data["tasks"] if "error" not in d
    ]
    rows += [
        [f"{d['kind']} solver" if d["kind"] != "planner" else "planner", d["name"], d["summary"]]
        for d in sorted(
            (d for d in data["solvers"] if "error" not in d), key=lambda d: (d["kind"], d["name"])
        )
    ]
    rows += [["suite domain", d["name"], ""] for d in data["domains"] if "error" not in d]
    console.result(data, _left(rows))
    for entry in [*tasks, *solvers, *domains]:
        if entry.error:
            console.say(f"{entry.name} of package {entry.package} is broken: {entry.error}")
    return 0


def _entry(entry: Any, *attributes: str) -> dict[str, str]:
    """Return a registry entry as JSON."""
    data = {"name": entry.name, "package": entry.package}
    if entry.error:
        return {**data, "error": entry.error}
    return {**data, **{name: str(getattr(entry.value, name, "")) for name in attributes}}


def _left(rows: list[list[str]]) -> str:
    """Return rows of text in columns, all to the left."""
    if not rows:
        return "nothing is installed"
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    return "\n".join(
        "  ".join([*(c.ljust(w) for c, w in zip(row, width, strict=False)), row[-1]]).rstrip()
        for row in rows
    )


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def gait(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def surrogate(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def planner(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def evaluate(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def bench(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def view(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")
