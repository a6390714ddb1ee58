"""A way out of loops, for planners that decide by the present observation alone."""

from __future__ import annotations

import numpy as np

SAME_DISTANCE = 0.25  # m
SAME_BEARING = 0.25  # rad
AGE = 4  # cycles; what is younger is the present stretch of way, not a return to it


class LoopBreaker:
    """Lowers the value of a gait that was chosen here before.

    A planner without memory that comes back to what it saw does the same again, for ever: fish that
    time out nearly always circle close to the target. 'Here' is where the target is seen at about
    the same distance and bearing. Each time before costs half the spread of the values, so that the
    second choice gets its turn.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._past: list[tuple[float, float, int]] = []  # distance, bearing, gait

    def adjust(self, values: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the values (K,) lowered for gaits chosen here before; take note of the choice.

        Args:
            target: (2 or 3,) m, in the body's yaw frame.
        """
        distance = float(np.hypot(target[0], target[1]))
        bearing = float(np.arctan2(target[1], target[0]))
        values = np.array(values, float)
        if len(self._past) > AGE:
            past = np.array(self._past[:-AGE])
            turn = np.abs((past[:, 1] - bearing + np.pi) % (2 * np.pi) - np.pi)
            here = (np.abs(past[:, 0] - distance) < SAME_DISTANCE) & (turn < SAME_BEARING)
            times = np.bincount(past[here, 2].astype(int), minlength=len(values))
            values -= times * (0.5 * np.ptp(values) + 1e-6)
        self._past.append((distance, bearing, int(values.argmax())))
        return values
