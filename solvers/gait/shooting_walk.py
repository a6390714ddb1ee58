"""Single shooting of a walker's gaits: L-BFGS-B over w through the exact adjoint of the rollout.

A gait that falls has no useful gradient, so that each stage begins with gaits that stay up that long:
each task alone from random starts, and soon all tasks together while they are switched, over longer
and longer sequences: of two cycles first, so that every task learns to take over from every other. A
fall makes the objective jump by orders of magnitude, which ipopt takes for a fair price of a feasible
point; so target shapes are bounded by a penalty here, and every iteration lowers the objective.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import repeat

import casadi as ca
import numpy as np
from scipy.optimize import OptimizeResult, minimize

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.world import tilt
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.switching import roll_cycles

_SCALES = 1.0, 0.15  # of the unknowns alpha and beta
_PENALTY = 5.0  # of the mean squared excess of target shapes
_FAILED = 1e3  # objective where a step does not converge: more than any fall's
_MEMORY = 20  # pairs of L-BFGS
_WALK = 300  # cycles that the hardest sequences are taken from
_KEPT = 0.6  # chance that a task is kept on with


@dataclass
class Trace:
    """What an optimiser tells after each iteration: keeps the objective, shows progress."""

    progress: Progress
    total: int
    message: str = ""
    objective: list[float] = field(default_factory=list)

    def add(self, objective: float) -> None:
        """Take the objective of an iteration."""
        self.objective.append(objective)
        self.progress(self.message, min(1.0, len(self.objective) / self.total))

    def of(self, stage: dict) -> list[float]:
        """Return the objective of each iteration of the stage that was the last one."""
        return self.objective[len(self.objective) - stage["iterations"] :]


@dataclass(frozen=True)
class Walking:
    """Stages of a walker's gaits.

    Attributes:
        starts: random starts of each task alone.
        alone: (cycles of the walk, limit of iterations, starts that go on) of each task alone.
        rounds: (cycles of a sequence, sequences, limit of iterations) of all tasks; after the first,
            half of the sequences are those that the gaits so far tilt most in.
        repair, repairs: such rounds, and how many at most, while the gaits still fall in long walks: on
            each task over and over, as planners do, and on the hardest sequences of a walk that keeps
            on with its tasks. Gaits that fall less often are taken.
        bound: of alpha and beta.
    """

    starts: int = 8
    alone: tuple[tuple[int, int, int], ...] = ((2, 12, 3), (3, 25, 1))
    rounds: tuple[tuple[int, int, int], ...] = (
        *((2, 16, 40), (4, 12, 40)),
        *((6, 12, 30), (6, 12, 30), (6, 12, 30)),
    )
    repair: tuple[int, int, int] = (12, 8, 30)
    repairs: int = 1
    bound: float = 4.0

    def iterations(self, tasks: int, given: bool) -> int:
        """Return the limit of all iterations together."""
        total, starts = 0, self.starts
        for _, iterations, kept in self.alone:
            total, starts = total + starts * iterations, kept
        return (0 if given else tasks * total) + sum(iterations for *_, iterations in self.rounds)

    def solve(
        self,
        problem: GaitProblem,
        rng: np.random.Generator,
        trace: Trace,
        start: np.ndarray | None,
        threads: int,
    ) -> tuple[np.ndarray, list[float], list[dict]]:
        """Return w of all tasks, the objective of each iteration of the rounds, what the stages were.

        With a `start` (n_w,) it is taken through the rounds alone.
        """
        w, history, stages = start, [], []
        if w is None:
            trace.message = "gait: each task alone"
            alone = [problem.alone(j) for j in range(problem.n_tasks)]
            starts = [[one.random_gait(rng) for _ in range(self.starts)] for one in alone]
            with ThreadPoolExecutor(threads) as pool:  # CasADi lets other threads run meanwhile
                results = list(pool.map(self._alone, alone, starts, repeat(trace)))
            stages = [stage for *_, stage in results]
            mu, alphas, betas, _ = zip(*results, strict=True)
            w = problem.join(mu[0], np.array(alphas), np.array(betas))
        for number, (cycles, count, iterations) in enumerate(self.rounds):
            hard = [] if number == 0 else hardest(problem, w, cycles, count // 2, rng)
            sequences = hard + solvable(problem, w, cycles, count - len(hard), rng)
            if not sequences:
                raise DefplanError(
                    f"the gaits of {problem.dynamics.body.name} cannot be simulated over {cycles}"
                    " cycles: take another seed"
                )
            trace.message = f"gait: all tasks, round {number + 1} of {len(self.rounds)}"
            w, stage = self._minimise(problem, sequences, w, iterations, trace, threads)
            history += trace.of(stage)
            stages.append(stage)
        for number in range(self.repairs):
            before = falls(problem, w)
            if not before:
                break
            cycles, count, iterations = self.repair
            sequences = repeated(problem, w, cycles)
            sequences += hardest(problem, w, cycles, count - len(sequences), rng, _KEPT)
            if not sequences:
                break
            trace.message = f"gait: against falls, round {number + 1}"
            found_w, stage = self._minimise(problem, sequences, w, iterations, trace, threads)
            after = falls(problem, found_w)
            stage["falls"] = [before, after]
            if after < before:
                w = found_w
                history += trace.of(stage)
                stages.append(stage)
            else:  # the last stage is the one that the gaits are of
                stages.insert(-1, stage)
        return w, history, stages

    def _alone(
        self, alone: GaitProblem, starts: Sequence[np.ndarray], trace: Trace
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict]:
        """Return mu (D, r), alpha, beta (D, r) and the last stage of one task's best start."""
        trials = [(w, {"objective": np.inf}) for w in starts]
        for cycles, iterations, kept in self.alone:
            trials = [
                self._minimise(alone, [[0] * cycles], w, iterations, trace, 1) for w, _ in trials
            ]
            trials = sorted(trials, key=lambda trial: trial[1]["objective"])[:kept]
        w, stage = trials[0]
        mu, alpha, beta = alone.split(w)
        return mu, alpha[0], beta[0], stage | {"stage": f"{alone.tasks[0].name} alone"}

    def _minimise(
        self,
        problem: GaitProblem,
        sequences: Sequence[Sequence[int]],
        w0: np.ndarray,
        iterations: int,
        trace: Trace,
        threads: int,
    ) -> tuple[np.ndarray, dict]:
        """Lower the cost of sequences; return w and what the stage was. Phases stay as they are."""
        began = time.perf_counter()
        w, n = ca.MX.sym("w", problem.n_w), problem.n_phases
        shapes = problem.dmp(w)
        excess = ca.fmax(0, ca.fabs(shapes) - problem.dynamics.body.amplitude)
        cost = problem.objective(sequences, settle=0, threads=threads)(w)
        cost += _PENALTY * ca.sumsqr(excess) / excess.numel()
        function = ca.Function("cost", [w], [cost, ca.gradient(cost, w)])
        scale = np.repeat(_SCALES, n * problem.n_tasks)
        bound = self.bound / scale

        def evaluate(y: np.ndarray) -> tuple[float, np.ndarray]:
            try:
                value, gradient = function(np.concatenate([w0[:n], scale * y]))
            except RuntimeError:  # a step does not converge: as a wall
                return _FAILED, np.zeros_like(y)
            return float(value), scale * np.array(gradient).ravel()[n:]

        def tell(intermediate_result: OptimizeResult) -> None:
            trace.add(float(intermediate_result.fun))

        result = minimize(
            evaluate,
            w0[n:] / scale,
            jac=True,
            method="L-BFGS-B",
            bounds=np.stack([-bound, bound], 1),
            callback=tell,
            options={"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": _MEMORY},
        )
        return np.concatenate([w0[:n], scale * result.x]), {
            "stage": trace.message.removeprefix("gait: "),
            "objective": float(result.fun),
            "iterations": int(result.nit),
            "evaluations": int(result.nfev),
            "status": str(result.message),
            "seconds": time.perf_counter() - began,
        }


def hardest(
    problem: GaitProblem,
    w: np.ndarray,
    cycles: int,
    count: int,
    rng: np.random.Generator,
    kept: float = 0.0,
) -> list[list[int]]:
    """Return at most `count` sequences of tasks after which the walker tilts most, of a long walk at w.

    A cycle has a random task, or, with the chance `kept`, that of the cycle before.
    """
    dynamics, table = problem.dynamics, problem.gait(w, {}).table()
    task = random_tasks(problem.n_tasks, kept, rng)
    states, _ = roll_cycles(dynamics, table[task])
    sequences: dict[int, list[int]] = {}
    for last in np.argsort(-tilt(states).max(1), kind="stable"):
        sequence = [int(j) for j in task[max(0, last + 1 - cycles) : last + 1]]
        near = any(abs(last - other) < cycles / 2 for other in sequences)
        fits = len(sequences) < count and len(sequence) == cycles and not near
        if fits and solves(dynamics, table[sequence]):
            sequences[int(last)] = sequence
    return list(sequences.values())


def solvable(
    problem: GaitProblem, w: np.ndarray, cycles: int, count: int, rng: np.random.Generator
) -> list[list[int]]:
    """Return random sequences of tasks, each task first in as many; none whose solve fails at w."""
    dynamics, table = problem.dynamics, problem.gait(w, {}).table()
    sequences: list[list[int]] = []
    for _ in range(10 * count):
        first, rest = len(sequences) % problem.n_tasks, rng.integers(problem.n_tasks, size=cycles)
        sequence = [first, *(int(task) for task in rest[1:])]
        if solves(dynamics, table[sequence]):
            sequences.append(sequence)
        if len(sequences) == count:
            break
    return sequences


def repeated(problem: GaitProblem, w: np.ndarray, cycles: int) -> list[list[int]]:
    """Return each task over and over; none whose solve fails at w."""
    table = problem.gait(w, {}).table()
    sequences = [[j] * cycles for j in range(problem.n_tasks)]
    return [one for one in sequences if solves(problem.dynamics, table[one])]


def falls(problem: GaitProblem, w: np.ndarray) -> int:
    """Return how often the walker comes down in walks at w: tasks at random, and mostly kept on with."""
    table = problem.gait(w, {}).table()
    return sum(
        int(roll_cycles(problem.dynamics, table[random_tasks(problem.n_tasks, kept)])[1].sum())
        for kept in (0.0, _KEPT, 0.9)
    )


def random_tasks(tasks: int, kept: float, rng: np.random.Generator | None = None) -> np.ndarray:
    """Return tasks of a long walk: random ones, or, with the chance `kept`, that of the cycle before."""
    rng = rng or np.random.default_rng(0)
    task = rng.integers(tasks, size=_WALK)
    if kept:
        for i in np.flatnonzero(rng.random(_WALK - 1) < kept):
            task[i + 1] = task[i]
    return task


def solves(dynamics: ReducedDynamics, cycles: np.ndarray) -> bool:
    """Return whether every step of target shapes (cycles, steps, nu) from rest converges."""
    shapes = cycles.reshape(-1, dynamics.nu)
    return not dynamics.rollout_count(dynamics.rest_state(), shapes)[1]
