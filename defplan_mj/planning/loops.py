"""A way out of loops, for planners that decide by the present observation alone."""

from __future__ import annotations

import numpy as np

SAME_DISTANCE = 0.25  # m
SAME_DIRECTION = 0.25  # rad
AGE = 4  # cycles; what is younger is the present stretch of way, not a return to it


class LoopBreaker:
    """Lowers the value of a gait that was chosen here before.

    A planner without memory that comes back to what it saw does the same again, for ever: fish that
    time out nearly always circle close to the target. 'Here' is where the target is seen at about
    the same distance and direction. Each time before costs half the spread of the values, so that the
    second choice gets its turn.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._past: list[tuple[float, np.ndarray, int]] = []  # distance, direction, gait

    def adjust(self, values: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the values (K,) lowered for gaits chosen here before; take note of the choice.

        Args:
            target: (d,) m, in the robot's frame.
        """
        distance = float(np.linalg.norm(target))
        direction = target / max(distance, 1e-9)
        values = np.array(values, float)
        if len(self._past) > AGE:
            distances, directions, gaits = map(np.array, zip(*self._past[:-AGE], strict=True))
            same = directions @ direction > np.cos(SAME_DIRECTION)
            here = same & (np.abs(distances - distance) < SAME_DISTANCE)
            times = np.bincount(gaits[here], minlength=len(values))
            values -= times * (0.5 * np.ptp(values) + 1e-6)
        self._past.append((distance, direction, int(values.argmax())))
        return values
