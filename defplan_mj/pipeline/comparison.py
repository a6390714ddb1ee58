"""The stage that compares gait solvers on the same problem, for the report, seed by seed."""

from __future__ import annotations

import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.reading import read_json
from defplan_mj.pipeline.making import gait_inputs, gait_problem, solve_gait
from defplan_mj.pipeline.stage import Stage
from defplan_mj.pipeline.store import write_json
from defplan_mj.studies.gait_solvers import measure

if TYPE_CHECKING:
    from defplan_mj.pipeline.run import Run

SOLVERS_FILE = "gait_solvers.json"


def _seeds(run: Run) -> range:
    """Return the seeds that each solver is run with, from the run's own on."""
    seed = run.plan.options.seed
    return range(seed, seed + run.plan.options.solver_seeds)


def _attempts(run: Run) -> tuple[Stage, ...]:
    """Return a stage for each solver and seed, so that a stop loses one at most."""
    solvers = [run.plan.gait_solver, *run.plan.rivals]
    return tuple(_attempt(run, solver, seed) for solver in solvers for seed in _seeds(run))


def _attempt(run: Run, solver: Any, seed: int) -> Stage:
    """Return the stage of one solver and seed; the run's gaits are one of them."""
    own = solver.name == run.plan.gait_solver.name and seed == run.plan.options.seed
    return Stage(
        f"gait_solvers {solver.name} {seed}",
        lambda run: gait_inputs(run, solver, seed),
        partial(_measure_own if own else _solve_and_measure, solver=solver, seed=seed),
        needs=("body", "gait") if own else ("body",),
        load=lambda run: read_json(_row_file(run, solver, seed), "comparison"),
        guarded=False,
        lent=True,
    )


def _row_file(run: Run, solver: Any, seed: int) -> Path:
    return run.file(f"gait-{solver.name}-{seed}.json")


def _measure_own(run: Run, solver: Any, seed: int) -> Iterable[Path]:
    """Measure the run's own gaits."""
    path, row = _row_file(run, solver, seed), {"name": solver.name, "seed": seed}
    try:
        gait = run.result("gait")
        row |= measure(gait_problem(run, gait), gait, run.seconds("gait"))
    except DefplanError as error:  # the gait cannot be simulated
        row["error"] = str(error)
    write_json(path, row)
    return [path]


def _solve_and_measure(run: Run, solver: Any, seed: int) -> Iterable[Path]:
    """Solve and measure; a solver that fails is told, and the run goes on."""
    path, row = _row_file(run, solver, seed), {"name": solver.name, "seed": seed}
    start = time.perf_counter()
    try:
        gait = solve_gait(run, solver, f"gait by {solver.name}, seed {seed}", seed)
        row |= measure(gait_problem(run), gait, time.perf_counter() - start)
    except DefplanError as error:  # of the solver, or its gait cannot be simulated
        write_json(path, row | {"error": str(error)})
        return [path]
    gait.save(path.with_suffix(".npz"))
    write_json(path, row)
    return [path, path.with_suffix(".npz")]


def _collect(run: Run) -> Iterable[Path]:
    path = run.file(SOLVERS_FILE)
    write_json(path, {"solvers": [run.result(attempt) for attempt in _attempts(run)]})
    return [path]


COMPARISON = Stage(
    "gait_solvers",
    lambda run: {},
    _collect,
    needs=("gait",),
    sections=("gaits",),
    parts=_attempts,
    included=lambda run: bool(run.plan.rivals) or run.plan.options.solver_seeds > 1,
    guarded=False,
)
