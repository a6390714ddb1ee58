"""The mean cycle of a gait while tasks are switched at random: what it does as it is used.

A cycle moves the body, so each is told from the frame at its start (`dynamics.tangent.Frame`) before the mean
is taken. The motion that repeats when one task is played for ever would be another choice, but the
first cycle after a switch is not on it, and it need not be stable or like anything that is seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.switching import roll_cycles, since_rest

CYCLES = 40  # of each task
SETTLE = 2  # cycles from rest that do not count


@dataclass(frozen=True)
class MeanCycle:
    """What a task's cycle does in the mean.

    Attributes:
        states: (n + 1, nx) told from the frame at the start.
        shapes: (n, r) target shapes, state i to i + 1.
        a, b: (n, n_z, n_z), (n, n_z, r) Jacobians of the steps from these states, in tangent coordinates.
        motion: of the frame over the cycle.
    """

    states: np.ndarray
    shapes: np.ndarray
    a: np.ndarray
    b: np.ndarray
    motion: Frame

    def unrolled(self, steps: int) -> np.ndarray:
        """Return the states (steps + 1, nx) of the cycle repeated, all told from the first frame."""
        n, frame, states = len(self.shapes), None, [self.states[0]]
        for i in range(1, steps + 1):
            state = self.states[(i - 1) % n + 1]
            states.append(state if frame is None else frame.outside(state))
            if i % n == 0:
                frame = self.motion if frame is None else frame.then(self.motion)
        return np.array(states)


def mean_cycles(
    dynamics: ReducedDynamics,
    gait: Gait,
    *,
    level: bool = True,
    depth: bool = True,
    cycles: int = CYCLES,
    seed: int = 0,
) -> tuple[MeanCycle, ...]:
    """Return the mean cycle of each task (K), from cycles that are switched at random in open loop.

    The first cycles from rest do not count, nor those in which a walker comes down, if there are others.

    Args:
        level, depth: what the dynamics does not notice: headings only or all attitudes; heights.
        cycles: of each task.
        seed: of the switching.
    """
    count, table = len(gait.task_names), gait.table()
    task = np.random.default_rng(seed).permutation(np.repeat(np.arange(count), cycles))
    states, down = roll_cycles(dynamics, table[task])
    counted = (since_rest(down) >= SETTLE) & ~down
    means = []
    for j, shapes in enumerate(table):
        mine = task == j
        chosen = next(c for c in (mine & counted, mine & ~down, mine) if c.any())
        relative = np.array([_relative(cycle, level, depth) for cycle in states[chosen]])
        means.append(_of(dynamics, shapes, relative, level, depth))
    return tuple(means)


def _relative(cycle: np.ndarray, level: bool, depth: bool) -> np.ndarray:
    """Return a cycle's states from the frame at its start, the quaternions of positive w."""
    frame = Frame.of(cycle[0], level, depth)
    relative = np.array([frame.inside(x) for x in cycle])
    relative[:, 3:7] *= np.where(relative[:, 3:4] < 0, -1, 1)
    return relative


def _of(
    dynamics: ReducedDynamics, shapes: np.ndarray, relative: np.ndarray, level: bool, depth: bool
) -> MeanCycle:
    """Return the mean of cycles (m, n + 1, nx)."""
    states = relative.mean(0)
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
    pairs = []
    for x, u in zip(states, shapes, strict=False):
        after = dynamics.step(x, u)
        pairs.append(tangent.step_jacobian(x, after, *dynamics.step_jacobian(x, u, after)))
    a, b = (np.array(parts) for parts in zip(*pairs, strict=True))
    return MeanCycle(states, shapes, a, b, Frame.of(states[-1], level, depth))


def turn_tangent(matrix: np.ndarray, n: int) -> np.ndarray:
    """Return (n, n): what turning the frame of reference does to changes of centre and velocity."""
    out, r = np.eye(n), (n - 12) // 3
    out[:3, :3] = matrix
    out[6 + r : 9 + r, 6 + r : 9 + r] = matrix
    return out
