"""A few iterations of L-BFGS-B on what cycles of gaits cost, for short trials."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from defplan_mj.gait.problem import GaitProblem

THREADS = 2
_OUTSIDE = 10.0  # weight of the mean squared excess of a target shape over the body's amplitude
_BOUND = 4.0  # of alpha and beta
_UNSOLVED = 1e3  # more than any cycle costs: a step of it was not solved


class Descent:
    """L-BFGS-B on the problem's own objective, with a penalty for target shapes beyond the amplitude.

    Args:
        sequences: the task of each cycle, one list a trajectory; all of one length.
        settle: cycles of each that do not count.
        phases: these may change, too.
        sharp: scale of beta.
        threads: rollouts in parallel.
    """

    def __init__(
        self,
        problem: GaitProblem,
        sequences: Sequence[Sequence[int]],
        settle: int,
        phases: bool,
        sharp: float = 1.0,
        threads: int = 1,
    ) -> None:
        w = ca.MX.sym("w", problem.n_w)
        cost = problem.objective(sequences, settle=settle, threads=threads)(w)
        cost += _OUTSIDE * problem.excess(w)
        self._both = ca.Function("trial", [w], [cost, ca.gradient(cost, w)])
        index, of_phases = np.arange(problem.n_w), problem.n_phases
        self._held = index < (0 if phases else of_phases)
        self._bound = np.where(index < of_phases, np.inf, _BOUND)
        sharpness = index >= of_phases * (1 + problem.n_tasks)
        self._scale = np.where(sharpness, sharp, 1.0)

    def value(self, w: np.ndarray) -> tuple[float, np.ndarray]:
        """Return what w (n_w,) costs, and the gradient."""
        try:
            cost, slope = self._both(w)
        except RuntimeError:  # a step was not solved: not that far
            return _UNSOLVED, np.zeros(len(w))
        return float(cost), np.array(slope).ravel()

    def improve(self, w: np.ndarray, iterations: int) -> tuple[float, np.ndarray]:
        """Return what the best found costs, and it."""
        scale, bound = self._scale, self._bound
        low, high = np.where(self._held, w, -bound), np.where(self._held, w, bound)

        def scaled(y: np.ndarray) -> tuple[float, np.ndarray]:
            cost, slope = self.value(scale * y)
            return cost, scale * slope

        options = {"maxiter": iterations, "maxfun": 2 * iterations}
        limits = np.stack([low, high], axis=1) / scale[:, None]
        solution = minimize(
            scaled, w / scale, jac=True, method="L-BFGS-B", bounds=limits, options=options
        )
        return float(solution.fun), scale * solution.x
