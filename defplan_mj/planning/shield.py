"""The safety shield: a planner's best gait that leaves a way to go on without a collision."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.planner import Observation, Planner, needs_obstacles
from defplan_mj.planning.sensors.sensor import seen_points
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

LEVELS = ((4, 0.3), (4, 0.05), (2, 0.0), (1, 0.0))
"""Depth (cycles) and margin (m) that are asked for, one after the other, until a gait meets them."""


class Shield:
    """A planner that wraps another one and devalues gaits that lead into what the laser sees.

    The wrapped planner is told which gaits are safe ('safe' of its observation): one that remembers
    its way must know what was done.

    A gait is safe if the surrogate knows a sequence of cycles that begins with it and keeps the
    ball that holds the body clear of every laser point by a margin. If no gait is, a shorter
    sequence and a smaller margin must do; if none is left, the gait that stays farthest from the
    points. A robot that is within the margin already may move away, or turn in its place as long as
    half the margin is left: turns slip a little, and many of them must not add up to a hit.

    Args:
        planner: to be shielded.
        surrogate: f_fit.
        navigation: for the laser.
        levels: see `LEVELS`.
    """

    def __init__(
        self,
        planner: Planner,
        surrogate: Surrogate,
        navigation: Navigation,
        levels: tuple[tuple[int, float], ...] = LEVELS,
    ) -> None:
        self.planner, self.levels = planner, levels
        self.radius, self.navigation = surrogate.radius, navigation
        deepest = max(depth for depth, _ in levels)
        self.tree = MotionTree(surrogate.motions(navigation.space), deepest)
        farthest = float(np.linalg.norm(self.tree.end, axis=1).max())
        self.reach = farthest + self.radius + max(margin for _, margin in levels)

    @property
    def needs_obstacles(self) -> bool:
        """Whether the wrapped planner is told all obstacles; the shield knows the laser only."""
        return needs_obstacles(self.planner)

    def reset(self) -> None:
        """Reset the wrapped planner."""
        self.planner.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return the planner's values (K,), those of unsafe gaits lowered below all others."""
        safe = self.safe(seen_points(observation["laser"], self.navigation))
        values = self.planner.values({**observation, "safe": safe})
        return np.where(safe, values, values - (np.ptp(values) + 1.0))

    def safe(self, points: np.ndarray) -> np.ndarray:
        """Return (K,) which gaits are safe among the (p, d) points, at least one of them."""
        gaits = self.tree.gaits
        # no cycle comes near those beyond reach
        points = points[np.einsum("pd,pd->p", points, points) <= self.reach**2]
        if not len(points):
            return np.ones(gaits, bool)
        from_start, from_end, from_way = self.tree.distances2(points)
        touches = from_way < self.radius**2
        leaves = from_end > from_start
        for depth, margin in self.levels:
            close = from_way < (self.radius + margin) ** 2
            leaving = leaves & (from_start < (self.radius + margin) ** 2)
            turning = self.tree.in_place & (from_way > (self.radius + margin / 2) ** 2)
            hits = touches | (close & ~leaving & ~turning)
            safe = self.tree.first_gaits(~np.any(hits, axis=0), depth)
            if safe.any():
                return safe
        clearance = from_way[:, :gaits].min(0)
        return clearance == clearance.max()
