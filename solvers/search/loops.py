"""A way out of loops and dead ends, for planners that decide by the present observation alone."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.odometry import Odometry
from defplan_mj.planning.planner import Observation, carried_out
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.search.outlook import Outlook

VISIT = 3.0
"""What it costs a gait to lead to where the robot was before, for each time, in values of a cycle."""
SAME = 0.8
"""Poses so many cycles apart count 1/e as the same."""


class LoopBreaker:
    """Lowers the values of gaits that lead back to where the robot was.

    A planner without memory that comes back to what it saw does the same again, for ever: in a dead
    end it steps back and forth. Here every visit makes a place less attractive, so that a dead end
    is filled up until the way out is the best that is left (the idea of learning real-time A*,
    Korf 1990). The robot keeps track of its places by `Odometry`.

    How far two poses are apart is measured in cycles, as by `Outlook`: their distance at full
    advance, and the turn between their headings by what turns cost this robot: nothing for one that
    walks to every side alike, much for one that turns in its place. A gait leads to where it is after a
    whole cycle, even if another one may be chosen before.

    Args:
        surrogate: f_fit.
        navigation: for the space.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.odometry = Odometry(surrogate, navigation)
        # of m decisions a cycle each is charged, and what it chooses is worth 1 / m of what a cycle's does
        self.visit = VISIT / surrogate.decisions_per_cycle**2
        self.outlook = Outlook(surrogate.cycle_motions(navigation.space), navigation.goal_radius)
        self.heading = self.outlook.axes_at[:, 0]  # at each phase
        turns, self.ends = surrogate.kept_motions(navigation.space)
        self.headings, phases = np.empty_like(self.ends), surrogate.past.phase
        for phase, heading in enumerate(self.heading):
            self.headings[phases == phase] = turns[phases == phase] @ heading
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self.odometry.reset()
        self._places = np.zeros((0, self.heading.shape[1]))  # in the robot's present frame
        self._headings = self._places
        self._phases = np.zeros(0, int)

    def adjust(
        self, values: np.ndarray, target: np.ndarray, observation: Observation
    ) -> np.ndarray:
        """Return the values (K,) lowered for gaits that lead back; take note of what is done.

        Args:
            values: in units of what a cycle of full advance is worth.
            target: (d,) m, in the robot's frame.
            observation: of the planner.
        """
        motion = self.odometry.moved(target)
        if motion is not None:
            shift, turn = motion
            self._places = (self._places - shift) @ turn
            self._headings = self._headings @ turn
        self._places = np.vstack([self._places, np.zeros_like(target)])
        past, phase = self.odometry.past, self.odometry.phase
        self._headings = np.vstack([self._headings, self.heading[phase]])
        self._phases = np.append(self._phases, phase)
        ends, headings = self.ends[past], self.headings[past]
        # a robot in another part of its cycle is not the same, wherever it is
        same = self._phases == phase
        away = np.linalg.norm(ends[:, None] - self._places[same], axis=2) / self.outlook.advance
        turned = np.arccos(np.clip(headings @ self._headings[same].T, -1, 1))
        apart = away + self.outlook.per_radian * turned
        values = values - self.visit * np.exp(-((apart / SAME) ** 2)).sum(1)
        self.odometry.chose(carried_out(values, observation))
        return values
