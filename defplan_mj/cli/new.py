"""`defplan new`, and how `defplan run MESH` begins: a task file, guessed from a mesh or copied from a task."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.cli.console import Console

if TYPE_CHECKING:
    import numpy as np

    from defplan_mj.taskfile.guess import Guess

_GUESSING = ("medium", "length", "up", "forward", "preview")


def new(arguments: argparse.Namespace, console: Console) -> int:
    """Write a task file; say what was guessed."""
    from defplan_mj.base import files
    from defplan_mj.taskfile.find import SUFFIX, find_task, is_mesh
    from defplan_mj.taskfile.write import write_task

    mesh, origin, output = arguments.mesh, arguments.origin, arguments.output
    if (mesh is None) is (origin is None):
        raise DefplanError("name a mesh, or with --from the task to start from: one of them")
    if output is not None:
        _check_output(output, SUFFIX, arguments.overwrite)
    notes: list[str] = []
    if origin is not None:
        _refuse_guessing(arguments, f"--from {origin}")
        spec = find_task(origin)
        output = output or Path(f"{spec.name}{SUFFIX}")
        spec = dataclasses.replace(spec, name=_name(output))
        notes.append(f"It started as a copy of {Path(origin).name}.")
    else:
        if Path(mesh).is_dir():
            raise DefplanError(f"{mesh} is a folder: name a mesh file in it")
        if not is_mesh(mesh):
            raise DefplanError(f"{mesh} is no mesh file: `defplan new --from {mesh}` copies a task")
        guess = _guess(arguments, console, mesh)
        output = output or Path(f"{guess.spec.name}{SUFFIX}")
        spec = dataclasses.replace(guess.spec, name=_name(output))
        notes.append(f"Guessed: {guess.sentence}.")
        console.say(guess.sentence)
    _check_output(output, SUFFIX, arguments.overwrite)
    files.check_writable(output)
    write_task(spec, output, notes)
    data: dict[str, Any] = {"file": output, "task": spec.name, "guessed": " ".join(notes)}
    console.result(data, f"{output}: the task {spec.name}; run it with defplan run {output}")
    return 0


def task_of_mesh(arguments: argparse.Namespace, console: Console) -> Path:
    """Return the task file of `defplan run MESH`, in the folder of the runs; written if it is not there.

    Raises:
        DefplanError: there is one that says something else.
    """
    from defplan_mj.taskfile.find import SUFFIX
    from defplan_mj.taskfile.write import task_text, write_task

    mesh = arguments.task
    guess = _guess(arguments, console, mesh)
    path = arguments.logs / f"{guess.spec.name}{SUFFIX}"
    notes = [f"Guessed: {guess.sentence}."]
    console.say(f"{guess.sentence}; all of it can be changed in {path}")
    if path.exists() and not (arguments.fresh or arguments.remake):
        if path.read_bytes() != task_text(guess.spec, path, notes).encode():
            raise DefplanError(
                f"{path} is there and says something else than what is guessed of {mesh}: run it with"
                f" `defplan run {path}`, or add --remake to write it anew"
            )
        return path
    arguments.logs.mkdir(parents=True, exist_ok=True)
    return write_task(guess.spec, path, notes)


def refuse_guessing(arguments: argparse.Namespace) -> None:
    """Raise a DefplanError if options of a mesh are given for a task."""
    _refuse_guessing(arguments, arguments.task)


def _refuse_guessing(arguments: argparse.Namespace, what: str) -> None:
    given = [f"--{name}" for name in _GUESSING if getattr(arguments, name) is not None]
    if given:
        raise DefplanError(
            f"{' and '.join(given)} is for a mesh, and {what} is a task: change its file, or write"
            " one with `defplan new --from TASK`"
        )


def _guess(arguments: argparse.Namespace, console: Console, mesh: str) -> Guess:
    from defplan_mj.taskfile.guess import guess_task

    check_preview(arguments)
    if arguments.medium is None:
        raise DefplanError(f"say what {mesh} moves in: --medium water, or --medium ground")
    with console.progress() as progress:
        guess = guess_task(
            mesh,
            arguments.medium,
            length=arguments.length,
            up=arguments.up,
            forward=arguments.forward,
            progress=progress,
        )
    if arguments.preview is not None:
        show(guess.shape.vertices, guess.shape.faces, arguments.preview)
    return guess


def check_preview(arguments: argparse.Namespace) -> None:
    """Raise a DefplanError if the picture that is asked for cannot be written."""
    from defplan_mj.base import files

    if arguments.preview is not None:
        if arguments.preview.suffix.lower() != ".png":
            raise DefplanError(f"--preview writes a .png, not {arguments.preview}")
        files.check_writable(arguments.preview)


def show(points: np.ndarray, faces: np.ndarray, path: Path) -> None:
    """Write the picture that shows which way a mesh looks."""
    from defplan_mj.log.plotting import save_figure
    from defplan_mj.report.figures.preview import preview_figure

    save_figure(preview_figure(points, faces), path)


def _name(output: Path) -> str:
    from defplan_mj.taskfile.find import plain_name

    return plain_name(output.stem)


def _check_output(output: Path, suffix: str, overwrite: bool) -> None:
    if output.suffix.lower() != suffix:
        raise DefplanError(
            f"a task file ends in {suffix}, not {output.suffix or 'nothing'}: {output}"
        )
    if output.exists() and not overwrite:
        raise DefplanError(f"{output} is there: choose another -o, or add --overwrite")
