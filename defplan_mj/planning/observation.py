"""What a planner's network sees: a scan, a target and each gait's room, as features of about unit size."""

from __future__ import annotations

import numpy as np

from defplan_mj.kernel.library import kernel
from defplan_mj.planning.motion_tree import lookahead, motion_trees
from defplan_mj.planning.sensors.sensor import reading_size, sensor_of
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

NARROW, WIDE = 0.2, 1.0
"""Scales at which the room of a gait is told, m."""
MOST = 4.0
"""More room than this is not told apart, m."""
FAST = 2.0
"""Unit of the speed at which points come nearer, m/s."""


class Senses:
    """The features of one robot's scans and targets.

    Whether the next cycle hits something hangs on a few centimetres of a laser whose range is many
    metres: too little for a network to tell from the distances alone. The robot knows how its gaits
    move it, and where what it has seen moves, so the features also say how much room each gait has: the
    distance of points from the straight way of its cycle, less the robot's radius. And how much room
    the best sequence of `lookahead` that begins with the gait has at its narrowest.

    Args:
        surrogate: of the robot: its gaits' motions and its radius.
        navigation: for the sensor and the space.

    Attributes:
        size: the number of features, those of a reading + p points + d + 3 + 4 K + K m + 1, with m
            decisions in a cycle.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.navigation, self.radius = navigation, np.float32(surrogate.radius)
        self.sensor, self.readings = sensor_of(navigation), reading_size(navigation)
        self.past, self.fast = surrogate.past, np.float32(FAST * surrogate.decision_seconds)
        self.gaits = surrogate.gaits
        motions = surrogate.switched_motions(navigation.space)
        self.trees = motion_trees(motions, lookahead(self.gaits), self.past, whole=False)
        self._start, self._end = (
            np.ascontiguousarray(np.stack([getattr(tree, name).T for tree in self.trees]))
            for name in ("start", "end")
        )
        self._begun = self.trees[0].begun
        self._horizon = float(self._begun.max()) + 1
        ends = np.linalg.norm(self._end, axis=1)
        self._reach = float(ends.max()) + float(self.radius) + MOST
        points, _ = self.sensor.points(np.zeros(self.readings, np.float32), navigation)
        d, k = navigation.dimension, self.gaits
        sizes = (self.readings, len(points), d, 3, k * self.past.decisions + 1, k, k, k, k)
        self._parts = np.cumsum(sizes)[:-1]
        self.size = sum(sizes)

    def __call__(
        self,
        laser: np.ndarray,
        target: np.ndarray,
        before: np.ndarray | int | None = None,
        drift: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return (..., size) float32 features of scans and targets.

        A reading becomes what its sensor says (a beam its proximity), and of its points how fast they
        come nearer, in 2 m/s. The target, in the robot's frame, becomes its direction (a unit vector)
        and three views of its distance r (m): log(1 + r) / 3, r / 20 and exp(-r / 2), so that near and
        far are both told apart. The gait before, and in which part of its cycle, is told by ones and
        zeros. The room c of what a gait plays until the next decision, and of the best sequence, becomes
        tanh(c / 0.2) and, from c = -0.5 on, exp(-c).

        Args:
            laser: (..., readings) of the sensor.
            target: (..., d) m; the first d components of an observation's.
            before: (...,) the past (`planning.past`); None: the robot is at rest.
            drift: (..., p, d) how far the reading's points move until the next decision, m; None: they do not.
        """
        shape, d = laser.shape[:-1], target.shape[-1]
        laser, target = laser.reshape(-1, self.readings), target.reshape(-1, d)
        n = len(laser)
        past = np.broadcast_to(self.past.rest if before is None else before, shape).reshape(n)
        distance = np.sqrt(np.einsum("nd,nd->n", target, target))
        inverse = 1.0 / np.maximum(distance, 1e-6)
        out = np.zeros((n, self.size), np.float32)
        reading, nearing, where, far, last, *rooms = np.split(out, self._parts, axis=1)
        reading[:] = self.sensor.features(laser, self.navigation)
        points, there = self.sensor.points(np.asarray(laser, np.float32), self.navigation)
        moves = np.zeros_like(points)
        if drift is not None:
            moves[:] = drift.reshape(moves.shape)
            away = np.maximum(np.sqrt(np.einsum("npd,npd->np", points, points)), 1e-6)
            nearing[:] = -np.einsum("npd,npd->np", moves, points) / (away * self.fast)
        where[:] = target * inverse[:, None]
        far[:, 0] = np.log1p(distance) / 3
        far[:, 1] = distance / 20
        far[:, 2] = np.exp(-0.5 * distance)
        last[np.arange(n), self.past.segment[past]] = 1
        room = self.room(points, there, moves, past)
        for part, one in enumerate((room[:, : self.gaits], self.trees[0].best_room(room))):
            rooms[2 * part][:] = np.tanh(one / NARROW)
            rooms[2 * part + 1][:] = np.exp(-np.maximum(one, -0.5) / WIDE)
        return out.reshape(*shape, self.size)

    def room(
        self, points: np.ndarray, there: np.ndarray, drift: np.ndarray, before: np.ndarray
    ) -> np.ndarray:
        """Return (n, cycles of a tree) how far points stay clear of the robot in each, m, at most `MOST`.

        Args:
            points, drift: (n, p, d) m, float32.
            there: (n, p) whether something is at the point.
            before: (n,) the past.
        """
        n, d = len(points), points.shape[-1]
        away2 = np.einsum("npd,npd->np", points, points)
        moved2 = np.einsum("npd,npd->np", drift, drift)
        robot, point = np.nonzero(
            there & (away2 < (self._reach + self._horizon * np.sqrt(moved2)) ** 2)
        )
        offsets = np.zeros(n + 1, np.int32)
        np.cumsum(np.bincount(robot, minlength=n), out=offsets[1:])
        out = np.full((n, len(self._begun)), (MOST + self.radius) ** 2, np.float32)
        chosen = [np.ascontiguousarray(part[robot, point], np.float32) for part in (points, drift)]
        tree = np.ascontiguousarray(before, np.int32)
        ways = (len(self._begun), self._start, self._end, self._begun)
        kernel().dp_ways(d, n, offsets, *chosen, tree, *ways, out)
        return np.sqrt(np.maximum(out, 0)) - self.radius
