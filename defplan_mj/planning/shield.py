"""The safety shield: a planner's best gait that leaves a way to go on without a collision."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import MotionTree, lookahead, motion_trees
from defplan_mj.planning.planner import Observation, Planner, needs_obstacles
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.tracking import Tracker
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
    half the margin is left: turns slip a little, and many of them must not add up to a hit. What moves
    is followed (`planning.tracking`) and expected to go on as it does; then the robot looks farther ahead, and if
    no sequence keeps a margin, those with the most room at their narrowest count as safe.

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
        self.radius, self.dimension = surrogate.radius, navigation.dimension
        deepest = max(depth for depth, _ in levels)
        motions = surrogate.switched_motions(navigation.space)
        self.trees = motion_trees(motions, (1,) * deepest, surrogate.past)
        self.long_trees = motion_trees(motions, lookahead(surrogate.gaits), surrogate.past)
        self.tracker = Tracker(surrogate, navigation)
        ends = [np.linalg.norm(tree.end, axis=1).max() for tree in self.trees + self.long_trees]
        self.reach = float(max(ends)) + self.radius + max(margin for _, margin in levels)

    @property
    def needs_obstacles(self) -> bool:
        """Whether the wrapped planner is told all obstacles; the shield knows the laser only."""
        return needs_obstacles(self.planner)

    def reset(self) -> None:
        """Reset the wrapped planner, and forget what moved."""
        self.planner.reset()
        self.tracker.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return the planner's values (K,), those of unsafe gaits lowered below all others."""
        target = observation["target"][: self.dimension]
        seen = self.tracker.update(observation["laser"], target)
        safe = self.safe(seen.points, seen.drift, self.tracker.odometry.past)
        values = self.planner.values({**observation, "safe": safe, "drift": seen.drift_of_all})
        values = np.where(safe, values, values - (np.ptp(values) + 1.0))
        self.tracker.chose(int(np.argmax(values)))
        return values

    def safe(
        self, points: np.ndarray, drift: np.ndarray | None = None, before: int = -1
    ) -> np.ndarray:
        """Return (K,) which gaits are safe among points, at least one of them.

        Args:
            points: (p, d) m.
            drift: (p, d) how far each moves until the next decision, m; None: nothing moves.
            before: the past (`planning.past`); -1: the robot is at rest.
        """
        drift = np.zeros_like(points) if drift is None else drift
        moving = bool(drift.any())
        tree = (self.long_trees if moving else self.trees)[before]
        # no cycle comes near those beyond reach
        reach = self.reach + sum(tree.holds) * np.linalg.norm(drift, axis=1)
        near = np.einsum("pd,pd->p", points, points) <= reach**2
        points, drift = points[near], drift[near]
        if not len(points):
            return np.ones(tree.gaits, bool)
        from_start, from_end, from_way = tree.distances2(points, drift)
        leaves = from_end > from_start
        if moving:
            return self._roomiest(tree, from_end, from_way, leaves)
        touches = from_way < self.radius**2
        for depth, margin in self.levels:
            close = from_way < (self.radius + margin) ** 2
            leaving = leaves & (from_start < (self.radius + margin) ** 2)
            turning = tree.in_place & (from_way > (self.radius + margin / 2) ** 2)
            hits = touches | (close & ~leaving & ~turning)
            safe = tree.first_gaits(~np.any(hits, axis=0), depth)
            if safe.any():
                return safe
        clearance = from_way[:, : tree.gaits].min(0)
        return clearance == clearance.max()

    def _roomiest(
        self, tree: MotionTree, from_end: np.ndarray, from_way: np.ndarray, leaves: np.ndarray
    ) -> np.ndarray:
        """Return (K,) which gaits begin a sequence that keeps the largest margin that any keeps.

        The disc or ball is larger than the body: to be a little too close need not be a hit.
        """
        touches = from_way < self.radius**2
        room2 = np.where(leaves & ~touches, from_end, from_way).min(0)
        room = tree.best_room(np.sqrt(np.maximum(room2, 0)) - self.radius)
        for _, margin in self.levels:
            if (safe := room >= margin).any():
                return safe
        return room >= room.max() - 1e-6
