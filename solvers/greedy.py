"""Planner `greedy`: the gait that comes nearest to the target and hits nothing the laser sees."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.observation import laser_points
from defplan_mj.planning.planner import Observation
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.untrained import UntrainedSolver

FAR = 100.0  # what a hit costs, m: more than any gait gains


class GreedyPlanner:
    """Looks one cycle ahead: the least a planner can do."""

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.motions, self.radius = surrogate.planar(), surrogate.radius
        self.laser_range = navigation.laser_range
        self.tree = MotionTree(self.motions, 1)

    def reset(self) -> None:
        """Do nothing: the planner has no memory."""

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the distance and the turn that are left, less 100 m for a hit."""
        offset = observation["target"][:2] - self.motions[:, :2]
        bearing = np.arctan2(offset[:, 1], offset[:, 0]) - self.motions[:, 2]
        turn = np.abs((bearing + np.pi) % (2 * np.pi) - np.pi)
        # A radian is worth the way of a cycle: else a robot that faces away never turns round.
        advance = np.hypot(*self.motions[:, :2].T).max()
        values = -np.hypot(*offset.T) - advance * turn
        points = laser_points(observation["laser"], self.laser_range)
        if len(points):
            _, _, way = self.tree.distances2(points)
            values = values - FAR * (way < self.radius**2).any(0)
        return values


SOLVER = UntrainedSolver(
    "greedy",
    "one cycle of lookahead towards the target; nothing to train",
    GreedyPlanner,
)
