"""Gait solvers on the same problem: what each makes of it, measured alike, seed by seed."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError

if TYPE_CHECKING:
    from defplan_mj.gait.gait import Gait
    from defplan_mj.gait.problem import GaitProblem
    from defplan_mj.run import Run

SWITCHING_CYCLES = 200
SOLVERS_FILE = "gait_solvers.json"
STAGE = "gait_solvers"
"""How the names of its stages begin: one for each solver and seed, so that a stop loses one at most."""
_OTHER_SEQUENCES = 20180521  # seed: no run of a solver has it


def compare_solvers(run: Run) -> None:
    """Let the run's gait solver and its rivals solve the same problem, for the report.

    Each is run with `solver_seeds` seeds from the run's own on; the run's gaits are one of them.
    """
    from defplan_mj.run import write_json

    rivals, count = find_rivals(run), run.options.solver_seeds
    if not rivals and count == 1:
        return
    _ = run.gait
    rows = []
    for solver in [run.gait_solver, *rivals]:
        for seed in range(run.options.seed, run.options.seed + count):
            rows.append(_attempt(run, solver, seed))
    path = run.folder.file(SOLVERS_FILE)

    def make() -> Iterable[Path]:
        write_json(path, {"solvers": rows})
        return [path]

    run.make(STAGE, {"rows": rows}, make)


def find_rivals(run: Run) -> list[Any]:
    """Return the gait solvers to compare with: those that were asked for, or else the task's.

    Raises:
        DefplanError: there is no solver of a name that was asked for.
    """
    chosen = run.options.rivals
    found = []
    for name in run.spec.rivals if chosen is None else chosen:
        if name in ("none", run.gait_solver.name):
            continue
        try:
            found.append(registry.get_solver(name, "gait"))
        except DefplanError:
            if chosen is not None:
                raise  # nobody asked for the others by name
    return found


def _attempt(run: Run, solver: Any, seed: int) -> dict[str, Any]:
    """Return the row of one solver and seed; a solver that fails is told, and the run goes on."""
    from defplan_mj.run import write_json

    stem = f"gait-{solver.name}-{seed}"
    path, file = run.folder.file(f"{stem}.json"), run.folder.file(f"{stem}.npz")
    own = solver.name == run.gait_solver.name and seed == run.options.seed

    def make() -> Iterable[Path]:
        made, start = [path], time.perf_counter()
        row: dict[str, Any] = {"name": solver.name, "seed": seed}
        try:
            gait = (
                run.gait if own else run.solve(solver, f"gait by {solver.name}, seed {seed}", seed)
            )
            seconds = run.seconds("gait") if own else time.perf_counter() - start
            row |= measure_solver(run.problem, gait, seconds)
        except DefplanError as error:  # of the solver, or its gait cannot be simulated
            row["error"] = str(error)
        else:
            if not own:
                gait.save(file)
                made.append(file)
        write_json(path, row)
        return made

    inputs = {**run.gait_inputs(solver, seed), "own": run.hashes["gait.npz"] if own else ""}
    run.make(f"{STAGE} {solver.name} {seed}", inputs, make)
    return json.loads(path.read_text(encoding="utf-8"))


def measure_solver(problem: GaitProblem, gait: Gait, seconds: float) -> dict[str, Any]:
    """Return how a solver's gait does once it is simulated; the same measure for every solver.

    Args:
        seconds: that it took, unless the gait says so itself.

    Returns:
        'seconds', 'objective' (as the solver has it), 'resimulated' (E_obj by rollouts, over task
        sequences of our own), and while switching: 'advance_m' a cycle (mean of the tasks that are to
        go farthest), 'turn_rad' (mean of those that are to turn, None without one), 'slip_share' of a
        walker (see `footing.footing`, else None), 'cycles', 'falls'.
    """
    from defplan_mj.gait.switching import evaluate_switching

    sequences = problem.switching_sequences(np.random.default_rng(_OTHER_SEQUENCES))
    cost = problem.objective(sequences)(w=problem.w_of(gait))["cost"]
    switched = evaluate_switching(problem, gait, SWITCHING_CYCLES, seed=0)
    rows = switched.rows()
    farthest = max(task.advance for task in problem.tasks)
    advances = [
        row["advance_m"]
        for row, task in zip(rows, problem.tasks, strict=True)
        if task.advance == farthest and np.isfinite(row["advance_m"])
    ]
    turns = [
        abs(row["turn_rad"])
        for row, task in zip(rows, problem.tasks, strict=True)
        if task.angle > 0 and np.isfinite(row["turn_rad"])
    ]
    return {
        "seconds": gait.meta.get("seconds", seconds),
        "objective": gait.meta.get("objective"),
        "resimulated": float(cost),
        "advance_m": float(np.mean(advances)) if advances else None,
        "turn_rad": float(np.mean(turns)) if turns else None,
        "slip_share": switched.footing.get("slip_share"),
        "cycles": SWITCHING_CYCLES,
        "falls": switched.falls,
    }
