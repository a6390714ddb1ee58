"""The stage that counts falls in worlds that are not the model's: made on request, shown in the report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.reading import read_json
from defplan_mj.pipeline.making import dynamics
from defplan_mj.pipeline.provenance import plugin_data
from defplan_mj.pipeline.stage import Stage
from defplan_mj.pipeline.store import write_json
from defplan_mj.studies.robustness import Condition, conditions, measure_robustness

if TYPE_CHECKING:
    from defplan_mj.feedback import FeedbackSolver
    from defplan_mj.pipeline.run import Run
    from defplan_mj.task import TaskSpec

ROBUSTNESS_FILE = "robustness.json"


def robustness(
    spec: TaskSpec, names: Sequence[str] = (), cycles: int = 200, push: float = 0.3
) -> Stage:
    """Return the stage for a task: 'task', 'seed', 'cycles', 'gait' (its hash), 'rows' of `measure_robustness`.

    Args:
        names: of feedbacks; none: all that are installed.
        push: change of velocity by a push, m/s.

    Raises:
        DefplanError: the task is not in the plane, or a feedback is not installed.
    """
    if not spec.navigation.place.level:
        raise DefplanError(
            f"{spec.name} moves in space: robustness is measured for tasks in the plane"
        )
    chosen = names or [entry.name for entry in registry.solvers("feedback") if not entry.error]
    solvers = [registry.get_solver(name, "feedback") for name in chosen]
    where = conditions(push, spec.world)
    return Stage(
        "robustness",
        partial(_inputs, solvers=solvers, where=where, cycles=cycles),
        partial(_make, solvers=solvers, where=where, cycles=cycles),
        needs=("body", "gait"),
        load=lambda run: read_json(run.file(ROBUSTNESS_FILE), "measurement"),
        figures=lambda run: run.result("robustness"),
        sections=("robustness",),
        guarded=False,
    )


def _inputs(
    run: Run, solvers: Sequence[FeedbackSolver], where: Sequence[Condition], cycles: int
) -> dict[str, Any]:
    return {
        "options": {"feedback": [solver.name for solver in solvers], "cycles": cycles},
        "plugins": {solver.name: plugin_data(solver) for solver in solvers},
        "conditions": [asdict(condition) for condition in where],
        "seed": run.plan.options.seed,
    }


def _make(
    run: Run, solvers: Sequence[FeedbackSolver], where: Sequence[Condition], cycles: int
) -> Iterable[Path]:
    path, seed, gait = run.file(ROBUSTNESS_FILE), run.plan.options.seed, run.result("gait")
    progress = run.progress_of("robustness")
    rows = measure_robustness(dynamics(run), gait, solvers, where, cycles, seed, progress)
    document = {"task": run.plan.spec.name, "seed": seed, "cycles": cycles, "gait": gait.hash}
    write_json(path, {**document, "rows": rows})
    return [path]
