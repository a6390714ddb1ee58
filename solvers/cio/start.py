"""Where contact-invariant optimisation starts: a body that glides, on feet that take turns.

Without a pattern of the feet it does not find one: from rest it stays standing, and from even forces
it falls.
"""

from __future__ import annotations

import numpy as np

from defplan_mj.gait.problem import GaitProblem
from defplan_solvers.cio.model import Walker
from defplan_solvers.cio.newton import Iterate

PATTERNS: dict[str, tuple[tuple[float, ...], float]] = {
    "trot": ((0.0, 0.5, 0.5, 0.0), 0.55),
    "walk": ((0.0, 0.5, 0.75, 0.25), 0.75),
    "pace": ((0.0, 0.5, 0.0, 0.5), 0.55),
    "bound": ((0.0, 0.0, 0.5, 0.5), 0.55),
    "pronk": ((0.0, 0.0, 0.0, 0.0), 0.6),
}
"""Phase at which each foot touches down (front left, front right, hind left, hind right), and duty."""

_EDGE = 0.03  # of a cycle: how sharply a foot takes over
_STANDING = 4  # first steps on all feet


def foot_forces(
    walker: Walker, phases: np.ndarray, duty: float, cycle: int, steps: int
) -> np.ndarray:
    """Return forces (steps, 3F), in weights: upright, their sum the weight, on feet in turn.

    Args:
        phases: (F,) of touch-down, in cycles.
        duty: share of the cycle a foot is down.
        cycle: steps in a cycle.
    """
    phase = (np.arange(steps)[:, None] / cycle - phases) % 1.0
    down = 1 / (1 + np.exp(-np.minimum(phase, duty - phase) / _EDGE))
    down = down + 1e-3
    down = down * walker.carried
    down[:_STANDING] = walker.carried
    # a cycle without any foot down is flight: what it lacks, the feet make up for when they are down
    share = np.maximum(down.sum(1), 0.3)
    forces = np.zeros((steps, walker.n_feet, 3))
    forces[:, :, 2] = down / share[:, None]
    return forces.reshape(steps, -1)


def starts(
    walker: Walker,
    problem: GaitProblem,
    tasks: list[int],
    patterns: list[str],
    cycles: int,
    rng: np.random.Generator,
    motion: float = 0.06,
) -> Iterate:
    """Return a walk for each of the tasks and patterns, side by side.

    The body glides as its task wants, upright and in its shape at rest; phases of the DMP are spread
    evenly, as all tasks share them. A pattern that is not in PATTERNS, 'random', and a number of feet
    that it is not for take random phases.

    Args:
        motion: spread of alpha at the start.
    """
    n, steps = problem.steps_per_cycle, problem.steps_per_cycle * cycles
    d, r = problem.elements, walker.nu
    mu = np.repeat(2 * np.pi * np.arange(d)[:, None] / d, r, 1)
    states, forces, w = [], [], []
    for task, pattern in zip(tasks, patterns, strict=True):
        x = np.tile(walker.rest, (steps + 1, 1))
        goal = problem.tasks[task]
        x[:, :3] += np.arange(steps + 1)[:, None] / n * np.array(goal.move)
        x[1:, 7 + r : 10 + r] = np.array(goal.move) / (n * walker.timestep)
        phases, duty = PATTERNS.get(pattern, ((), 0.6))
        drawn = rng.uniform(
            0, 1, walker.n_feet
        )  # in any case, so that a pattern moves no other start
        touch = np.array(phases)[_corners(walker)] if walker.n_feet == len(phases) else drawn
        states.append(x)
        forces.append(foot_forces(walker, touch, duty, n, steps))
        alpha = motion * rng.normal(size=(1, d, r))
        w.append(np.concatenate([mu.ravel(), alpha.ravel(), np.ones(d * r)]))
    shapes = np.zeros((len(tasks), steps, r))
    return Iterate(np.array(states), np.array(forces), shapes, np.array(w))


def _corners(walker: Walker) -> np.ndarray:
    """Return which of front left, front right, hind left, hind right each of four feet is."""
    x, y, _ = np.array(walker.feet(walker.rest)).reshape(3, -1)
    return 2 * (x < x.mean()) + (y < y.mean())
