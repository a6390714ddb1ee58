"""Planner `foresight`: A* in place and time among the obstacles that the robot sees and follows itself."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.planner import Observation, carried_out
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.tracking import Tracker
from defplan_mj.task import Navigation
from defplan_solvers.search.space_time import SpaceTime
from defplan_solvers.search.untrained import UntrainedSolver

MARGINS = (0.4, 0.25, 0.1, 0.0)
"""Kept from obstacles, one after the other until there is a way, m."""


class ForesightPlanner:
    """What `oracle` does, with obstacles as a tracker knows them: replanned at every cycle.

    Points that belong to no ball are obstacles of their own, that stand still.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.search, self.d = SpaceTime(surrogate, navigation), navigation.dimension
        self.tracker = Tracker(surrogate, navigation)

    def reset(self) -> None:
        """Forget the episode."""
        self.tracker.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the way's first gait first."""
        target = observation["target"][: self.d]
        self.tracker.update(observation["laser"], target)
        before = self.tracker.odometry.past
        values = self.search.values(self.tracker.balls(), target, before, MARGINS)
        self.tracker.chose(carried_out(values, observation))
        return values


SOLVER = UntrainedSolver(
    "foresight",
    "A* in place and time among the obstacles that the laser sees and the robot follows",
    ForesightPlanner,
)
