"""Planner `oracle`: what can be reached at all, for a robot that knows all obstacles and how they move."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.odometry import Odometry
from defplan_mj.planning.planner import Observation, carried_out
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.tracking import Balls
from defplan_mj.task import Navigation
from defplan_solvers.search.full_map import told_obstacles
from defplan_solvers.search.space_time import SpaceTime
from defplan_solvers.search.untrained import UntrainedSolver

MARGINS = (0.3, 0.15, 0.05, 0.0)
"""Kept from obstacles, one after the other until there is a way, m."""


class OraclePlanner:
    """A bound for planners that see a laser only: no robot of these motions knows more.

    It searches in place and time, anew at every cycle, with the true positions and velocities of all
    obstacles, which an evaluation tells it.
    """

    needs_obstacles = True

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.search, self.d = SpaceTime(surrogate, navigation), navigation.dimension
        self.odometry = Odometry(surrogate, navigation)

    def reset(self) -> None:
        """Begin a new episode."""
        self.odometry.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the way's first gait first."""
        target, d = observation["target"][: self.d], self.d
        told = told_obstacles(observation, "oracle")
        balls = Balls(told[:, :d], told[:, d], told[:, d + 1 :])
        values = self.search.values(balls, target, self.odometry.past, MARGINS)
        self.odometry.chose(carried_out(values, observation))
        return values


SOLVER = UntrainedSolver(
    "oracle",
    "A* in place and time that is told all obstacles and their velocities: a bound, no planner",
    OraclePlanner,
    bound=True,
)
