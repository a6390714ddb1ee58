"""Gait solver `cma-es`: Hansen's evolution strategy on E_obj by rollouts; no derivatives.

A peer for the solvers that use the kernel's adjoint, and the documented example of a gait solver that is made
of a package (docs/gaits.md).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem

_FAILED = 1e6
"""Cost of a gait that cannot be simulated: worse than all that can."""


@dataclass(frozen=True)
class CmaEs:
    """CMA-ES with a diagonal start, from one random gait.

    Attributes:
        evaluations: of the objective.
        population: of a generation; 0: the package's choice, 4 + 3 ln(n).
        step: standard deviation at the start, in units of alpha.
        excess: cost of the mean squared excess of target shapes over the amplitude, in units of it.
        bound: of alpha and beta, as in `shooting`.
        threads: rollouts in parallel.
    """

    kind: str = "gait"
    name: str = "cma-es"
    summary: str = "an evolution strategy (CMA-ES) on the same objective, without derivatives"
    evaluations: int = 6000
    population: int = 0
    step: float = 0.2
    excess: float = 100.0
    bound: float = 4.0
    threads: int = 2

    def solve(self, problem: GaitProblem, seed: int = 0, progress: Progress = no_progress) -> Gait:
        """Return the best gait that was met; a seed gives one result.

        The meta data hold `seconds`, `objective`, `history` (the best so far after each generation) and
        `stages` with the evaluations.
        """
        from cma import CMAEvolutionStrategy  # loads slowly

        began, rng = time.perf_counter(), np.random.default_rng(seed)
        cost = _Cost(self, problem, rng)
        start = np.clip(problem.random_gait(rng), cost.low + 1e-3, cost.high - 1e-3)
        options = {
            "bounds": [cost.low.tolist(), cost.high.tolist()],
            "maxfevals": self.evaluations,
            "seed": math.nan,  # its numbers are ours: it would seed those of the whole process
            "randn": lambda *shape: rng.standard_normal(shape),
            "verbose": -9,
        }
        if self.population:
            options["popsize"] = self.population
        strategy = CMAEvolutionStrategy(start, self.step, options)
        best, w, history = cost(start), start, []
        while not strategy.stop():
            trials = strategy.ask()
            values = [cost(np.asarray(trial)) for trial in trials]
            strategy.tell(trials, values)
            least = int(np.argmin(values))
            if values[least] < best:
                best, w = values[least], np.asarray(trials[least])
            history.append(best)
            progress("gait: evolving", min(1.0, strategy.countevals / self.evaluations))
        stage = {
            "stage": "evolution",
            "objective": best,
            "iterations": int(strategy.countiter),
            "evaluations": int(strategy.countevals) + 1,
            "status": ", ".join(strategy.stop()),
        }
        meta = {
            "solver": self.name,
            "seed": seed,
            "seconds": time.perf_counter() - began,
            "objective": best,
            "history": history,
            "stages": [stage],
        }
        return problem.gait(w, meta)


class _Cost:
    """E_obj of a gait, more where its target shapes leave the amplitude; and the bounds of w."""

    def __init__(self, solver: CmaEs, problem: GaitProblem, rng: np.random.Generator) -> None:
        sequences = problem.switching_sequences(rng)
        self.objective = problem.objective(sequences, threads=solver.threads)
        self.excess, self.weight = problem.excess, solver.excess
        n = problem.n_phases
        bound = np.concatenate([np.full(n, 4 * np.pi), np.full(problem.n_w - n, solver.bound)])
        self.low, self.high = -bound, bound

    def __call__(self, w: np.ndarray) -> float:
        penalty = self.weight * float(self.excess(w))
        try:
            value = float(self.objective(w))
        except RuntimeError:  # a step did not converge
            return _FAILED
        return value + penalty if math.isfinite(value) else _FAILED


SOLVER = CmaEs()
