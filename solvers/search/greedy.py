"""Planner `greedy`: the gait that comes nearest to the target and hits nothing the laser sees."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.planner import Observation
from defplan_mj.planning.sensors.sensor import seen_points
from defplan_mj.planning.surrogate import Surrogate, check_decisions
from defplan_mj.task import Navigation
from defplan_solvers.search.outlook import Outlook
from defplan_solvers.search.untrained import UntrainedSolver

FAR = 100.0  # what a hit costs, cycles: more than any gait gains


class GreedyPlanner:
    """Looks one gait cycle ahead: the least a planner can do."""

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        check_decisions(surrogate, navigation)
        motions = surrogate.cycle_motions(navigation.space)
        self.navigation, self.radius = navigation, surrogate.radius
        self.outlook = Outlook(motions, navigation.goal_radius)
        self.trees = [
            MotionTree(motions.of(phase), (1,)) for phase in range(surrogate.decisions_per_cycle)
        ]
        self.reset()

    def reset(self) -> None:
        """Begin a cycle: more the planner does not remember."""
        self._phase = 0

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, less 100 for a hit."""
        target = observation["target"][: self.navigation.dimension]
        values = -self.outlook.after_each(target, self._phase)
        points = seen_points(observation["laser"], self.navigation)
        if len(points):
            _, _, way = self.trees[self._phase].distances2(points)
            values = values - FAR * (way < self.radius**2).any(0)
        self._phase = (self._phase + 1) % len(self.trees)
        return values


SOLVER = UntrainedSolver(
    "greedy",
    "one cycle of lookahead towards the target; nothing to train",
    GreedyPlanner,
)
