"""The one place that turns what a user names a task by, its name or its file, into the task."""

from __future__ import annotations

import re
from pathlib import Path

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.formats import CELL_FORMATS, SURFACE_FORMATS
from defplan_mj.task import Effort, TaskSpec
from defplan_mj.taskfile.read import read_task

SUFFIX = ".toml"
COPY = "task.toml"
"""A run's folder keeps its task under this name, if that is a file's."""
MESHES = SURFACE_FORMATS + CELL_FORMATS
MEDIA = ("water", "ground")
"""What a mesh can move in, or on."""
EFFORT = Effort(pairs=300, episodes=100, moving=0, unchecked=0.2)
"""Of a task that is guessed from a mesh. Fifteen cycles for each pair of gaits are enough of a surrogate; A*
does not know of moving obstacles; what it does without the check is worth some scenes and not half the time."""


def is_file(name: str) -> bool:
    """Return whether a task is named by its file."""
    return Path(name).suffix.lower() == SUFFIX


def is_mesh(name: str) -> bool:
    """Return whether this names a mesh."""
    return Path(name).suffix.lower() in MESHES


def task_of_run(folder: Path, name: str) -> TaskSpec:
    """Return the task of a run: what its folder keeps, else the installed one of that name.

    Raises:
        DefplanError: there is neither, or it is damaged.
    """
    copy = folder / COPY
    return read_task(copy, mesh_needed=False) if copy.is_file() else registry.get_task(name)


def find_task(name: str) -> TaskSpec:
    """Return the task of a file (*.toml) or of a plugin's name.

    Raises:
        DefplanError: there is none, or something in the file cannot be.
    """
    if is_file(name):
        return read_task(name)
    if is_mesh(name):
        raise DefplanError(
            f"{name} is a mesh and no task: `defplan new {name} --medium water -o FILE.toml`"
            " writes a task file for it"
        )
    try:
        return registry.get_task(name)
    except DefplanError as error:
        if Path(name).is_dir():
            raise DefplanError(
                f"{name} is a folder, no task: name a mesh or a task file in it"
            ) from error
        if Path(name).is_file():
            raise DefplanError(f"{name} is no task file: such a file ends in {SUFFIX}") from error
        raise


def plain_name(stem: str) -> str:
    """Return a file's stem as a task's name."""
    return re.sub(r"[^\w.+-]+", "-", stem).strip("-.+") or "body"


def mesh_task_name(mesh: Path, medium: str) -> str:
    """Return what the task that is guessed from a mesh is called."""
    return f"{plain_name(mesh.stem)}-{'walk' if medium == 'ground' else 'swim'}"


def mesh_task_solvers(medium: str) -> dict[str, str]:
    """Return which solvers the task that is guessed from a mesh names, by its fields; '': the default one.

    Who names a mesh wants to see it move, soon. A swimmer does so without a feedback.
    """
    quick = {field: registry.quick_solver(kind) for field, kind in registry.CHOICES.items()}
    return quick if medium == "ground" else {**quick, "feedback": ""}
