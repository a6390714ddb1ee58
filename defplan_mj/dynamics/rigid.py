"""f_fit as dynamics: one step is one decision, the control is the gait, the body is rigid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError

if TYPE_CHECKING:
    from defplan_mj.planning.surrogate import Surrogate


class RigidDynamics:
    """f_fit: (c, R) becomes (c + R t_ij, R R_ij) under gait j after past i (paper, section IV-B).

    A state is (7,): position (3, m) and unit quaternion w x y z, as in the reduced state's first
    seven entries.
    """

    nx, nu = 7, 1

    def __init__(self, surrogate: Surrogate) -> None:
        self.surrogate = surrogate
        self._motions = surrogate.switched_motions("spatial")

    @property
    def timestep(self) -> float:
        """Duration of a cycle, or of the part of it that a decision plays, s."""
        return self.surrogate.decision_seconds

    def rest_state(self) -> np.ndarray:
        """Return the state at the origin, (7,)."""
        return np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])

    def step(self, x: np.ndarray, gait: int, before: int | None = None) -> np.ndarray:
        """Return the state (7,) one decision for `gait` after `x` (7 or more; the rest is not used).

        Args:
            before: the past (`planning.past`), the gait of the cycle before if there is one decision in a
                cycle; None: the body was at rest.

        Raises:
            DefplanError: there is no such gait.
        """
        if not 0 <= gait < len(self.surrogate.task_names):
            names = ", ".join(self.surrogate.task_names)
            raise DefplanError(f"there is no gait {gait}; the surrogate has {names}")
        motion = self._motions.of((self.surrogate.rest if before is None else before, gait))
        attitude = rotations.rotation(x[3:7])
        centre = x[:3] + attitude.apply(motion.translations)
        turned = attitude * rotations.of_matrix(motion.rotations)
        return np.concatenate([centre, rotations.wxyz(turned, positive=True)])

    def rollout(self, x0: np.ndarray, gaits: np.ndarray) -> np.ndarray:
        """Return the states (N + 1, 7) from `x0`, at rest, under the gaits (N,)."""
        states, before = [np.asarray(x0, float)[:7]], self.surrogate.rest
        for gait in map(int, gaits):
            states.append(self.step(states[-1], gait, before))
            before = int(self.surrogate.past.then[before, gait])
        return np.array(states)
