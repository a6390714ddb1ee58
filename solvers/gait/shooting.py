"""Gait solver `shooting`: single shooting over w_dmp through the exact adjoint of the rollout.

A swimmer's gaits by CasADi's ipopt: the straight task alone from random starts, then all tasks while
they are switched; after each round only the best starts go on. Target shapes are bounded by the body's
amplitude as constraints, not by clipping. A walker's gaits: shooting_walk.py.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.trials import bent_gaits, try_tasks
from defplan_solvers.gait.shooting_walk import Trace, Walking

IPOPT = {
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": 20,
    "mu_strategy": "adaptive",
    "tol": 1e-3,
    "acceptable_iter": 0,
    "print_level": 0,
    "sb": "yes",
}
# From a start that is good already: the barrier is not to drive it away first.
WARM = {
    "mu_strategy": "monotone",
    "mu_init": 1e-5,
    "bound_push": 1e-6,
    "bound_frac": 1e-6,
    "slack_bound_push": 1e-6,
    "slack_bound_frac": 1e-6,
}


@dataclass(frozen=True)
class Shooting:
    """Single shooting.

    Attributes:
        starts: random starts.
        start_cycles: cycles of the straight task's trajectory.
        start_iterations: limit of ipopt's iterations for the straight task.
        tried: start where short trials of each task end (`gait.trials`), and from nowhere else.
        rounds: (limit of iterations for all tasks, starts that go on), round after round.
        walking: the stages of a walker.
        bound: of alpha and beta.
        threads: rollouts in parallel.
        default: it is the one to take where no other is named.
    """

    kind: str = "gait"
    name: str = "shooting"
    summary: str = "single shooting through the exact adjoint, with CasADi and ipopt (the default)"
    starts: int = 5
    start_cycles: int = 6
    start_iterations: int = 40
    tried: bool = False
    rounds: tuple[tuple[int, int], ...] = ((25, 2), (50, 1), (175, 1))
    walking: Walking = Walking()
    bound: float = 4.0
    threads: int = 2
    default: bool = False
    quick: bool = False

    def solve(
        self,
        problem: GaitProblem,
        seed: int = 0,
        progress: Progress = no_progress,
        start: np.ndarray | None = None,
    ) -> Gait:
        """Return the gait of `problem`; a seed gives one result.

        With a `start` (n_w,) there are no random ones: it is taken through the rounds alone.

        The meta data hold `seconds`, `objective` (mean cost of a cycle while switching), `history`
        (objective of each iteration) and `stages`.
        """
        began = time.perf_counter()
        rng = np.random.default_rng(seed)
        if start is None and self.tried:
            tell = lambda message, done: progress(f"gait: {message}", 0.3 * done)  # noqa: E731
            start = try_tasks(problem, seed, tell).w
        given = start is not None
        if problem.dynamics.world.walks:
            trace = Trace(progress, self.walking.iterations(problem.n_tasks, given))
            w, history, stages = self.walking.solve(problem, rng, trace, start, self.threads)
            best = _Trial(w, tuple(history), tuple(stages))
        else:
            best = self._swim(problem, rng, Trace(progress, self._total_iterations(given)), start)
        meta = {
            "solver": self.name,
            "seed": seed,
            "seconds": time.perf_counter() - began,
            "objective": best.stages[-1]["objective"],
            "history": list(best.history),
            "stages": list(best.stages),
        }
        return problem.gait(best.w, meta)

    def _swim(
        self,
        problem: GaitProblem,
        rng: np.random.Generator,
        trace: Trace,
        start: np.ndarray | None,
    ) -> _Trial:
        """Return the best of several starts, taken through the rounds."""
        cost = problem.objective(problem.switching_sequences(rng), settle=1, threads=self.threads)
        trace.message = "gait: straight ahead"
        trials = []
        if start is not None:
            trials.append(_Trial(start, (), ()))
        for _ in range(self.starts if start is None else 0):
            w, stage = self._start(problem, rng, trace)
            trials.append(_Trial(w, (), (stage | {"stage": "straight task"},)))
        for number, (iterations, survivors) in enumerate(self.rounds):
            trace.message = f"gait: all tasks, round {number + 1} of {len(self.rounds)}"
            for i, trial in enumerate(trials):
                w, stage = self._minimise(
                    problem, cost, trial.w, iterations, trace, WARM if start is not None else {}
                )
                history = (*trial.history, *trace.of(stage))
                stage |= {"stage": trace.message.removeprefix("gait: ")}
                trials[i] = _Trial(w, history, (*trial.stages, stage))
            trials = sorted(trials, key=lambda trial: trial.stages[-1]["objective"])[:survivors]
        return trials[0]

    def _total_iterations(self, given: bool) -> int:
        total, trials = (0, 1) if given else (self.starts * self.start_iterations, self.starts)
        for iterations, survivors in self.rounds:
            total, trials = total + trials * iterations, survivors
        return total

    def _start(
        self, problem: GaitProblem, rng: np.random.Generator, trace: Trace
    ) -> tuple[np.ndarray, dict]:
        """Optimise the straight task alone from a random start, and spread it to all tasks."""
        task = min(range(problem.n_tasks), key=lambda j: problem.tasks[j].angle)
        alone = problem.alone(task)
        cost = alone.objective([[0] * self.start_cycles], settle=2)
        w0 = alone.random_gait(rng)
        w, stage = self._minimise(alone, cost, w0, self.start_iterations, trace)
        mu, alpha, beta = alone.split(w)
        return self._spread(problem, task, mu, alpha[0], beta[0]), stage

    def _spread(
        self,
        problem: GaitProblem,
        straight: int,
        mu: np.ndarray,
        alpha: np.ndarray,
        beta: np.ndarray,
    ) -> np.ndarray:
        """Start all tasks from the straight one; a turning task with the bend that suits it best.

        The last DMP element becomes a constant bend (beta = 0) of one mode; which one, and how
        much, is tried out.
        """
        all_alpha = np.repeat(alpha[None], problem.n_tasks, 0)
        all_beta = np.repeat(beta[None], problem.n_tasks, 0)
        for j in range(problem.n_tasks):
            if j == straight:
                continue
            alone = problem.alone(j)
            cost = alone.objective([[0] * self.start_cycles], settle=2)
            best = np.inf
            for w in bent_gaits(alone, alone.join(mu, alpha[None], beta[None])):
                try:
                    value = float(cost(w))
                except RuntimeError:  # a step of this start did not converge: not a start
                    continue
                if value < best:
                    _, a, b = alone.split(w)
                    best, all_alpha[j], all_beta[j] = value, a[0], b[0]
        return problem.join(mu, all_alpha, all_beta)

    def _minimise(
        self,
        problem: GaitProblem,
        cost: ca.Function,
        w0: np.ndarray,
        iterations: int,
        trace: Trace,
        chosen: Mapping[str, object] = MappingProxyType({}),
    ) -> tuple[np.ndarray, dict]:
        """Run ipopt; return w and what the stage was."""
        x, n = ca.MX.sym("x", problem.n_w), problem.n_phases
        bound = np.concatenate([np.full(n, np.inf), np.full(problem.n_w - n, self.bound)])
        amplitude = np.tile(
            problem.dynamics.body.amplitude, problem.n_tasks * problem.steps_per_cycle
        )
        nlp = {"x": x, "f": cost(x), "g": ca.vec(problem.dmp(x))}
        callback = _Callback(trace)
        options = {f"ipopt.{key}": value for key, value in {**IPOPT, **chosen}.items()}
        options |= {
            "ipopt.max_iter": iterations,
            "print_time": False,
            "iteration_callback": callback,
            "show_eval_warnings": False,
        }
        solver = ca.nlpsol("gait", "ipopt", nlp, options)
        began = time.perf_counter()
        result = solver(x0=w0, lbx=-bound, ubx=bound, lbg=-amplitude, ubg=amplitude)
        stats = solver.stats()
        return np.array(result["x"]).ravel(), {
            "objective": float(result["f"]),
            "iterations": int(stats["iter_count"]),
            "evaluations": int(stats["n_call_nlp_f"]),
            "status": stats["return_status"],
            "seconds": time.perf_counter() - began,
        }


@dataclass(frozen=True)
class _Trial:
    """One start on its way: unknowns, objective of each iteration, what its stages were."""

    w: np.ndarray
    history: tuple[float, ...]
    stages: tuple[dict, ...]


class _Callback(ca.Callback):
    """Called by ipopt after each iteration."""

    def __init__(self, trace: Trace):
        super().__init__()
        self.trace = trace
        self.construct("trace", {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return ca.nlpsol_out(i)

    def get_name_out(self, i: int) -> str:
        return "stop"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1) if ca.nlpsol_out(i) == "f" else ca.Sparsity(0, 0)

    def eval(self, arg: list) -> list:
        self.trace.add(float(arg[ca.nlpsol_out().index("f")]))
        return [0]


SOLVER = Shooting(default=True)
QUICK = Shooting(
    name="shooting-quick",
    summary="shooting from short trials of each gait, few iterations: what a guessed task takes",
    quick=True,
    tried=True,
    rounds=((50, 1),),
    walking=Walking(
        rounds=((4, 8, 15), (6, 8, 15)),
        repair=(8, 6, 15),
    ),
)
