"""f_fit as dynamics: one step is one gait cycle, the control is the gait, the body is rigid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError

if TYPE_CHECKING:
    from defplan_mj.planning.surrogate import Surrogate


class RigidDynamics:
    """f_fit: (c, R) becomes (c + R t_j, R R_j) under gait j (paper, section IV-B).

    A state is (7,): position (3, m) and unit quaternion w x y z, as in the reduced state's first
    seven entries.
    """

    nx, nu = 7, 1

    def __init__(self, surrogate: Surrogate) -> None:
        self.surrogate = surrogate
        self._turns = rotations.of_matrix(surrogate.rotations)

    @property
    def timestep(self) -> float:
        """Duration of a cycle, s."""
        return self.surrogate.cycle_seconds

    def rest_state(self) -> np.ndarray:
        """Return the state at the origin, (7,)."""
        return np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])

    def step(self, x: np.ndarray, gait: int) -> np.ndarray:
        """Return the state (7,) one cycle of `gait` after `x` (7 or more; the rest is not used).

        Raises:
            DefplanError: there is no such gait.
        """
        if not 0 <= gait < len(self.surrogate.task_names):
            names = ", ".join(self.surrogate.task_names)
            raise DefplanError(f"there is no gait {gait}; the surrogate has {names}")
        attitude = rotations.rotation(x[3:7])
        centre = x[:3] + attitude.apply(self.surrogate.translations[gait])
        turned = attitude * self._turns[gait]
        return np.concatenate([centre, rotations.wxyz(turned, positive=True)])

    def rollout(self, x0: np.ndarray, gaits: np.ndarray) -> np.ndarray:
        """Return the states (N + 1, 7) from `x0` under the gaits (N,)."""
        states = [np.asarray(x0, float)[:7]]
        for gait in gaits:
            states.append(self.step(states[-1], int(gait)))
        return np.array(states)
