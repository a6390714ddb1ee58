"""Feedback: what turns the gait that is played and the state the body is in into the next target shape."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from defplan_mj.base.space import PLANE
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait


class Feedback(Protocol):
    """Plays the gaits of one body, cycle by cycle; keeps what it needs from one step to the next."""

    def reset(self) -> None:
        """Forget what was before: the body is put somewhere else."""

    def begin(self, task: int, x: np.ndarray, first: int = 0) -> None:
        """Begin a cycle of gait `task` at the state `x` (nx,).

        Args:
            first: the step of the cycle that comes next, if it is to be entered within: the gaits share their
                phases. With one decision a cycle it is never given.
        """

    def shape(self, x: np.ndarray) -> np.ndarray:
        """Return the target shape (r,) of the cycle's next step, from the state `x` (nx,)."""


class FeedbackSolver(Protocol):
    """A feedback plugin: `kind` is 'feedback', `name` and `summary` are what `defplan list` shows.

    It is picklable, and its repr tells it from one with other options.
    """

    @property
    def kind(self) -> str:
        """'feedback'."""

    @property
    def name(self) -> str:
        """What it is asked for by."""

    @property
    def summary(self) -> str:
        """One line."""

    def prepare(self, dynamics: ReducedDynamics, gait: Gait, space: str = PLANE.name) -> Feedback:
        """Return the feedback for a gait of a body.

        Args:
            dynamics: the model the feedback has of the body, at the gait's time step.
            space: 'planar' or 'spatial', see `task.Navigation`.
        """


class OpenLoop:
    """Plays the gait's table, whatever the state."""

    def __init__(self, gait: Gait) -> None:
        self._table = gait.table()
        self._task = self._next = 0

    def reset(self) -> None:
        """Begin with the first gait."""
        self._task = self._next = 0

    def begin(self, task: int, x: np.ndarray, first: int = 0) -> None:
        """Begin a cycle of gait `task` in the state x (nx,), at its step `first`."""
        self._task, self._next = task, first

    def shape(self, x: np.ndarray) -> np.ndarray:
        """Return the next entry of the gait's table (r,)."""
        self._next += 1
        return self._table[self._task, self._next - 1]


class Recorded:
    """Plays target shapes (n, r) that were chosen before, whatever gait and state."""

    def __init__(self, shapes: np.ndarray) -> None:
        self._shapes, self._next = shapes, 0

    def reset(self) -> None:
        """Begin again."""
        self._next = 0

    def begin(self, task: int, x: np.ndarray, first: int = 0) -> None:
        """Go on with the shapes that follow, whatever the gait, the state (nx,) and the step."""

    def shape(self, x: np.ndarray) -> np.ndarray:
        """Return the next target shape (r,)."""
        self._next += 1
        return self._shapes[self._next - 1]


def drive(
    dynamics: ReducedDynamics,
    feedback: Feedback,
    tasks: Sequence[int],
    steps_per_cycle: int,
    x: np.ndarray,
    disturb: Callable[[int, np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Let a feedback play cycles of gaits, one after the other.

    Args:
        dynamics: of the body as it really is.
        tasks: the gait of each cycle.
        x: (nx,) the state to begin at.
        disturb: called with the number of the step to come and the state; returns the state that
            the step begins at, for example after a push.

    Returns:
        States (N + 1, nx), as the steps left them, and target shapes (N, r).
    """
    states = [x]
    shapes: list[np.ndarray] = []
    for task in tasks:
        for i in range(steps_per_cycle):
            if disturb is not None:
                x = disturb(len(shapes), x)
            if i == 0:
                feedback.begin(int(task), x)
            shapes.append(feedback.shape(x))
            x = dynamics.step(x, shapes[-1])
            states.append(x)
    return np.array(states), np.array(shapes)
