"""Short trials of what a body can do, before its gaits are optimised: what to want of them."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.stepping import stepping_gaits
from defplan_mj.gait.switching import measure_cycles
from defplan_mj.task import GaitTask

ADVANCE, BENT_ADVANCE, STEP = 0.5, 0.3, 0.4
"""What a trial is asked for, in body lengths a cycle: of a swimmer, of one that turns, of a walker."""
TURN, TILT = 0.6, 0.45
"""Likewise, rad: in the plane, in space."""
_CYCLES, _SETTLE = 6, 2
_STARTS = 3  # of the straight task
_ITERATIONS = (15, 50)  # of each start, and of the best of them
_WALKED, _WALK_SETTLE = 4, 1  # cycles of a walker's
_WALK_ITERATIONS = (12, 30)
_STEPPERS, _TRIED = 2, 3  # random starts beside those that step; of all of them are optimised
_SHARP = 0.15  # scale of a walker's beta
_THREADS = 2
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
    """Return what a few iterations of L-BFGS-B make of each task alone, asked for much (`asking_much`).

    A swimmer's straightest task is tried from random gaits, and the others from what that came to, bent, in its
    phases. A walker's are tried from gaits that step (`gait.stepping`) and random ones, the best of them. It
    is the problem's own objective, with a penalty for target shapes beyond the body's amplitude.

    Args:
        progress: told the share that is done.
    """
    problem = asking_much(problem)
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
    place = (tuple(problem.axis), problem.space, str(own.world.terrain_data))
    return (*stepping, problem.tasks, problem.weights, *place)


def asking_much(problem: GaitProblem) -> GaitProblem:
    """Return a problem whose tasks want what trials ask for: the directions are theirs, the sizes are not.

    So trials do not depend on what is wanted after them.
    """
    length, walks = problem.dynamics.body.length, problem.dynamics.world.walks
    tasks = []
    for task in problem.tasks:
        turn = TURN if problem.place.level else TILT
        advance = length * (STEP if walks else BENT_ADVANCE if task.angle else ADVANCE)
        sizes = turn * bool(task.angle), advance * bool(task.advance)
        ways = (size * np.array(way) for size, way in zip(sizes, _ways(task), strict=True))
        turned, moved = (tuple(np.round(way, 9).tolist()) for way in ways)
        tasks.append(replace(task, turn=turned, move=moved))
    return problem.of_tasks(tasks)


def _ways(task: GaitTask) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis of a task's turn and the direction of its way."""
    return np.array(task.turn) / (task.angle or 1.0), np.array(task.move) / (task.advance or 1.0)


def _try_tasks(problem: GaitProblem, seed: int, progress: Progress) -> Tried:
    rng, count = np.random.default_rng(seed), problem.n_tasks
    order = sorted(range(count), key=lambda j: problem.tasks[j].angle)
    alone = [problem.alone(j) for j in range(count)]
    done = 0

    def told(w: np.ndarray) -> np.ndarray:
        nonlocal done
        done += 1
        progress("trying what the body can do", done / count)
        return w

    progress("trying what the body can do", 0.0)
    found: dict[int, np.ndarray] = {}
    with ThreadPoolExecutor(_THREADS) as pool:  # CasADi lets other threads run meanwhile
        if problem.dynamics.world.walks:
            chance = [[one.random_gait(rng) for _ in range(_STEPPERS)] for one in alone]
            steps = [[*stepping_gaits(one), *more] for one, more in zip(alone, chance, strict=True)]
            found = dict(enumerate(map(told, pool.map(_walking, alone, steps))))
        else:
            first, *others = order
            starts = [alone[first].random_gait(rng) for _ in range(_STARTS)]
            straight = found[first] = told(_swimming(alone[first], starts, True, pool))
            bent = [
                [straight, *(bent_gaits(alone[j], straight) if alone[j].tasks[0].angle else ())]
                for j in others
            ]
            ends = pool.map(_swimming, [alone[j] for j in others], bent)
            found |= dict(zip(others, map(told, ends), strict=True))
    parts = [alone[j].split(found[j]) for j in range(count)]
    mu = parts[order[0]][0]
    w = problem.join(mu, *(np.concatenate([part[i] for part in parts]) for i in (1, 2)))
    return Tried(w, tuple(_measured(alone[j], found[j]) for j in range(count)))


def bent_gaits(alone: GaitProblem, w: np.ndarray) -> Iterator[np.ndarray]:
    """Yield a gait of one task whose last DMP element is a constant bend of one mode (beta = 0), as unknowns."""
    mu, alpha, beta = alone.split(w)
    for mode in range(alone.dynamics.nu):
        for bend in 0.5 * np.array([-1, -0.6, -0.3, 0.3, 0.6, 1]):
            a, b = alpha.copy(), beta.copy()
            a[0, -1, mode] += bend * alone.dynamics.body.amplitude[mode]
            b[0, -1] = 0
            yield alone.join(mu, a, b)


def _swimming(
    alone: GaitProblem,
    starts: list[np.ndarray],
    first: bool = False,
    pool: ThreadPoolExecutor | None = None,
) -> np.ndarray:
    """Return the best w after a few iterations from the best start.

    Args:
        first: before that a few from each of them; of the others the phases stay what they are.
    """
    descent = _Descent(alone, _CYCLES, _SETTLE, phases=first)
    few, many = _ITERATIONS
    if first:
        each = map if pool is None else pool.map
        tried = list(each(lambda w: descent.improve(w, few), starts))
    else:
        tried = [(descent.value(w)[0], w) for w in starts]
    return descent.improve(min(tried, key=lambda pair: pair[0])[1], many)[1]


def _walking(alone: GaitProblem, starts: list[np.ndarray]) -> np.ndarray:
    """Return the best w after a few iterations from the best starts and more from the best of these."""
    descent = _Descent(alone, _WALKED, _WALK_SETTLE, phases=False, sharp=_SHARP)
    few, many = _WALK_ITERATIONS
    promising = sorted(((descent.cost(w), w) for w in starts), key=lambda pair: pair[0])[:_TRIED]
    tried = [descent.improve(w, few) for _, w in promising]
    return descent.improve(min(tried, key=lambda pair: pair[0])[1], many)[1]


class _Descent:
    """L-BFGS-B on what cycles of one task cost, with a penalty for target shapes beyond the amplitude.

    Args:
        cycles, settle: of the trajectory, and how many of them do not count.
        phases: these may change, too.
        sharp: scale of beta.
    """

    def __init__(
        self, alone: GaitProblem, cycles: int, settle: int, phases: bool, sharp: float = 1.0
    ) -> None:
        w = ca.MX.sym("w", alone.n_w)
        cost = alone.objective([[0] * cycles], settle=settle)(w) + _OUTSIDE * alone.excess(w)
        self._cost = ca.Function("trial", [w], [cost])
        self._both = ca.Function("trial", [w], [cost, ca.gradient(cost, w)])
        shares = alone.n_phases
        self._held = np.arange(alone.n_w) < (0 if phases else shares)
        self._bound = np.where(np.arange(alone.n_w) < shares, np.inf, _BOUND)
        self._scale = np.where(np.arange(alone.n_w) < 2 * shares, 1.0, sharp)

    def cost(self, w: np.ndarray) -> float:
        """Return what w (n_w,) costs."""
        try:
            return float(self._cost(w))
        except RuntimeError:  # a step was not solved: not that far
            return _UNSOLVED

    def value(self, w: np.ndarray) -> tuple[float, np.ndarray]:
        """Return what w (n_w,) costs, and the gradient."""
        try:
            cost, slope = self._both(w)
        except RuntimeError:
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
        found = minimize(
            scaled, w / scale, jac=True, method="L-BFGS-B", bounds=limits, options=options
        )
        return float(found.fun), scale * found.x


def _measured(alone: GaitProblem, w: np.ndarray) -> Trial:
    """Return the mean of the cycles after the first ones; nothing if they cannot be rolled out, or all fall."""
    task = alone.tasks[0]
    try:
        cycles = measure_cycles(alone, alone.gait(w, {}), np.zeros(_CYCLES, int))
    except DefplanError:
        return Trial(0.0, 0.0)
    counted = cycles.counted
    if not counted.any():
        return Trial(0.0, 0.0)
    sign = np.sign(task.turn[2]) if alone.place.level else 1.0
    return Trial(float(cycles.advance[counted].mean()), float(sign * cycles.angle[counted].mean()))
