"""A* over manoeuvres written down in numpy: the twin of kernel/astar.c."""

from __future__ import annotations

import heapq

import numpy as np

from defplan_solvers.search.manoeuvre_search import CELL, NODES, WEIGHT, ManoeuvreSearch
from defplan_solvers.search.manoeuvres import Manoeuvres


def first_gait(
    search: ManoeuvreSearch,
    points: np.ndarray,
    clearance: float,
    least: float,
    target: np.ndarray,
    before: int,
    horizon: float,
) -> int | None:
    """Return what `ManoeuvreSearch.first_gait` is to return."""
    d, outlook = len(target), search.outlook
    nodes = [(np.zeros(d), np.eye(d), -1, 0, before % len(search.steps), False)]
    heap, closed, nearest, fallback = [(0.0, 0)], set(), np.inf, None
    while heap and len(nodes) < NODES:
        position, frame, first, cycles, last, near = nodes[heapq.heappop(heap)[1]]
        if near:
            return first
        cell = np.floor(position / CELL) if len(nodes) > 1 else np.zeros(d)
        heading = np.round(frame @ outlook.axes[0] / search.alike)
        key = (*cell, *(heading if len(nodes) > 1 else np.zeros(d)))
        if key in closed:
            continue
        closed.add(key)
        steps = search.steps[last]
        for m in np.flatnonzero(free(steps, points, position, frame, clearance, least)):
            end = position + frame @ steps.motions.translations[m]
            facing = frame @ steps.motions.rotations[m]
            spent = cycles + steps.cycles[m]
            begun = int(steps.first[m]) if first < 0 else first
            rest = float(outlook.cycles(facing.T @ (target - end)))
            if rest < nearest:
                nearest, fallback = rest, begun
            heapq.heappush(heap, (spent + WEIGHT * rest, len(nodes)))
            done = rest == 0 or end @ end > horizon**2
            nodes.append((end, facing, begun, spent, int(steps.final[m]), done))
    return fallback


def free(
    steps: Manoeuvres,
    points: np.ndarray,
    position: np.ndarray,
    frame: np.ndarray,
    clearance: float,
    least: float,
) -> np.ndarray:
    """Return (M,) which steps may be taken at a pose."""
    if not len(points):
        return np.ones(len(steps.first), bool)
    here, end, way = (a.min(0) for a in steps.distances2((points - position) @ frame))
    turns = steps.in_place & (way > (0.5 * (clearance + least)) ** 2)
    gains = (here < clearance**2) & ((end > here) | turns)
    return steps.free(((way >= least**2) & ((way >= clearance**2) | gains))[None])[0]
