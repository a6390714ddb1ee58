"""Planner plugins with nothing to train: their policy file holds the planner's name and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.planning.planner import Planner, TrainResult
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.policy_files import load_policy, save_policy


@dataclass(frozen=True)
class UntrainedSolver:
    """A planner plugin that only makes its planner.

    Attributes:
        name, summary: see the registry.
        make: the planner of a surrogate and a navigation problem.
        bound: it knows what no robot can know, and others are judged by it (`studies.bound`).
        quick: the planner of tasks that are guessed from a mesh.
    """

    name: str
    summary: str
    make: Callable[[Surrogate, Navigation], Planner]
    kind: str = "planner"
    needs_training: bool = False
    bound: bool = False
    quick: bool = False

    def train(
        self,
        surrogate: Surrogate,
        navigation: Navigation,
        seed: int,
        seconds: float | None = None,
        progress: Progress = no_progress,
    ) -> TrainResult:
        """Return the planner: there is nothing to train."""
        return TrainResult(self.make(surrogate, navigation))

    def save(self, planner: Planner, path: Path) -> None:
        """Write the planner's name to `path`, atomically."""
        save_policy(path, self.name)

    def load(self, path: Path, surrogate: Surrogate, navigation: Navigation) -> Planner:
        """Return the planner of a file of `save`.

        Raises:
            DefplanError: the file is missing, damaged, of another version or of another planner.
        """
        load_policy(path, self.name, surrogate.task_names)
        return self.make(surrogate, navigation)
