"""Feedback `lqr`: the linear regulator along the gait's mean cycle, whose gains are made once.

It follows what `ilqg` follows and weighs what it weighs, but linearises about the mean cycle and not about
where the body is: the periodic Riccati equation gives a gain for each step of each gait beforehand, and a decision
is a product of a matrix and a vector. Target shapes are clipped to the gait's amplitude, of which the gains do not
know.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from defplan_mj.base.space import PLANE
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.mean_cycle import MeanCycle
from defplan_solvers.feedback.following import Follower, Track, Weights


def gains(cycle: MeanCycle, track: Track, effort: np.ndarray) -> np.ndarray:
    """Return (n, r, n_z): u_i - DMP(i) = -K_i (x_i - x*_i) costs the least from each step of a cycle on.

    K_i = (E + B_i' V B_i)^-1 B_i' V A_i with V the cost of going on from the next step.

    Args:
        effort: (r,) weights of the controls, E.
    """
    out = np.empty((len(cycle.b), cycle.b.shape[2], cycle.a.shape[1]))
    for i, (a, b) in enumerate(zip(cycle.a, cycle.b, strict=True)):
        through = b.T @ track.onward[i + 1]
        out[i] = np.linalg.solve(np.diag(effort) + through @ b, through @ a)
    return out


_WEIGHTS = Weights(effort=10.0)
"""Gains that ask for more are right near the cycle only: with an effort of 1, that of `ilqg`, a walker which is
pushed, or whose feet slip, falls more often than in open loop."""


class Lqr:
    """Follows the gait's mean cycles by gains that were made before.

    Attributes:
        follower: of the mean cycles.
        gains: (K) one a gait, see `gains`.
    """

    def __init__(
        self,
        dynamics: ReducedDynamics,
        gait: Gait,
        space: str = PLANE.name,
        weigh: Weights = _WEIGHTS,
    ) -> None:
        self.follower = Follower(dynamics, gait, space, weigh, ahead=0)
        pairs = zip(self.follower.cycles, self.follower.tracks, strict=True)
        self.gains = [gains(cycle, track, self.follower.effort) for cycle, track in pairs]

    def reset(self) -> None:
        """Forget the frame that is followed."""
        self.follower.reset()

    def begin(self, task: int, x: np.ndarray, first: int = 0) -> None:
        """Begin a cycle of gait `task` in the state x (nx,).

        Raises:
            DefplanError: it is to be entered within, at the step `first`.
        """
        self.follower.begin(task, x, first)

    def shape(self, x: np.ndarray) -> np.ndarray:
        """Return the next target shape (r,), within the gait's amplitude."""
        follower = self.follower
        track, i = follower.track, follower.step
        off = tangent.difference(follower.inside(x), track.states[i])
        follower.step += 1
        shape = track.controls[i] - self.gains[follower.task][i] @ off
        return np.clip(shape, -follower.bound, follower.bound)


@dataclass(frozen=True)
class LqrSolver:
    """The plugin."""

    weigh: Weights = _WEIGHTS
    kind: ClassVar = "feedback"
    name: ClassVar = "lqr"
    quick: ClassVar = True
    summary: ClassVar = (
        "linear gains along the gait's mean cycle, made once: the cheap relative of ilqg"
    )

    def prepare(self, dynamics: ReducedDynamics, gait: Gait, space: str = PLANE.name) -> Lqr:
        """Return the feedback of a gait: finds its mean cycles and their gains."""
        return Lqr(dynamics, gait, space, self.weigh)


SOLVER = LqrSolver()
