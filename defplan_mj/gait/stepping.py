"""Gaits that step: feet lifted in turn and swept back, by the modes that move them; starts for a walker.

A pattern gives each foot a phase. In its stance, the first half of its cycle, a foot is swept against the way that
is wanted; in its swing it is lifted and brought forward. Which target shapes do that is a least-squares problem
in the modes' linear motion of the feet, and which unknowns of the DMP make these shapes is another one.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from defplan_mj.dynamics.feet import Feet, lowest_feet
from defplan_mj.gait.gait import dmp
from defplan_mj.gait.problem import GaitProblem

SOLES = 0.06  # of the height: what is as low is feet
MOST_FEET = 16
SHARES = (0.45, 0.9)  # of the amplitude that the largest target shape takes
LIFT = 0.5  # of a foot, in units of what it is swept
_RIDGE = 0.05  # of the largest singular value of the feet's motion: less is no way to move a foot
_SHARPNESS = 1.0  # beta of each element


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


def swept(phase: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Return where feet are (..., 3) at phases (...) of their own cycles, in units of what they are swept.

    Args:
        heading: (2,) where the body is to go, a unit vector.
    """
    phase = phase % 1.0
    along = np.where(phase < 0.5, 0.5 - 2 * phase, 2 * phase - 1.5)
    lifted = np.where(phase < 0.5, 0.0, LIFT * np.sin(2 * np.pi * (phase - 0.5)))
    return np.concatenate([along[..., None] * heading, lifted[..., None]], axis=-1)


def stepping_gaits(alone: GaitProblem) -> Iterator[np.ndarray]:
    """Yield gaits of one task that step towards where it wants to go, as unknowns w (n_w,).

    None if the body does not stand on two feet or more, or the task wants to go nowhere.
    """
    body, heading = alone.dynamics.body, np.array(alone.tasks[0].direction[:2], float)
    feet = lowest_feet(body, SOLES)
    if not 1 < len(feet) <= MOST_FEET or not heading.any():
        return
    where = np.array([body.vertices[foot].mean(0)[:2] for foot in feet.vertices])
    reach = foot_motion(alone, feet)
    steps = np.arange(1, alone.steps_per_cycle + 1) / alone.steps_per_cycle
    for phases in foot_phases(where).values():
        wanted = swept(steps[:, None] - phases, heading).reshape(len(steps), -1)  # (n, 3 feet)
        shapes = wanted @ reach.T
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
