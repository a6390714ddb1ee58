"""What a run is asked for: its task, its options, and the plugins that they name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.feedback import FeedbackSolver
from defplan_mj.planning.planner import PlannerSolver
from defplan_mj.task import Effort, TaskSpec


@dataclass(frozen=True)
class RunOptions:
    """What a run is asked for besides its task.

    Attributes:
        seed: of everything random.
        gait_solver, planner, feedback: plugins by name (None: the task's).
        rivals: gait solvers that the report compares with (none: ('none',); None: the task's).
        solver_seeds: with how many seeds they are compared.
        pairs: (before, after) pairs a gait that the surrogate is fitted to.
        training_seconds: wall time after which the planner's training is cut short (None: never).
        episodes: unseen scenes of the evaluation.
        logged: how many episodes in unseen scenes are logged, beside those at training targets.
        moving: episodes at training targets among moving obstacles, at each speed (0: none).
    """

    seed: int = 0
    gait_solver: str | None = None
    planner: str | None = None
    feedback: str | None = None
    rivals: Sequence[str] | None = None
    solver_seeds: int = 1
    pairs: int = Effort.pairs
    training_seconds: float | None = None
    episodes: int = Effort.episodes
    logged: int = 4
    moving: int = Effort.moving


EFFORT = ("pairs", "episodes", "moving")
"""Options that a task's effort says, where the command does not."""
_NAMES = ("gait_solver", "planner", "feedback")
_COUNTS = ("solver_seeds", "pairs", "episodes", "logged", "moving")
CONFIGURATION = (*_NAMES, "rivals", *_COUNTS, "training_seconds")  # kept in run.json


@dataclass(frozen=True)
class Plan:
    """A task with the options of a run; plugins are looked up when they are asked for.

    Attributes:
        spec: the task.
        options: see `RunOptions`.
    """

    spec: TaskSpec
    options: RunOptions = RunOptions()

    @cached_property
    def gait_solver(self) -> Any:
        """The gait solver plugin."""
        return registry.get_solver(self.options.gait_solver or self.spec.gait_solver, "gait")

    @cached_property
    def planner(self) -> PlannerSolver:
        """The planner plugin."""
        return registry.get_solver(self.planner_name, "planner")

    @cached_property
    def feedback(self) -> FeedbackSolver:
        """The feedback plugin."""
        return registry.get_solver(self.options.feedback or self.spec.feedback, "feedback")

    @cached_property
    def rivals(self) -> list[Any]:
        """The gait solvers to compare with: those that were asked for, or else the task's.

        Raises:
            DefplanError: there is no solver of a name that was asked for.
        """
        chosen = self.options.rivals
        solvers = []
        for name in self.spec.rivals if chosen is None else chosen:
            if name in ("none", self.gait_solver.name):
                continue
            try:
                solvers.append(registry.get_solver(name, "gait"))
            except DefplanError:
                if chosen is not None:
                    raise  # nobody asked for the others by name
        return solvers

    @property
    def planner_name(self) -> str:
        """Name of the planner."""
        return self.options.planner or self.spec.planner

    def of_planner(self, name: str) -> str:
        """Return the name of something of the planner's; what is not the task's own lies beside it."""
        return name if self.planner_name == self.spec.planner else f"{name}-{self.planner_name}"

    def check(self) -> None:
        """Raise DefplanError if a plugin is missing: a wrong name is told before the work, not after."""
        _ = self.gait_solver, self.planner, self.feedback, self.rivals


def kept_options(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return those options of a run.json's configuration that are of the right type."""
    return {name: config[name] for name in CONFIGURATION if _fits(name, config.get(name))}


def _fits(name: str, value: Any) -> bool:
    """Return whether a value read from a file can be the option called `name`."""
    if name in _COUNTS:
        least = 0 if name in ("moving", "logged") else 1
        return isinstance(value, int) and not isinstance(value, bool) and value >= least
    if name == "rivals":
        return isinstance(value, list | tuple) and all(isinstance(v, str) for v in value)
    if name == "training_seconds":
        return isinstance(value, int | float) and value > 0
    return isinstance(value, str)
