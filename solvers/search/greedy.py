"""Planner `greedy`: the gait that comes nearest to the target and hits nothing the laser sees."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.planner import Observation
from defplan_mj.planning.sensors.sensor import seen_points
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.search.outlook import Outlook
from defplan_solvers.search.untrained import UntrainedSolver

FAR = 100.0  # what a hit costs, cycles: more than any gait gains


class GreedyPlanner:
    """Looks one cycle ahead: the least a planner can do."""

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        motions = surrogate.motions(navigation.space)
        self.navigation, self.radius = navigation, surrogate.radius
        self.outlook = Outlook(motions, navigation.goal_radius)
        self.tree = MotionTree(motions, (1,))

    def reset(self) -> None:
        """Do nothing: the planner has no memory."""

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, less 100 for a hit."""
        target = observation["target"][: self.navigation.dimension]
        values = -self.outlook.after_each(target)
        points = seen_points(observation["laser"], self.navigation)
        if len(points):
            _, _, way = self.tree.distances2(points)
            values = values - FAR * (way < self.radius**2).any(0)
        return values


SOLVER = UntrainedSolver(
    "greedy",
    "one cycle of lookahead towards the target; nothing to train",
    GreedyPlanner,
)
