"""Gait solvers on the same problem: what each makes of it, measured alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from defplan_mj.gait.gait import Gait
    from defplan_mj.gait.problem import GaitProblem

SWITCHING_CYCLES = 200
_OTHER_SEQUENCES = 20180521  # seed: no run of a solver has it


def measure(problem: GaitProblem, gait: Gait, seconds: float) -> dict[str, Any]:
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
