"""Gaits that step: feet lifted in turn and swept back, by the modes that move them; trials of a walker.

A pattern gives each foot a phase. In its stance, the first half of its cycle, a foot is swept against the way
that the body is to go over it, to turn also; in its swing it is lifted and brought forward. Which target shapes
do that is a least-squares problem in the modes' linear motion of the feet, and which unknowns of the DMP make
these shapes is another one.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.dynamics.feet import Feet, lowest_feet
from defplan_mj.gait.descent import THREADS, Descent
from defplan_mj.gait.gait import dmp
from defplan_mj.gait.problem import GaitProblem

SOLES = 0.06  # of the height: what is as low is feet
MOST_FEET = 16
SHARES = (0.45, 0.9)  # of the amplitude that the largest target shape takes
LIFT = 0.5  # of a foot, in units of the longest sweep
_RIDGE = 0.05  # of the largest singular value of the feet's motion: less is no way to move a foot
_SHARPNESS = 1.0  # beta of each element
_CHANCE = 8  # random gaits, for a body without feet
_ALONE = 3  # cycles of a task alone, the first of which does not count
_ITERATIONS = (10, 30)  # of each start of a task alone, and of the best of them
_TOGETHER = 20  # iterations of all tasks together
_KEPT = 3  # starts that go on
_SHARP = 0.15  # scale of beta


def walking(problem: GaitProblem, seed: int, progress: Progress = no_progress) -> np.ndarray:
    """Return w (n_w,) of gaits that are switched.

    Each task alone first: all gaits that step are optimised for some iterations, the best of them for more.
    Then all tasks together over all pairs of them, one after the other, so that each can follow each other.
    Phases stay what they are, which is the same in all gaits that step.
    """
    rng, tasks = np.random.default_rng(seed), range(problem.n_tasks)
    alone: list[np.ndarray] = []
    for j in tasks:
        alone.append(_alone(problem.alone(j), seed, rng))
        progress("trying what the body can do", len(alone) / (problem.n_tasks + 1))
    w = problem.together(alone)
    pairs = [[i, j] for i in tasks for j in tasks]
    return _descent(problem, pairs, 0, THREADS).improve(w, _TOGETHER)[1]


def _alone(alone: GaitProblem, seed: int, rng: np.random.Generator) -> np.ndarray:
    """Return w of the best gait found for one task."""
    starts = list(stepping_gaits(alone)) or [alone.random_gait(rng) for _ in range(_CHANCE)]
    if seed:  # another seed is another start
        starts = [w + 0.1 * _jitter(alone, rng) for w in starts]
    descent = _descent(alone, [[0] * _ALONE], 1, 1)
    with ThreadPoolExecutor(THREADS) as pool:  # CasADi lets other threads run meanwhile
        for iterations in _ITERATIONS:
            tried = list(pool.map(lambda w, most=iterations: descent.improve(w, most), starts))
            starts = [w for _, w in sorted(tried, key=lambda pair: pair[0])[:_KEPT]]
    return starts[0]


def _descent(
    problem: GaitProblem, sequences: list[list[int]], settle: int, threads: int
) -> Descent:
    return Descent(problem, sequences, settle, phases=False, sharp=_SHARP, threads=threads)


def _jitter(problem: GaitProblem, rng: np.random.Generator) -> np.ndarray:
    shape = (problem.n_tasks, problem.elements, problem.dynamics.nu)
    still = np.zeros((problem.elements, problem.dynamics.nu))
    return problem.join(still, rng.normal(0, 0.1, shape), np.zeros(shape))


def foot_phases(feet: np.ndarray) -> dict[str, np.ndarray]:
    """Return patterns: of each foot at (n, 2), x ahead and y left, the share of a cycle that it is behind.

    'trot': neighbours around the body by turns, of four feet the diagonals, of six two tripods; 'bound': those
    behind after those in front; 'pace': one side after the other; 'crawl': one foot after the other.
    """
    middle = feet - feet.mean(0)
    order = np.argsort(np.arctan2(middle[:, 1], middle[:, 0]), kind="stable")
    around = np.empty(len(feet))
    around[order] = np.arange(len(feet))
    return {
        "trot": 0.5 * (around % 2),
        "crawl": around / len(feet),
        "bound": 0.5 * (middle[:, 0] < 0),
        "pace": 0.5 * (middle[:, 1] < 0),
    }


def swept(phase: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Return where feet are (..., 3), m, at phases (...) of their own cycles.

    Args:
        ways: (..., 2) how far, and where to, the body goes over each foot in its stance, m.
    """
    phase = phase % 1.0
    along = np.where(phase < 0.5, 0.5 - 2 * phase, 2 * phase - 1.5)
    lifted = np.where(phase < 0.5, 0.0, LIFT * np.sin(2 * np.pi * (phase - 0.5)))
    most = np.linalg.norm(ways, axis=-1).max()
    return np.concatenate([along[..., None] * ways, most * lifted[..., None]], axis=-1)


def stepping_gaits(alone: GaitProblem) -> Iterator[np.ndarray]:
    """Yield gaits of one task that step where it wants to go and turn, as unknowns w (n_w,).

    Those of every task of a body come in the same order: pattern after pattern, each at `SHARES`. None if the
    body does not stand on two feet or more, or the task wants neither to go nor to turn.
    """
    body, task = alone.dynamics.body, alone.tasks[0]
    feet = lowest_feet(body, SOLES)
    if not 1 < len(feet) <= MOST_FEET:
        return
    where = np.array([body.vertices[foot].mean(0)[:2] for foot in feet.vertices])
    ways = np.array(task.move[:2]) + task.turn[2] * np.stack([-where[:, 1], where[:, 0]], axis=1)
    if not ways.any():
        return
    reach = foot_motion(alone, feet)
    steps = np.arange(1, alone.steps_per_cycle + 1) / alone.steps_per_cycle
    for phases in foot_phases(where).values():
        places = swept(steps[:, None] - phases, ways).reshape(len(steps), -1)  # (n, 3 feet)
        shapes = places @ reach.T
        for share in SHARES:
            yield as_gait(alone, shapes * (share / np.abs(shapes / body.amplitude).max()))


def foot_motion(problem: GaitProblem, feet: Feet) -> np.ndarray:
    """Return (r, 3 feet): the target shape that moves the feet by given ways, as nearly as the modes can."""
    modes = problem.dynamics.body.modes
    motion = np.concatenate([modes[foot].mean(0) for foot in feet.vertices])  # (3 feet, r)
    least = _RIDGE * np.linalg.norm(motion, ord=2)
    return np.linalg.solve(motion.T @ motion + least**2 * np.eye(motion.shape[1]), motion.T)


def as_gait(alone: GaitProblem, shapes: np.ndarray) -> np.ndarray:
    """Return w (n_w,) of the DMP of one task that is nearest to shapes (n, r), its phases spread evenly."""
    d, r, n = alone.elements, alone.dynamics.nu, len(shapes)
    mu, beta = 2 * np.pi * np.arange(d) / d, np.full((d, 1), _SHARPNESS)
    time = 2 * np.pi * np.arange(1, n + 1) / n
    bumps = [dmp(one[:, None], beta, mu[:, None], 1.0, time)[:, 0] for one in np.eye(d)]
    alpha = np.linalg.lstsq(np.array(bumps).T, shapes, rcond=None)[0]  # (d, r)
    return alone.join(np.repeat(mu[:, None], r, 1), alpha[None], np.full((1, d, r), _SHARPNESS))
