"""Planner `astar-map`: A* over the gaits with the full map and true positions: a bound for static scenes."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.planner import Observation, carried_out
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate, check_decisions
from defplan_mj.task import Navigation
from defplan_solvers.search.astar import MARGINS
from defplan_solvers.search.full_map import surface_points, told_obstacles
from defplan_solvers.search.manoeuvre_search import ManoeuvreSearch
from defplan_solvers.search.untrained import UntrainedSolver

NAME = "astar-map"
HORIZON = 14.0  # a plan that gets this far is good enough: more of the map changes no first gait, m
SPACING = 0.4  # of the points that stand for an obstacle's surface, m


class AstarMapPlanner:
    """Replans at every cycle among all obstacles, from where the robot truly is."""

    needs_obstacles = True

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        check_decisions(surrogate, navigation)
        self.radius, self.dimension = surrogate.radius, navigation.dimension
        self.search = ManoeuvreSearch(surrogate, navigation)
        self.past = surrogate.past
        self.shield = Shield(self, surrogate, navigation)  # its rule, for when there is no plan

        self.reset()

    def reset(self) -> None:
        """Forget the gaits before: the robot is at rest."""
        self.before = self.past.rest

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the plan's gait first."""
        target = observation["target"][: self.dimension]
        obstacles = told_obstacles(observation, NAME)[:, : self.dimension + 1]
        points = surface_points(obstacles, SPACING, HORIZON + 3)
        values = -self.search.outlook.after_each(target, int(self.past.phase[self.before]))
        for margin in MARGINS:
            clearance = self.radius + margin
            known = points, clearance, self.radius, target
            gait = self.search.first_gait(*known, self.before, HORIZON)
            if gait is not None:
                values[gait] = values.max() + 1
                break
        else:
            safe = self.shield.safe(points, before=self.before)
            values = np.where(safe, values, values - np.ptp(values) - 1)
        self.before = int(self.past.then[self.before, carried_out(values, observation)])
        return values


SOLVER = UntrainedSolver(
    NAME,
    "A* over the gaits with the full map and true positions: the bound for obstacles that stand still",
    AstarMapPlanner,
)
