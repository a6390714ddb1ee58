"""Planner `astar`: A* over the surrogate's gaits among what the laser saw and the map remembers."""

from __future__ import annotations

import heapq
import math

import numpy as np

from defplan_mj.planning.planner import Observation
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.laser_map import LaserMap
from defplan_solvers.untrained import UntrainedSolver

GRID = 0.15  # cell of the clearance grid, m
HORIZON = 9.0  # a plan that gets this far from the robot is good enough, m
MARGINS = (
    0.45,
    0.25,
    0.1,
)  # added to the body's radius, one after the other until there is a plan, m
NODES = 1500  # search nodes of one attempt
CELL, HEADINGS = 0.3, 24  # poses in the same cell and heading count as one, m
WEIGHT = 1.2  # of the heuristic: more is faster, less is shorter


class AstarPlanner:
    """Replans at every cycle; memory makes up for what the laser no longer sees."""

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.motions = surrogate.planar()
        self.radius, self.goal_radius = surrogate.radius, navigation.goal_radius
        self.map = LaserMap(self.motions, navigation.laser_range)
        self.shield = Shield(self, surrogate, navigation)  # its rule, for when there is no plan

    def reset(self) -> None:
        """Forget the map."""
        self.map.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the distance that is left after each gait, the plan's gait first."""
        target = observation["target"][:2]
        points = self.map.update(observation["laser"], target)
        values = -np.hypot(*(target - self.motions[:, :2]).T)
        gait = self._plan(points, target)
        if gait is None:
            values = np.where(self.shield.safe(points), values, values - np.ptp(values) - 1)
        else:
            values[gait] = values.max() + 1
        self.map.chose(int(values.argmax()))
        return values

    def _plan(self, points: np.ndarray, target: np.ndarray) -> int | None:
        clearance = _Clearance(points)
        for margin in MARGINS:
            gait = search(
                self.motions, clearance, self.radius + margin, self.radius, target, self.goal_radius
            )
            if gait is not None:
                return gait
        return None


class _Clearance:
    """Distance to the nearest point, from a grid about the robot; what lies outside counts as free."""

    def __init__(self, points: np.ndarray) -> None:
        from scipy.ndimage import distance_transform_edt  # here: plugins are quick to import

        self.cells = 2 * round((HORIZON + 1.0) / GRID) + 1
        self.middle = self.cells // 2
        index = np.round(points / GRID).astype(int) + self.middle
        inside = np.all((index >= 0) & (index < self.cells), axis=1)
        free = np.ones((self.cells, self.cells), bool)
        free[index[inside, 0], index[inside, 1]] = False
        distance = distance_transform_edt(free) if inside.any() else np.full(free.shape, 1e3)
        self._distance = (GRID * distance).ravel().tolist()

    def __call__(self, x: float, y: float) -> float:
        """Return the clearance at (x, y), m, to about half a cell."""
        i, j = round(x / GRID) + self.middle, round(y / GRID) + self.middle
        if 0 <= i < self.cells and 0 <= j < self.cells:
            return self._distance[i * self.cells + j]
        return 1e3


def search(
    motions: np.ndarray,
    clearance: _Clearance,
    wanted: float,
    least: float,
    target: np.ndarray,
    goal_radius: float,
) -> int | None:
    """Return the first gait of a short way to the target, or None if there is none.

    Args:
        motions: (K, 3) forward and left displacement (m) and yaw (rad) of each gait.
        wanted: clearance that cycles keep, m; where there is less already, cycles may gain some.
        least: clearance that cycles keep in any case, m.
        target: (2,) m, in the robot's yaw frame.
    """
    gaits = [tuple(map(float, motion)) for motion in motions]
    advance = max(math.hypot(x, y) for x, y, _ in gaits)
    goal_x, goal_y = map(float, target)

    def left(x: float, y: float) -> float:
        return max(0.0, math.hypot(goal_x - x, goal_y - y) - goal_radius) / advance

    # An entry: estimate, order, cycles, x, y, yaw, first gait, clearance.
    heap = [(WEIGHT * left(0.0, 0.0), 0, 0, 0.0, 0.0, 0.0, -1, clearance(0.0, 0.0))]
    closed, made = set(), 1
    nearest, fallback = math.inf, -1
    while heap and made < NODES:
        _, _, cycles, x, y, yaw, first, here = heapq.heappop(heap)
        if first >= 0 and (left(x, y) == 0.0 or math.hypot(x, y) > HORIZON):
            return first
        turn = math.floor(yaw % (2 * math.pi) * HEADINGS / (2 * math.pi))
        key = (math.floor(x / CELL), math.floor(y / CELL), turn)
        if key in closed:
            continue
        closed.add(key)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        for gait, (forward, sideways, yaw_change) in enumerate(gaits):
            dx = cosine * forward - sine * sideways
            dy = sine * forward + cosine * sideways
            end = clearance(x + dx, y + dy)
            way = min(clearance(x + share * dx, y + share * dy) for share in (0.33, 0.67))
            room = min(end, way)
            if room < least or (room < wanted and not (here < wanted and end > here)):
                continue
            rest = left(x + dx, y + dy)
            begun = gait if first < 0 else first
            if rest < nearest:
                nearest, fallback = rest, begun
            made += 1
            entry = (cycles + 1 + WEIGHT * rest, made, cycles + 1, x + dx, y + dy)
            heapq.heappush(heap, (*entry, yaw + yaw_change, begun, end))
    return fallback if fallback >= 0 else None


SOLVER = UntrainedSolver(
    "astar",
    "A* over the gaits among all laser points seen so far; nothing to train",
    AstarPlanner,
)
