"""Planner `greedy`: the gait that comes nearest to the target and hits nothing the laser sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.observation import laser_points
from defplan_mj.planning.planner import Observation, Planner, TrainResult
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation, Progress, no_progress
from defplan_solvers.untrained import load_nothing, save_nothing

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


class GreedySolver:
    """The planner plugin `greedy`."""

    kind = "planner"
    name = "greedy"
    summary = "one cycle of lookahead towards the target; nothing to train"
    needs_training = False

    def train(
        self,
        surrogate: Surrogate,
        navigation: Navigation,
        seed: int,
        seconds: float | None = None,
        progress: Progress = no_progress,
    ) -> TrainResult:
        """Return the planner: there is nothing to train."""
        return TrainResult(GreedyPlanner(surrogate, navigation))

    def save(self, planner: Planner, path: Path) -> None:
        """Write the planner's name to `path`."""
        save_nothing(self.name, path)

    def load(self, path: Path, surrogate: Surrogate, navigation: Navigation) -> GreedyPlanner:
        """Return the planner of a file of `save`."""
        load_nothing(self.name, path)
        return GreedyPlanner(surrogate, navigation)


SOLVER = GreedySolver()
