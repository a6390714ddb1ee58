"""Planner `astar`: A* over the surrogate's gaits among what the laser saw and the map remembers."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.planner import Observation, carried_out
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.search.laser_map import LaserMap
from defplan_solvers.search.manoeuvre_search import ManoeuvreSearch
from defplan_solvers.search.untrained import UntrainedSolver

HORIZON = 9.0  # a plan that gets this far from the robot is good enough, m
MARGINS = (
    0.45,
    0.25,
    0.1,
)  # added to the body's radius, one after the other until there is a plan, m


class AstarPlanner:
    """Replans at every cycle; memory makes up for what the laser no longer sees."""

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.radius, self.dimension = surrogate.radius, navigation.dimension
        self.search = ManoeuvreSearch(surrogate, navigation)
        self.map = LaserMap(surrogate, navigation)
        self.shield = Shield(self, surrogate, navigation)  # its rule, for when there is no plan

    def reset(self) -> None:
        """Forget the map."""
        self.map.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the plan's gait first."""
        target = observation["target"][: self.dimension]
        points = self.map.update(observation["laser"], target)
        values = -self.search.outlook.after_each(target, self.map.odometry.phase)
        gait = self._plan(points, target)
        if gait is None:
            safe = self.shield.safe(points, before=self.map.odometry.past)
            values = np.where(safe, values, values - np.ptp(values) - 1)
        else:
            values[gait] = values.max() + 1
        self.map.chose(carried_out(values, observation))
        return values

    def _plan(self, points: np.ndarray, target: np.ndarray) -> int | None:
        before = self.map.odometry.past
        for margin in MARGINS:
            clearance = self.radius + margin
            gait = self.search.first_gait(points, clearance, self.radius, target, before, HORIZON)
            if gait is not None:
                return gait
        return None


SOLVER = UntrainedSolver(
    "astar",
    "A* over the gaits among all laser points seen so far; nothing to train",
    AstarPlanner,
    quick=True,
)
