"""Short trials of what a body can do, before its gaits are optimised: what to want of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.switching import measure_cycles

_CYCLES, _SETTLE = 6, 2
_STARTS = 3  # of the straight task
_ITERATIONS = (15, 50)  # of each start, and of the best of them
_OUTSIDE = 10.0  # weight of the mean squared excess of a target shape over the body's amplitude
_BOUND = 4.0  # of alpha and beta
_UNSOLVED = 1e3  # more than any cycle costs: a step of it was not solved


@dataclass(frozen=True)
class Trial:
    """What a body did in a short trial of a task, a cycle.

    Attributes:
        advance: in the task's direction, m.
        turn: about the task's axis (in the plane: up), rad, with the sign of what is wanted.
    """

    advance: float
    turn: float


@dataclass(frozen=True)
class Tried:
    """What short trials came to.

    Attributes:
        w: (n_w,) the gaits of all tasks, each tried alone, with the phases mu in common: a start.
        trials: what each of them does.
    """

    w: np.ndarray
    trials: tuple[Trial, ...]


_LAST: dict[tuple, Tried] = {}
"""What was tried last: who guesses a task of a mesh optimises its gaits next."""


def try_tasks(problem: GaitProblem, seed: int = 0, progress: Progress = no_progress) -> Tried:
    """Return what a few iterations of L-BFGS-B make of each task of a swimmer, alone.

    The straightest task is tried from random gaits, and the others from what that came to, bent, in its
    phases. It is the problem's own objective, with a penalty for target shapes beyond the body's amplitude.

    Args:
        progress: told the share that is done.
    """
    key = (_told(problem), seed)
    if key not in _LAST:
        tried = _try_tasks(problem, seed, progress)
        _LAST.clear()
        _LAST[key] = tried
    return _LAST[key]


def _told(problem: GaitProblem) -> tuple:
    """Return all that trials depend on."""
    own = problem.dynamics
    stepping = (own.body.hash, own.timestep, *own.stepping.items(), problem.steps_per_cycle)
    return (*stepping, problem.tasks, problem.weights, tuple(problem.axis), problem.space)


def _try_tasks(problem: GaitProblem, seed: int, progress: Progress) -> Tried:
    rng, order = (
        np.random.default_rng(seed),
        sorted(range(problem.n_tasks), key=lambda j: problem.tasks[j].angle),
    )
    straight: np.ndarray | None = None
    found: dict[int, np.ndarray] = {}
    done: dict[int, Trial] = {}
    for number, j in enumerate(order):
        progress("trying what the body can do", number / len(order))
        alone = problem.alone(j)
        if straight is None:
            starts = [alone.random_gait(rng) for _ in range(_STARTS)]
        else:
            starts = (
                [straight, *bent_gaits(alone, straight)] if alone.tasks[0].angle else [straight]
            )
        found[j] = _optimised(alone, starts, straight is None)
        straight = found[j] if straight is None else straight
        done[j] = _measured(alone, found[j])
    parts = [problem.alone(j).split(found[j]) for j in range(problem.n_tasks)]
    mu = parts[order[0]][0]
    w = problem.join(mu, *(np.concatenate([part[i] for part in parts]) for i in (1, 2)))
    return Tried(w, tuple(done[j] for j in range(problem.n_tasks)))


def bent_gaits(alone: GaitProblem, w: np.ndarray) -> Iterator[np.ndarray]:
    """Yield a gait of one task whose last DMP element is a constant bend of one mode (beta = 0), as unknowns."""
    mu, alpha, beta = alone.split(w)
    for mode in range(alone.dynamics.nu):
        for bend in 0.5 * np.array([-1, -0.6, -0.3, 0.3, 0.6, 1]):
            a, b = alpha.copy(), beta.copy()
            a[0, -1, mode] += bend * alone.dynamics.body.amplitude[mode]
            b[0, -1] = 0
            yield alone.join(mu, a, b)


def _optimised(alone: GaitProblem, starts: list[np.ndarray], first: bool) -> np.ndarray:
    """Return the best w after a few iterations from the best start.

    Args:
        first: before that a few from each of them; of the others the phases stay what they are.
    """
    w = ca.MX.sym("w", alone.n_w)
    cost = alone.objective([[0] * _CYCLES], settle=_SETTLE)(w)
    cost += _OUTSIDE * alone.excess(w)
    both = ca.Function("trial", [w], [cost, ca.gradient(cost, w)])

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        try:
            cost, slope = both(x)
        except RuntimeError:  # a step was not solved: not that far
            return _UNSOLVED, np.zeros(len(x))
        return float(cost), np.array(slope).ravel()

    phases = np.arange(alone.n_w) < alone.n_phases
    bound = np.where(phases, np.inf, _BOUND)

    def improve(x: np.ndarray, iterations: int) -> tuple[float, np.ndarray]:
        fixed = phases & (not first)
        limits = np.stack([np.where(fixed, x, -bound), np.where(fixed, x, bound)], axis=1)
        options = {"maxiter": iterations}
        found = minimize(value, x, jac=True, method="L-BFGS-B", bounds=limits, options=options)
        return float(found.fun), found.x

    few, many = _ITERATIONS
    tried = [improve(x, few) if first else (value(x)[0], x) for x in starts]
    return improve(min(tried, key=lambda pair: pair[0])[1], many)[1]


def _measured(alone: GaitProblem, w: np.ndarray) -> Trial:
    """Return the mean of the cycles after the first ones; nothing if they cannot be rolled out."""
    task = alone.tasks[0]
    try:
        cycles = measure_cycles(alone, alone.gait(w, {}), np.zeros(_CYCLES, int))
    except DefplanError:
        return Trial(0.0, 0.0)
    sign = np.sign(task.turn[2]) if alone.place.level else 1.0
    return Trial(
        float(cycles.advance[_SETTLE:].mean()), float(sign * cycles.angle[_SETTLE:].mean())
    )
