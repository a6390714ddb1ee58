"""Feedback `ilqg`: iterative LQG around the DMP's output, over a short horizon (paper, section IV-A).

Every step minimises E_obj + E_dmp over the next steps. E_dmp is what the target shapes are off from the DMP,
E_obj what the body is off from the gait's mean cycle (`following`).

Five steps see less than a quarter of a cycle: too little to know that a lean ends in a fall. So the last
step is weighed with the cost of going on along the cycle for ever, from the periodic Riccati equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from defplan_mj.base.space import PLANE
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_solvers.feedback.following import Follower, Weights
from defplan_solvers.feedback.ilqg_step import Cost, Guide, optimise


@dataclass(frozen=True)
class Options(Weights):
    """What is weighed, how far ahead, and how hard.

    Attributes:
        horizon: steps.
        iterations: of a decision.
    """

    horizon: int = 5
    iterations: int = 1


class BodyModel:
    """The reduced dynamics for `optimise`: changes of state are tangent coordinates."""

    def __init__(self, dynamics: ReducedDynamics) -> None:
        self.dynamics = dynamics

    def step(
        self, x: np.ndarray, u: np.ndarray, near: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Return the next state (nx,), which may be guessed to be `near`; None if the solve failed."""
        after, info = self.dynamics.step_info(x, u, near)
        return None if info.failed else after

    def jacobian(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the step's exact derivatives in tangent coordinates."""
        return tangent.step_jacobian(x, x_next, *self.dynamics.step_jacobian(x, u, x_next))

    def difference(self, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return the changes (..., n_z) from `origin` to `x`."""
        return tangent.difference(x, origin)

    def difference_jacobian(self, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return (..., n_z, n_z), 1 but for the rotation."""
        block = tangent.difference_jacobian(x, origin)
        out = np.broadcast_to(np.eye(x.shape[-1] - 1), (*block.shape[:-2], *[x.shape[-1] - 1] * 2))
        out = out.copy()
        out[..., 3:6, 3:6] = block
        return out

    def changed(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the state (nx,) after the change `z` (n_z,)."""
        return tangent.retract(x, z)


class Ilqg:
    """Follows the gait's mean cycles by iterative LQG.

    Attributes:
        follower: of the mean cycles.
        costs: of the last decision: before the first iteration and after each.
    """

    def __init__(
        self,
        dynamics: ReducedDynamics,
        gait: Gait,
        space: str = PLANE.name,
        options: Options = Options(),
    ) -> None:
        self.model, self.options = BodyModel(dynamics), options
        self.follower = Follower(dynamics, gait, space, options, options.horizon)
        self.reset()

    def reset(self) -> None:
        """Forget the frame that is followed and the last plan."""
        self.follower.reset()
        self.costs: tuple[float, ...] = ()
        self._guide: Guide | None = None
        self._more = np.zeros((self.options.horizon, len(self.follower.bound)))

    def begin(self, task: int, x: np.ndarray, first: int = 0) -> None:
        """Begin a cycle of gait `task` in the state x (nx,).

        Raises:
            DefplanError: it is to be entered within, at the step `first`.
        """
        self.follower.begin(task, x, first)
        self._guide = None  # it is told from the old frame

    def shape(self, x: np.ndarray) -> np.ndarray:
        """Return the first target shape (r,) of the best plan from `x` over the horizon."""
        follower, ahead = self.follower, self.options.horizon
        here, track, i = follower.inside(x), follower.track, follower.step
        follower.step += 1
        weights = track.weights[i + 1 : i + 1 + ahead].copy()
        weights[-1] = track.onward[i + ahead]
        reference = track.controls[i : i + ahead]
        cost = Cost(track.states[i + 1 : i + 1 + ahead], weights, reference, follower.effort)
        start = reference + self._more
        plan = optimise(
            *(self.model, cost, here, start, follower.bound, self.options.iterations, self._guide)
        )
        self.costs = plan.costs
        self._more[:-1] = (plan.controls - reference)[1:]
        self._more[-1] = 0.0
        self._guide = plan.guide
        return plan.controls[0]


@dataclass(frozen=True)
class IlqgSolver:
    """The plugin."""

    options: Options = Options()
    kind: ClassVar = "feedback"
    name: ClassVar = "ilqg"
    summary: ClassVar = (
        "iterative LQG over 5 steps: follows the gait's mean cycle, near the DMP's output"
    )

    def prepare(self, dynamics: ReducedDynamics, gait: Gait, space: str = PLANE.name) -> Ilqg:
        """Return the feedback of a gait: finds its mean cycles and their costs of going on."""
        return Ilqg(dynamics, gait, space, self.options)


SOLVER = IlqgSolver()
