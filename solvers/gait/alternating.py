"""Gait solver `alternating`: the paper's scheme for Eq. 1, states, target shapes and w by turns.

With w fixed, Newton on all states x_i and target shapes u_i of E_phys + E_obj + E_dmp; with x and u
fixed, quasi-Newton on w of E_dmp (trajectories.py has the first half). Every round's w is re-simulated.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_solvers.gait.trajectories import Trajectories

_IPOPT = {
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": 20,
    "mu_strategy": "adaptive",
    "tol": 1e-5,
    "print_level": 0,
    "sb": "yes",
}
_LOWER, _RAISE = 1.5, 3.0  # of the weight of E_dmp, after a better and a worse round


class Fit:
    """Quasi-Newton on w, states and shapes fixed: dmp E_dmp and what the objective has of w alone.

    The body's amplitude bounds the DMP, as constraints.
    """

    def __init__(
        self,
        problem: GaitProblem,
        sequences: Sequence[Sequence[int]],
        bound: float,
        iterations: int,
    ):
        self.task = np.array(sequences).ravel()
        self.total = len(self.task) * problem.steps_per_cycle
        k, n, r = problem.n_tasks, problem.steps_per_cycle, problem.dynamics.nu
        self.size = (k, n, r)
        w, mean = ca.MX.sym("w", problem.n_w), ca.MX.sym("mean", r, k * n)
        weight = ca.MX.sym("weight", k * n)  # dmp times the share of the steps
        shapes = problem.dmp(w)
        error = ca.dot(weight, ca.sum1((shapes - mean) ** 2).T)
        nlp = {
            "x": w,
            "p": ca.vertcat(ca.vec(mean), weight),
            "f": error + problem.regularisation(w),
            "g": ca.vec(shapes),
        }
        options = {f"ipopt.{key}": value for key, value in _IPOPT.items()}
        options |= {"ipopt.max_iter": iterations, "print_time": False}
        self.solver = ca.nlpsol("fit", "ipopt", nlp, options)
        amplitude = np.tile(problem.dynamics.body.amplitude, k * n)
        free, half = np.full(problem.n_phases, np.inf), problem.n_w - problem.n_phases
        box = np.concatenate([free, np.full(half, bound)])
        self.limits = {"lbx": -box, "ubx": box, "lbg": -amplitude, "ubg": amplitude}

    def __call__(self, w: np.ndarray, shapes: np.ndarray, dmp: float) -> np.ndarray:
        """Return w whose DMP fits target shapes (M, r), from a start w.

        All cycles of a task see the same DMP: their mean is all that matters.
        """
        k, n, r = self.size
        cycles = shapes.reshape(-1, n, r)
        mean = np.zeros((k, n, r))
        for j in np.unique(self.task):
            mean[j] = cycles[self.task == j].mean(0)
        share = np.repeat(np.bincount(self.task, minlength=k), n) / self.total
        parameters = np.concatenate([mean.ravel(), dmp * share])
        return np.array(self.solver(x0=w, p=parameters, **self.limits)["x"]).ravel()


@dataclass(frozen=True)
class Alternating:
    """The paper's alternation, started as `shooting` is: the straight task first, then all.

    Each round starts from the simulation of the best w so far. The weight of E_dmp is raised where
    the round's w is worse when simulated, and lowered where it is better: it bounds how far the
    target shapes may leave the DMP, like a trust region. Multipliers (as in the alternating
    direction method of multipliers) carry over what the DMP could not follow.

    Attributes:
        starts: random starts of the straight task; the best goes on.
        start_cycles: cycles of the straight task's trajectory.
        start_rounds, rounds: alternations for the straight task, and for all tasks.
        newton_iterations: on states and target shapes, a round.
        fit_iterations: quasi-Newton iterations on w, a round.
        physics: weight of E_phys; below 1e6 it pays to break the dynamics.
        dmp: weight of E_dmp at the start.
        bound: of alpha and beta.
        threads: for the steps.
    """

    kind: str = "gait"
    name: str = "alternating"
    summary: str = (
        "the paper's scheme: Newton on states and target shapes, quasi-Newton on w, by turns"
    )
    starts: int = 2
    start_cycles: int = 8
    start_rounds: int = 12
    rounds: int = 24
    newton_iterations: int = 8
    fit_iterations: int = 60
    physics: float = 1e6
    dmp: float = 1.0
    bound: float = 4.0
    threads: int = 2

    def solve(self, problem: GaitProblem, seed: int = 0, progress: Progress = no_progress) -> Gait:
        """Return the gait of `problem`; a seed gives one result.

        The meta data hold `seconds`, `objective` (what the states of the last round claim),
        `resimulated` (what w really gives), `history` (of `resimulated`) and `stages`.
        """
        began = time.perf_counter()
        rng = np.random.default_rng(seed)
        sequences = problem.switching_sequences(rng)
        straight = min(range(problem.n_tasks), key=lambda j: problem.tasks[j].angle)
        alone = problem.alone(straight)
        total = self.starts * self.start_rounds + 3 * self.rounds  # an all-task round takes longer
        stages, trials = [], []
        for start in range(self.starts):
            done = start * self.start_rounds
            tell = partial(_tell, progress, "gait: straight task", done, 1, total)
            w = alone.random_gait(rng)
            w, stage = self._alternate(
                alone, [[0] * self.start_cycles], 2, w, self.start_rounds, tell
            )
            stages.append(stage | {"stage": f"start {start + 1}, straight task"})
            trials.append((stage["resimulated"], w))
        mu, alpha, beta = alone.split(min(trials, key=lambda trial: trial[0])[1])
        k = problem.n_tasks
        w = problem.join(mu, np.repeat(alpha, k, 0), np.repeat(beta, k, 0))
        tell = partial(_tell, progress, "gait: all tasks", total - 3 * self.rounds, 3, total)
        w, stage = self._alternate(problem, sequences, 1, w, self.rounds, tell)
        stages.append(stage | {"stage": "all tasks"})
        meta = {
            "solver": self.name,
            "seed": seed,
            "seconds": time.perf_counter() - began,
            "objective": stage["objective"],
            "resimulated": stage["resimulated"],
            "history": stage.pop("history"),
            "stages": stages,
        }
        return problem.gait(w, meta)

    def _alternate(
        self,
        problem: GaitProblem,
        sequences: Sequence[Sequence[int]],
        settle: int,
        w: np.ndarray,
        rounds: int,
        tell: Callable[[int], None],
    ) -> tuple[np.ndarray, dict]:
        """Run the rounds from w; return the best w and what the stage was."""
        began = time.perf_counter()
        trajectories = Trajectories(problem, sequences, settle, self.threads)
        fit = Fit(problem, sequences, self.bound, self.fit_iterations)
        simulated = problem.objective(sequences, settle, self.threads)
        alone = _of_w_alone(problem)
        best = claimed = float(simulated(w))
        dmp, damping, history, claims = self.dmp, 1.0, [best], []
        multiplier = np.zeros((trajectories.total, trajectories.r))
        for done in range(rounds):
            given = trajectories.dmp(w)
            _, shapes, parts, last = trajectories.newton(
                trajectories.simulate(given),
                given,
                given - multiplier,
                self.physics,
                dmp,
                self.newton_iterations,
                damping,
            )
            new = fit(w, shapes + multiplier, dmp)
            claims.append(parts[1] + float(alone(new)))
            try:
                value = float(simulated(new))
            except RuntimeError:  # a step of this gait does not converge
                value = np.inf
            if value < best:
                w, best, claimed = new, value, claims[-1]
                dmp, damping = dmp / _LOWER, min(max(last, 1e-2), 10.0)
                multiplier = _LOWER * (multiplier + shapes - trajectories.dmp(w))
            else:
                dmp, multiplier = dmp * _RAISE, 0 * multiplier
            history.append(best)
            tell(done + 1)
        return w, {
            "objective": claimed,
            "resimulated": best,
            "claims": claims,
            "history": history,
            "rounds": rounds,
            "seconds": time.perf_counter() - began,
        }


def _tell(
    progress: Progress, message: str, before: int, weight: int, total: int, done: int
) -> None:
    progress(message, (before + weight * done) / total)


def _of_w_alone(problem: GaitProblem) -> ca.Function:
    w = ca.MX.sym("w", problem.n_w)
    return ca.Function("regularisation", [w], [problem.regularisation(w)])


SOLVER = Alternating()
