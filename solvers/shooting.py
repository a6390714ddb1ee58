"""Gait solver `shooting`: CasADi's ipopt over w_dmp through the exact adjoint of the rollout.

The straight task alone from random starts, then all tasks while they are switched; after each
round only the best starts go on.
Target shapes are bounded by the body's amplitude as constraints, not by clipping.

A walker's tasks are each optimised alone from random starts, over longer and longer walks, and then
together while they are switched, over longer and longer sequences: a gait that falls has no useful
gradient, so that each stage begins with gaits that stay up that long. A fall makes the objective jump
by orders of magnitude, which ipopt takes for a fair price of a feasible point; so target shapes are
bounded by a penalty here, and every iteration lowers the objective.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from defplan_mj.errors import DefplanError
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.task import Progress, no_progress

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
WALKING = {"mu_strategy": "monotone", "mu_init": 1e-6}
_SCALES = 0.3, 1.0, 0.15  # of ipopt's unknowns for a walker: mu, alpha, beta
_PENALTY = 5.0  # of the mean squared excess of target shapes


@dataclass(frozen=True)
class Shooting:
    """Single shooting.

    Attributes:
        starts: random starts.
        start_cycles: cycles of the straight task's trajectory.
        start_iterations: limit of ipopt's iterations for the straight task.
        rounds: (limit of iterations for all tasks, starts that go on), round after round.
        walk_starts: random starts of each task of a walker.
        walks: (cycles of the walk, limit of iterations) of each task alone, one after the other.
        walk_rounds: (cycles of a sequence, sequences, limit of iterations) of all tasks, likewise.
        bound: of alpha and beta.
        threads: rollouts in parallel.
    """

    kind: str = "gait"
    name: str = "shooting"
    summary: str = "single shooting through the exact adjoint, with CasADi and ipopt (the default)"
    starts: int = 5
    start_cycles: int = 6
    start_iterations: int = 40
    rounds: tuple[tuple[int, int], ...] = ((25, 2), (50, 1), (175, 1))
    walk_starts: int = 3
    walks: tuple[tuple[int, int], ...] = ((3, 25), (5, 15), (8, 20))
    walk_rounds: tuple[tuple[int, int, int], ...] = ((3, 12, 15), (6, 8, 20), (8, 8, 20))
    bound: float = 4.0
    threads: int = 2

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
        if problem.dynamics.terrain is not None:
            trace = _Trace(progress, self._walk_iterations(problem, start is not None))
            best = self._walk(problem, rng, trace, start)
        else:
            trace = _Trace(progress, self._total_iterations(start is not None))
            best = self._swim(problem, rng, trace, start)
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
        trace: _Trace,
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
                history = (*trial.history, *trace.objective[-stage["iterations"] :])
                stage |= {"stage": trace.message.removeprefix("gait: ")}
                trials[i] = _Trial(w, history, (*trial.stages, stage))
            trials = sorted(trials, key=lambda trial: trial.stages[-1]["objective"])[:survivors]
        return trials[0]

    def _walk(
        self,
        problem: GaitProblem,
        rng: np.random.Generator,
        trace: _Trace,
        start: np.ndarray | None,
    ) -> _Trial:
        """Return gaits of all tasks, each optimised alone, then taken through the walkers' rounds."""
        stages, history = [], []
        if start is None:
            found = [self._walk_alone(problem.alone(j), rng, trace) for j in range(problem.n_tasks)]
            stages = [stage for *_, stage in found]
            mu, alphas, betas, _ = zip(*found, strict=True)
            start = problem.join(mu[0], np.array(alphas), np.array(betas))
        w = start
        for number, (cycles, count, iterations) in enumerate(self.walk_rounds):
            trace.message = f"gait: all tasks, round {number + 1} of {len(self.walk_rounds)}"
            sequences = self._solvable(problem, w, cycles, count, rng)
            if not sequences:
                raise DefplanError(
                    f"the gaits of {problem.dynamics.body.name} cannot be simulated over {cycles}"
                    " cycles: take another seed"
                )
            cost = problem.objective(sequences, settle=0, threads=self.threads)
            w, stage = self._minimise(problem, cost, w, iterations, trace)
            history += trace.objective[len(trace.objective) - stage["iterations"] :]
            stages.append(stage | {"stage": trace.message.removeprefix("gait: ")})
        return _Trial(w, tuple(history), tuple(stages))

    def _walk_alone(
        self, alone: GaitProblem, rng: np.random.Generator, trace: _Trace
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict]:
        """Return mu (D, r), alpha, beta (D, r) and the last stage of one task's best start."""
        name = alone.tasks[0].name
        trace.message = f"gait: {name} alone"
        best: tuple[np.ndarray, dict] = alone.random_gait(rng), {"objective": np.inf}
        for start in range(self.walk_starts):
            cycles, iterations = self.walks[0]
            w = best[0] if start == 0 else alone.random_gait(rng)
            cost = alone.objective([[0] * cycles], settle=0)
            found = self._minimise(alone, cost, w, iterations, trace)
            best = min(best, found, key=lambda trial: trial[1]["objective"])
        for cycles, iterations in self.walks[1:]:
            if self._solvable(alone, best[0], cycles, 1, rng):
                cost = alone.objective([[0] * cycles], settle=0)
                best = self._minimise(alone, cost, best[0], iterations, trace)
        mu, alpha, beta = alone.split(best[0])
        return mu, alpha[0], beta[0], best[1] | {"stage": f"{name} alone"}

    def _walk_iterations(self, problem: GaitProblem, given: bool) -> int:
        first, *longer = (iterations for _, iterations in self.walks)
        alone = 0 if given else problem.n_tasks * (self.walk_starts * first + sum(longer))
        return alone + sum(iterations for *_, iterations in self.walk_rounds)

    def _solvable(
        self,
        problem: GaitProblem,
        w: np.ndarray,
        cycles: int,
        count: int,
        rng: np.random.Generator,
    ) -> list[list[int]]:
        """Return random sequences of tasks, each task first in as many; none whose solve fails at w."""
        dynamics, table = problem.dynamics, problem.gait(w, {}).table()
        found: list[list[int]] = []
        for _ in range(10 * count):
            first, rest = len(found) % problem.n_tasks, rng.integers(problem.n_tasks, size=cycles)
            sequence = [first, *(int(task) for task in rest[1:])]
            shapes = table[sequence].reshape(-1, dynamics.nu)
            if not dynamics.rollout_count(dynamics.rest_state(), shapes)[1]:
                found.append(sequence)
            if len(found) == count:
                break
        return found

    def _total_iterations(self, given: bool) -> int:
        total, trials = (0, 1) if given else (self.starts * self.start_iterations, self.starts)
        for iterations, survivors in self.rounds:
            total, trials = total + trials * iterations, survivors
        return total

    def _start(
        self, problem: GaitProblem, rng: np.random.Generator, trace: _Trace
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
            for mode in range(problem.dynamics.nu):
                for bend in 0.5 * np.array([-1, -0.6, -0.3, 0.3, 0.6, 1]):
                    a, b = alpha.copy(), beta.copy()
                    a[-1, mode] += bend * problem.dynamics.body.amplitude[mode]
                    b[-1] = 0
                    try:
                        value = float(cost(alone.join(mu, a[None], b[None])))
                    except RuntimeError:  # a step of this start did not converge: not a start
                        continue
                    if value < best:
                        best, all_alpha[j], all_beta[j] = value, a, b
        return problem.join(mu, all_alpha, all_beta)

    def _minimise(
        self,
        problem: GaitProblem,
        cost: ca.Function,
        w0: np.ndarray,
        iterations: int,
        trace: _Trace,
        chosen: Mapping[str, object] = MappingProxyType({}),
    ) -> tuple[np.ndarray, dict]:
        """Run ipopt; return w and what the stage was."""
        x, n = ca.MX.sym("x", problem.n_w), problem.n_phases
        bound = np.concatenate([np.full(n, np.inf), np.full(problem.n_w - n, self.bound)])
        low, high, w, scale = -bound, bound, x, np.ones(problem.n_w)
        walks = problem.dynamics.terrain is not None
        if walks:
            chosen = WALKING
            scale = np.repeat(_SCALES, (n, n * problem.n_tasks, n * problem.n_tasks))
            w = scale * x
            low[:n] = high[:n] = w0[:n]  # the phases stay as they are
        shapes = problem.dmp(w)
        amplitude = np.tile(problem.dynamics.body.amplitude, shapes.shape[1])
        nlp, given = {"x": x, "f": cost(w)}, {}
        if walks:
            excess = ca.fmax(0, ca.fabs(ca.vec(shapes)) - amplitude)
            nlp["f"] += _PENALTY * ca.sumsqr(excess) / excess.numel()
        else:
            nlp["g"] = ca.vec(shapes)
            given = {"lbg": -amplitude, "ubg": amplitude}
        options = {f"ipopt.{key}": value for key, value in {**IPOPT, **chosen}.items()}
        options |= {
            "ipopt.max_iter": iterations,
            "print_time": False,
            "iteration_callback": trace,
            "show_eval_warnings": False,
        }
        solver = ca.nlpsol("gait", "ipopt", nlp, options)
        began = time.perf_counter()
        result = solver(x0=w0 / scale, lbx=low / scale, ubx=high / scale, **given)
        stats = solver.stats()
        return scale * np.array(result["x"]).ravel(), {
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


class _Trace(ca.Callback):
    """Called by ipopt after each iteration: keeps the objective, shows progress."""

    def __init__(self, progress: Progress, total: int):
        super().__init__()
        self.message, self.progress, self.total = "", progress, total
        self.objective: list[float] = []
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
        self.objective.append(float(arg[ca.nlpsol_out().index("f")]))
        self.progress(self.message, min(1.0, len(self.objective) / self.total))
        return [0]


SOLVER = Shooting()
