"""Planner `astar`: A* over the surrogate's gaits among what the laser saw and the map remembers."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np

from defplan_mj.planning.planner import Observation, carried_out
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.search.laser_map import LaserMap
from defplan_solvers.search.manoeuvres import Manoeuvres
from defplan_solvers.search.outlook import Outlook
from defplan_solvers.search.untrained import UntrainedSolver

HORIZON = 9.0  # a plan that gets this far from the robot is good enough, m
MARGINS = (
    0.45,
    0.25,
    0.1,
)  # added to the body's radius, one after the other until there is a plan, m
NODES = 10000  # search nodes of one attempt
AT_ONCE = 8  # nodes that are expanded together, the best first
CELL, HEADING = 0.45, 0.3  # poses closer than this count as one, m and rad
WEIGHT = 1.2  # of the estimate: more is faster, less is shorter


class AstarPlanner:
    """Replans at every cycle; memory makes up for what the laser no longer sees."""

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.radius, self.dimension = surrogate.radius, navigation.dimension
        self.outlook = Outlook(surrogate.cycle_motions(navigation.space), navigation.goal_radius)
        motions, heading = surrogate.switched_motions(navigation.space), self.outlook.axes[0]
        past = surrogate.past
        self.steps = [Manoeuvres(motions, heading, i, past) for i in range(past.rest + 1)]
        self.map = LaserMap(surrogate, navigation)
        self.shield = Shield(self, surrogate, navigation)  # its rule, for when there is no plan

    def reset(self) -> None:
        """Forget the map."""
        self.map.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the plan's gait first."""
        target = observation["target"][: self.dimension]
        points = self.map.update(observation["laser"], target)
        values = -self.outlook.after_each(target, self.map.odometry.phase)
        gait = self._plan(points, target)
        if gait is None:
            safe = self.shield.safe(points, before=self.map.odometry.past)
            values = np.where(safe, values, values - np.ptp(values) - 1)
        else:
            values[gait] = values.max() + 1
        self.map.chose(carried_out(values, observation))
        return values

    def _plan(self, points: np.ndarray, target: np.ndarray) -> int | None:
        for margin in MARGINS:
            clearance = self.radius + margin
            before = self.map.odometry.past
            gait = search(self.outlook, self.steps, points, clearance, self.radius, target, before)
            if gait is not None:
                return gait
        return None


def search(
    outlook: Outlook,
    steps: Sequence[Manoeuvres],
    points: np.ndarray,
    clearance: float,
    least: float,
    target: np.ndarray,
    before: int = -1,
    horizon: float = HORIZON,
) -> int | None:
    """Return the first gait of a short way to the target, or None if there is none.

    Args:
        outlook: estimates what is left.
        steps: of the search, after each past, and last those from rest.
        points: (p, d) what to keep away from, m, in the robot's frame.
        clearance: that cycles keep, m; where there is less already, cycles may gain some, or
            turn the robot in its place.
        least: clearance that cycles keep in any case, m.
        target: (d,) m, in the robot's frame.
        before: the past (`planning.past`); -1: the robot is at rest.
        horizon: a way that gets this far is good enough, m.
    """
    d, room = len(target), NODES + AT_ONCE * max(len(after.first) for after in steps)
    position, frames = np.zeros((room, d)), np.zeros((room, d, d))
    first, cycles, near = np.full(room, -1), np.zeros(room), np.zeros(room, bool)
    last = np.full(room, before % len(steps))
    keys = np.zeros((room, 2 * d), np.int16)
    frames[0], made = np.eye(d), 1
    alike = max(
        HEADING, max(after.span for after in steps)
    )  # headings that one manoeuvre reaches anyway count as one
    heap = [(0.0, 0)]  # of estimates and nodes
    closed: set[bytes] = set()
    nearest, fallback = np.inf, -1
    while heap and made < NODES:
        chosen: list[int] = []
        while heap and len(chosen) < AT_ONCE:
            node = heapq.heappop(heap)[1]
            if near[node]:
                return int(first[node])
            if (key := keys[node].tobytes()) not in closed:
                closed.add(key)
                chosen.append(node)
        for gait in {int(last[node]) for node in chosen}:
            nodes, after = np.array([n for n in chosen if last[n] == gait]), steps[gait]
            start, turned = position[nodes], frames[nodes]
            parent, step = np.nonzero(_free(after, points, start, turned, clearance, least))
            if not len(step):
                continue
            new = slice(made, made + len(step))
            made = new.stop
            end, facing = after.motions.of(step).after(start[parent], turned[parent])
            position[new], frames[new], last[new] = end, facing, after.final[step]
            cycles[new] = spent = cycles[nodes][parent] + after.cycles[step]
            begun = first[nodes][parent]
            first[new] = begun = np.where(begun < 0, after.first[step], begun)
            rest = outlook.cycles(np.einsum("nij,ni->nj", facing, target - end))
            near[new] = (rest == 0) | (np.einsum("nd,nd->n", end, end) > horizon**2)
            keys[new, :d] = np.floor(end / CELL)
            keys[new, d:] = np.round(facing @ outlook.axes[0] / alike)
            if rest.min() < nearest:
                nearest, fallback = rest.min(), int(begun[rest.argmin()])
            for entry in zip((spent + WEIGHT * rest).tolist(), range(new.start, made), strict=True):
                heapq.heappush(heap, entry)
    return None if fallback < 0 else fallback


def _free(
    steps: Manoeuvres,
    points: np.ndarray,
    position: np.ndarray,
    frames: np.ndarray,
    clearance: float,
    least: float,
) -> np.ndarray:
    """Return (n, M) which steps may be taken at poses (n, d), (n, d, d); see `search`."""
    offset = points - position[:, None]
    close = (np.einsum("npd,npd->np", offset, offset) < (steps.reach + clearance) ** 2).any(0)
    if not close.any():
        return np.ones((len(position), len(steps.first)), bool)
    local = (offset[:, close] @ frames).reshape(-1, points.shape[1])
    shape = (len(position), -1, len(steps.start))
    here, end, way = (a.reshape(shape).min(1) for a in steps.distances2(local))
    turns = steps.in_place & (way > (0.5 * (clearance + least)) ** 2)
    gains = (here < clearance**2) & ((end > here) | turns)
    return steps.free((way >= least**2) & ((way >= clearance**2) | gains))


SOLVER = UntrainedSolver(
    "astar",
    "A* over the gaits among all laser points seen so far; nothing to train",
    AstarPlanner,
    quick=True,
)
