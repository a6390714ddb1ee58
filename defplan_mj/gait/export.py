"""A gait problem as a file that CasADi alone can solve."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from defplan_mj.dynamics.casadi_files import Instance, save_instance

if TYPE_CHECKING:
    from defplan_mj.gait.problem import GaitProblem


def export(
    problem: GaitProblem,
    path: str | Path,
    seed: int,
    start: np.ndarray | None,
    bound: float,
    sequences: list[list[int]] | None,
) -> None:
    """Write `problem` to `path`; see `GaitProblem.export`."""
    rng = np.random.default_rng(seed)
    chosen = problem.switching_sequences(rng) if sequences is None else sequences
    w, n = ca.MX.sym("w", problem.n_w), problem.n_phases
    cost, shapes = problem.objective(chosen)(w), ca.vec(problem.dmp(w))
    function = ca.Function("gait", [w], [cost, shapes], ["w"], ["cost", "shapes"])
    body = problem.dynamics.body
    wide = np.concatenate([np.full(n, np.inf), np.full(problem.n_w - n, bound)])
    amplitude = np.tile(body.amplitude, problem.n_tasks * problem.steps_per_cycle)
    with tempfile.TemporaryDirectory() as folder:
        body.save(file := Path(folder) / "body.npz")
        packed = file.read_bytes()
    meta = {
        "problem": "gait",
        "body": body.hash,
        "tasks": [task.name for task in problem.tasks],
        "timestep": problem.dynamics.timestep,
        "steps_per_cycle": problem.steps_per_cycle,
        "elements": problem.elements,
        "sequences": chosen,
        "space": problem.space,
    }
    x0 = problem.random_gait(rng) if start is None else np.asarray(start, float)
    save_instance(
        path, Instance(function, x0, -wide, wide, -amplitude, amplitude, meta=meta, body=packed)
    )
