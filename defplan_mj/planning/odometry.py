"""How a robot that only knows its gaits and sees its target finds out how it moved."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.frames import turn_between
from defplan_mj.planning.surrogate import Surrogate, check_decisions
from defplan_mj.task import Navigation


class Odometry:
    """The motion of each decision, from its gait and from where the target is seen before and after.

    The robot does not know how it moved. It knows the gait it chose, which says the motion up to the
    surrogate's scatter, and it sees the target from before and after. Where the target is seen
    beside its expected place, the turn is corrected, and the displacement by what is left: the more
    to the turn, the farther away the target is (the most likely motion, if both errors are normal
    with the surrogate's deviations). Only a turn about the line to the target goes unnoticed, and
    that leaves what is on the way where it is.

    Args:
        surrogate: f_fit.
        navigation: for the space.

    Attributes:
        past: what came before the next decision (`planning.past`); the surrogate's `rest` at the start.

    Raises:
        DefplanError: the surrogate is of another number of decisions a cycle.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        check_decisions(surrogate, navigation)
        self.motions, self.pasts = surrogate.switched_motions(navigation.space), surrogate.past
        turn, way = surrogate.scatter()
        self.turn_variance, self.way_variance = turn**2, way**2
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._target: np.ndarray | None = None
        self.past = self.pasts.rest
        self._done: tuple[int, int] | None = None  # past and gait of the last decision

    def chose(self, gait: int) -> None:
        """Take note of the gait that is chosen now."""
        self._done = (self.past, gait)
        self.past = int(self.pasts.then[self._done])

    @property
    def phase(self) -> int:
        """The segment of the cycle that comes next."""
        return int(self.pasts.phase[self.past])

    def moved(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Take the target (d,) as seen now; return how the robot moved since the last one.

        Returns:
            Displacement (d,) and turn (d, d) in the frame then, x_old = displacement + turn x_new;
            None at the start.
        """
        before, self._target = self._target, target
        if before is None or self._done is None:
            return None
        switch = self._done
        turn, way = self.motions.of(switch)
        expected = turn @ target  # from the robot's new place, as seen in its old frame
        seen = before - way
        distance2 = float(expected @ expected)
        leeway = self.turn_variance[switch] * distance2
        share = leeway / max(leeway + self.way_variance[switch], 1e-12)
        turn = turn_between(expected, expected + share * (seen - expected)) @ turn
        return before - turn @ target, turn
