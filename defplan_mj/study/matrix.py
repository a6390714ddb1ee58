"""The runs of a study: every task, seed, gait solver, planner, feedback and variant, but what is left out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.study.spec import MOST_RUNS, Study
from defplan_mj.task import Effort
from defplan_mj.taskfile.find import EFFORT, find_task, mesh_task_name, mesh_task_solvers


@dataclass(frozen=True)
class Cell:
    """One run of a study; plain, so that it can be sent to another machine.

    Attributes:
        source: its task's name or file, as `find_task` takes it, or a mesh.
        task: the task's name.
        seed: of everything random in it.
        gait_solver, planner, feedback: by name.
        variant: name of its options.
        options: see `spec.Variant`.
        until: its last stage.
        medium: of a mesh, what it moves in or on; '' of a task.
        effort: of its task, where the options do not say.
        stands: whether all obstacles of its task stand, whatever the options say.
    """

    source: str
    task: str
    seed: int
    gait_solver: str
    planner: str
    feedback: str
    variant: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    until: str = "report"
    medium: str = ""
    effort: Effort = Effort()
    stands: bool = False

    @property
    def asked(self) -> Mapping[str, Any]:
        """What the run does: its options, and its task's effort where they do not say."""
        return {**asdict(self.effort), **self.options}

    @property
    def method(self) -> str:
        """What the task is solved by: the name of the folder that its runs lie in."""
        parts = [self.gait_solver]
        if self.until not in ("gait", "surrogate"):
            parts += [self.planner, self.feedback]
        return "+".join(filter(None, [*parts, self.variant]))

    @cached_property
    def folder(self) -> Path:
        """Of the run, from the study's folder on."""
        return Path(self.method) / f"{self.task}-seed{self.seed}"

    @property
    def gaits(self) -> tuple[Any, ...]:
        """What its gaits depend on: runs alike in this share them."""
        return self.source, self.seed, self.gait_solver

    def says(self, entry: Mapping[str, Any]) -> bool:
        """Return whether all that an entry of `leave_out` says is true of this run."""
        return all(getattr(self, name) == value for name, value in entry.items())


def cells(study: Study) -> list[Cell]:
    """Return the runs of a study in their order; runs that would be the same are one.

    Raises:
        DefplanError: nothing is left, or they are too many.
    """
    axes = (study.seeds, study.gait_solvers, study.planners, study.feedbacks, study.variants)
    count = len(study.tasks) + len(study.meshes)
    for axis in axes:
        count *= len(axis)
    if count > MOST_RUNS:
        raise DefplanError(f"{study.file}: {count} runs are more than {MOST_RUNS}")
    by_folder: dict[Path, Cell] = {}
    for cell in _every(study, _robots(study)):
        if not any(cell.says(entry) for entry in study.leave_out):
            by_folder.setdefault(cell.folder, cell)
    if not by_folder:
        raise DefplanError(f"{study.file}: all runs are left out by leave_out")
    return list(by_folder.values())


@dataclass(frozen=True)
class _Robot:
    """A task of a study, as far as it is known before it is run; see `Cell`."""

    source: str
    task: str
    gait_solver: str
    planner: str
    feedback: str
    medium: str = ""
    effort: Effort = Effort()
    stands: bool = False


def _robots(study: Study) -> list[_Robot]:
    """Return the study's tasks, and those that are to be guessed of its meshes."""
    robots = []
    for source in study.tasks:
        spec = find_task(source)
        names = (spec.name, spec.gait_solver, spec.planner, spec.feedback)
        stands = bool(spec.navigation.scenes)
        robots.append(_Robot(source, *names, effort=spec.effort, stands=stands))
    for mesh in study.meshes:
        name = mesh_task_name(Path(mesh), study.medium)
        solvers = registry.with_defaults(mesh_task_solvers(study.medium))
        gait, planner, feedback = (solvers[field] for field in registry.CHOICES)
        robots.append(_Robot(mesh, name, gait, planner, feedback, study.medium, EFFORT))
    return robots


def _every(study: Study, robots: Sequence[_Robot]) -> Iterator[Cell]:
    for robot, seed, gait, planner, feedback, variant in itertools.product(
        robots,
        study.seeds,
        study.gait_solvers,
        study.planners,
        study.feedbacks,
        study.variants,
    ):
        yield Cell(
            robot.source,
            robot.task,
            seed,
            gait or robot.gait_solver,
            planner or robot.planner,
            feedback or robot.feedback,
            variant.name,
            variant.options,
            study.until,
            robot.medium,
            robot.effort,
            robot.stands,
        )


class Lenders:
    """Which runs have stages in common: those with a run's gaits, and of its body any of its task.

    Args:
        cells: of the study.
    """

    def __init__(self, cells: Sequence[Cell]) -> None:
        self._bodies: dict[str, list[Path]] = {}
        self._gaits: dict[tuple[Any, ...], list[Path]] = {}
        for cell in cells:
            for folders in (
                self._bodies.setdefault(cell.source, []),
                self._gaits.setdefault(cell.gaits, []),
            ):
                if len(folders) < 3:
                    folders.append(cell.folder)

    def of(self, cell: Cell) -> list[Path]:
        """Return folders to look in, the likeliest first."""
        folders = [*self._gaits[cell.gaits], *self._bodies[cell.source]]
        return [folder for folder in dict.fromkeys(folders) if folder != cell.folder]
