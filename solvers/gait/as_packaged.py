"""Gait solver `as-packaged`: the gaits that an installed task comes with, for studies that are not about gaits."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.model import Body
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem


@dataclass(frozen=True)
class AsPackaged:
    """Solves nothing: finds the gaits that were made for this body and these tasks.

    A run of it takes the task's packaged body, too: on another kind of processor the same mesh gives another one,
    in the last digits, or in more where a fit makes much of them (elastic shapes). Asked about a body of one's
    own, it takes the packaged one for it if they are the same up to rounding.

    Attributes:
        body_as_packaged: whether a run's body is the task's packaged one, in place of one built from the mesh.
    """

    kind: str = "gait"
    name: str = "as-packaged"
    summary: str = "the body and gaits that the task comes with, made before; solves nothing"
    body_as_packaged: bool = True

    def solve(self, problem: GaitProblem, seed: int = 0, progress: Progress = no_progress) -> Gait:
        """Return the packaged gaits of `problem`; the seed has no part in it.

        `seconds` and what else their meta data say are of when they were made.

        Raises:
            DefplanError: no installed task has gaits for this body, these tasks and this time step.
        """
        body, names = problem.dynamics.body, tuple(task.name for task in problem.tasks)
        for entry in registry.tasks():
            files = None if entry.error else entry.value.shipped
            if files is None or not files[1].is_file():
                continue
            gait = Gait.load(files[1])
            same_steps = (gait.timestep, gait.steps_per_cycle, gait.stepping) == (
                problem.dynamics.timestep,
                problem.steps_per_cycle,
                problem.dynamics.stepping,
            )
            if not same_steps or gait.task_names != names:
                continue
            if gait.body_hash == body.hash or body.nearly(Body.load(files[0])):
                progress("gait: packaged", 1.0)
                return dataclasses.replace(gait, body_hash=body.hash)
        raise DefplanError(
            f"no installed task comes with gaits for this body ({body.name}) and the tasks"
            f" {', '.join(names)}: choose a --gait-solver that solves them"
        )


SOLVER = AsPackaged()
