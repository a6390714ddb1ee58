"""Short trials of what a body can do, before its gaits are optimised: what to want of them."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.descent import THREADS, Descent
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.stepping import walking
from defplan_mj.gait.switching import measure_cycles
from defplan_mj.task import GaitTask

ADVANCE, BENT_ADVANCE, STEP, BENT_STEP = 0.5, 0.3, 0.2, 0.1
"""What a trial is asked for, in body lengths a cycle: of a swimmer, of one that turns, of a walker likewise."""
TURN, TILT, STEP_TURN = 0.6, 0.45, 0.4
"""Likewise, rad: in the plane, in space, of a walker."""
_CYCLES, _SETTLE = 6, 2
_STARTS = 3  # of the straight task
_ITERATIONS = (15, 50)  # of each start, and of the best of them


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
        w: (n_w,) the gaits of all tasks, with the phases mu in common: a start.
        trials: what each of them does.
    """

    w: np.ndarray
    trials: tuple[Trial, ...]


_LAST: dict[tuple, Tried] = {}
"""What was tried last: who guesses a task of a mesh optimises its gaits next."""


def try_tasks(problem: GaitProblem, seed: int = 0, progress: Progress = no_progress) -> Tried:
    """Return what a few iterations of L-BFGS-B make of the tasks, asked for much (`asking_much`).

    A swimmer's straightest task is tried from random gaits, and the others from what that came to, bent, in its
    phases; a walker's from gaits that step, each alone and then all while they are switched
    (`gait.stepping`). It is the problem's own objective, with a penalty for target shapes beyond the body's
    amplitude.

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
        turn = STEP_TURN if walks else TURN if problem.place.level else TILT
        straight, bent = (STEP, BENT_STEP) if walks else (ADVANCE, BENT_ADVANCE)
        advance = length * (bent if task.angle else straight)
        sizes = turn * bool(task.angle), advance * bool(task.advance)
        ways = (size * np.array(way) for size, way in zip(sizes, _ways(task), strict=True))
        turned, moved = (tuple(np.round(way, 9).tolist()) for way in ways)
        tasks.append(replace(task, turn=turned, move=moved))
    return problem.of_tasks(tasks)


def _ways(task: GaitTask) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis of a task's turn and the direction of its way."""
    return np.array(task.turn) / (task.angle or 1.0), np.array(task.move) / (task.advance or 1.0)


def _try_tasks(problem: GaitProblem, seed: int, progress: Progress) -> Tried:
    count = problem.n_tasks
    progress("trying what the body can do", 0.0)
    together = walking if problem.dynamics.world.walks else _together
    w = together(problem, seed, progress)
    mu, alpha, beta = problem.split(w)
    alone = [problem.alone(j) for j in range(count)]
    own = [one.join(mu, alpha[[j]], beta[[j]]) for j, one in enumerate(alone)]
    return Tried(w, tuple(_measured(*pair) for pair in zip(alone, own, strict=True)))


def _together(problem: GaitProblem, seed: int, progress: Progress) -> np.ndarray:
    """Return w (n_w,) of a swimmer's gaits, each tried alone, in the phases of the straightest."""
    rng, count = np.random.default_rng(seed), problem.n_tasks
    first, *others = sorted(range(count), key=lambda j: problem.tasks[j].angle)
    alone = [problem.alone(j) for j in range(count)]
    with ThreadPoolExecutor(THREADS) as pool:  # CasADi lets other threads run meanwhile
        starts = [alone[first].random_gait(rng) for _ in range(_STARTS)]
        straight = _swimming(alone[first], starts, True, pool)
        progress("trying what the body can do", 1 / count)
        chosen = {first: straight}
        bent = [
            [straight, *(bent_gaits(alone[j], straight) if alone[j].tasks[0].angle else ())]
            for j in others
        ]
        ends = pool.map(_swimming, [alone[j] for j in others], bent)
        for done, (j, w) in enumerate(zip(others, ends, strict=True), start=2):
            chosen[j] = w
            progress("trying what the body can do", done / count)
    return problem.together([chosen[j] for j in range(count)], first)


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
    descent = Descent(alone, [[0] * _CYCLES], _SETTLE, phases=first)
    few, many = _ITERATIONS
    if first:
        each = map if pool is None else pool.map
        tried = list(each(lambda w: descent.improve(w, few), starts))
    else:
        tried = [(descent.value(w)[0], w) for w in starts]
    return descent.improve(min(tried, key=lambda pair: pair[0])[1], many)[1]


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
