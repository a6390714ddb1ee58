"""Planner `rrt`: a kinodynamic rapidly-exploring random tree over the gaits, with the full map.

LaValle and Kuffner, Randomized Kinodynamic Planning (2001): a random point, the node of the tree from which
it is nearest, and of that node the free gait that comes nearest to the point. The controls are the gaits, the
dynamics the surrogate, the distance the cycles that `Outlook` estimates.
"""

from __future__ import annotations

import zlib

import numpy as np

from defplan_mj.planning.planner import Observation, carried_out
from defplan_mj.planning.surrogate import Surrogate, check_whole_cycles
from defplan_mj.task import Navigation
from defplan_solvers.search.full_map import clearances, told_obstacles
from defplan_solvers.search.outlook import Outlook
from defplan_solvers.search.untrained import UntrainedSolver

NAME = "rrt"
NODES = 3000  # of one tree
GOAL_BIAS = 0.1  # share of the points that are the target
AROUND = 6.0  # points are drawn in the box of start and target, and so far around it, m
MARGINS = (0.25, 0.1, 0.0)  # added to the body's radius, one after the other, m


class RrtPlanner:
    """Follows the way it has found as long as that is free and ends at the target; else it looks for another."""

    needs_obstacles = True

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        check_whole_cycles(NAME, navigation)
        self.motions = surrogate.motions(navigation.space)
        self.radius, self.dimension = surrogate.radius, navigation.dimension
        self.goal_radius = navigation.goal_radius
        self.outlook = Outlook(self.motions, navigation.goal_radius)
        self.reset()

    def reset(self) -> None:
        """Forget the way."""
        self.way: list[int] = []

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the way's first gait first."""
        target = observation["target"][: self.dimension]
        obstacles = told_obstacles(observation, NAME)[:, : self.dimension + 1]
        values = -self.outlook.after_each(target)
        if not self._holds(obstacles, target):
            self.way = self._look(obstacles, target)
        if self.way:
            values[self.way[0]] = values.max() + 1
        else:
            _, _, way = clearances(obstacles, *self._start(), self.motions)
            values = np.where(way > self.radius, values, values - np.ptp(values) - 1)
        done = carried_out(values, observation)
        self.way = self.way[1:] if self.way and done == self.way[0] else []
        return values

    def _start(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(self.dimension), np.eye(self.dimension)

    def _holds(self, obstacles: np.ndarray, target: np.ndarray) -> bool:
        """Return whether the rest of the way is free from here, and ends at the target."""
        position, frame = self._start()
        for gait in self.way:
            one = self.motions.of(np.array([gait]))
            if clearances(obstacles, position, frame, one)[2][0] < self.radius:
                return False
            ends, frames = one.after(position[None], frame[None])
            position, frame = ends[0], frames[0]
        return bool(self.way) and float(np.linalg.norm(target - position)) <= self.goal_radius

    def _look(self, obstacles: np.ndarray, target: np.ndarray) -> list[int]:
        """Return the gaits of a way to the target; of one that comes near it if none is found."""
        best: list[int] = []
        for i, margin in enumerate(MARGINS):
            # the same scene seen from the same place gives the same tree, in whatever process
            seed = zlib.crc32(np.round(target, 9).tobytes() + np.round(obstacles, 9).tobytes())
            rng = np.random.default_rng([seed, i])
            tree = Tree(self.outlook, obstacles, self.radius, margin)
            way, arrives = tree.grow(rng, target)
            if arrives:
                return way
            best = best or way
        return best


class Tree:
    """A tree of poses, grown from the robot's.

    Args:
        outlook: estimates cycles, and has the motions.
        obstacles: (n, d + 1) centres and radii, m.
        radius: of the robot, m.
        margin: more than that, m; where there is less already, cycles may gain some.
    """

    def __init__(
        self, outlook: Outlook, obstacles: np.ndarray, radius: float, margin: float
    ) -> None:
        self.outlook, self.motions, self.obstacles = outlook, outlook.motions, obstacles
        self.least, self.clearance = radius, radius + margin

    def grow(self, rng: np.random.Generator, target: np.ndarray) -> tuple[list[int], bool]:
        """Return the gaits of the way to the target, or to the node that is nearest to it, and which."""
        d, gaits = len(target), len(self.motions.translations)
        position, frames = np.zeros((NODES, d)), np.zeros((NODES, d, d))
        parent, begun = np.full(NODES, -1), np.full(NODES, -1)
        free = np.ones((NODES, gaits), bool)  # gaits that were not tried yet, or cannot hit
        frames[0], made = np.eye(d), 1
        free[0] = self._free(position[0], frames[0])
        low, high = np.minimum(target, 0) - AROUND, np.maximum(target, 0) + AROUND
        nearest, rest = 0, np.inf
        for _ in range(2 * NODES):
            if made == NODES:
                break
            point = target if rng.random() < GOAL_BIAS else rng.uniform(low, high)
            offset = np.einsum("nij,ni->nj", frames[:made], point - position[:made])
            cost = np.where(free[:made].any(1), self.outlook.cycles(offset), np.inf)
            node = int(cost.argmin())
            if not np.isfinite(cost[node]):
                break
            after = np.where(free[node], self.outlook.after_each(offset[node]), np.inf)
            gait = int(after.argmin())
            free[node, gait] = False
            ends, turned = self.motions.of(np.array([gait])).after(
                position[node][None], frames[node][None]
            )
            position[made], frames[made] = ends[0], turned[0]
            parent[made], begun[made] = node, gait
            free[made] = self._free(ends[0], turned[0])
            left = float(self.outlook.cycles(turned[0].T @ (target - ends[0])))
            if left < rest:
                nearest, rest = made, left
            made += 1
            if rest == 0:
                break
        return _way(nearest, parent, begun), rest == 0

    def _free(self, position: np.ndarray, frame: np.ndarray) -> np.ndarray:
        """Return (K,) which gaits hit nothing from a pose."""
        here, end, way = clearances(self.obstacles, position, frame, self.motions)
        gains = (here < self.clearance) & (end > here)
        return (way >= self.least) & ((way >= self.clearance) | gains)


def _way(node: int, parent: np.ndarray, begun: np.ndarray) -> list[int]:
    way: list[int] = []
    while node > 0:
        way.append(int(begun[node]))
        node = int(parent[node])
    return way[::-1]


SOLVER = UntrainedSolver(
    NAME,
    "a random tree (RRT) over the gaits with the full map and true positions; nothing to train",
    RrtPlanner,
)
