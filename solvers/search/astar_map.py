"""Planner `astar-map`: A* over the gaits with the full map and true positions: a bound for static scenes."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.planner import Observation
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.search.astar import MARGINS, search
from defplan_solvers.search.full_map import surface_points, told_obstacles
from defplan_solvers.search.manoeuvres import Manoeuvres
from defplan_solvers.search.outlook import Outlook
from defplan_solvers.search.untrained import UntrainedSolver

NAME = "astar-map"
HORIZON = 14.0  # a plan that gets this far is good enough: more of the map changes no first gait, m
SPACING = 0.4  # of the points that stand for an obstacle's surface, m


class AstarMapPlanner:
    """Replans at every cycle among all obstacles, from where the robot truly is."""

    needs_obstacles = True

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        motions = surrogate.motions(navigation.space)
        self.radius, self.dimension = surrogate.radius, navigation.dimension
        self.outlook = Outlook(motions, navigation.goal_radius)
        self.steps = Manoeuvres(motions, self.outlook.axes[0])
        self.shield = Shield(self, surrogate, navigation)  # its rule, for when there is no plan

    def reset(self) -> None:
        """Do nothing: the planner has no memory."""

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the plan's gait first."""
        target = observation["target"][: self.dimension]
        obstacles = told_obstacles(observation, NAME)
        points = surface_points(obstacles, SPACING, HORIZON + 3)
        values = -self.outlook.after_each(target)
        for margin in MARGINS:
            clearance = self.radius + margin
            gait = search(self.outlook, self.steps, points, clearance, self.radius, target, HORIZON)
            if gait is not None:
                values[gait] = values.max() + 1
                return values
        return np.where(self.shield.safe(points), values, values - np.ptp(values) - 1)


SOLVER = UntrainedSolver(
    NAME,
    "A* over the gaits with the full map and true positions: the bound for obstacles that stand still",
    AstarMapPlanner,
)
