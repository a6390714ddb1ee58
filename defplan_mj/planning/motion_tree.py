"""All gait sequences of a given depth on the surrogate, and how close they pass to points."""

from __future__ import annotations

import numpy as np


class MotionTree:
    """The tree of the K + K^2 + ... + K^depth cycles that follow on each other from one pose.

    Level d (1 to depth) holds K^d cycles; the children of cycle i are K i .. K i + K - 1 of the
    next level, so the first gait of cycle i of level d is i // K^(d - 1). The tree is computed
    once, in the yaw frame of its root: a decision only measures distances.

    Args:
        motions: (K, 3) forward and left displacement (m) and yaw (rad) of each gait.
        depth: cycles in a sequence.
    """

    def __init__(self, motions: np.ndarray, depth: int) -> None:
        self.gaits, self.depth = len(motions), depth
        starts, ends, end_yaws = [], [], []
        position, yaw = np.zeros((1, 2)), np.zeros(1)
        for _ in range(depth):
            position, yaw = position.repeat(self.gaits, 0), yaw.repeat(self.gaits)
            gait = np.arange(len(yaw)) % self.gaits
            cosine, sine = np.cos(yaw), np.sin(yaw)
            x, y = motions[gait, 0], motions[gait, 1]
            starts.append(position)
            position = position + np.column_stack([cosine * x - sine * y, sine * x + cosine * y])
            yaw = yaw + motions[gait, 2]
            ends.append(position)
            end_yaws.append(yaw)
        self.start = np.concatenate(starts).astype(np.float32)
        self.end = np.concatenate(ends).astype(np.float32)
        self.end_yaw = np.concatenate(end_yaws).astype(np.float32)
        edge = self.end - self.start
        self._edge, self._length2 = edge, np.maximum((edge * edge).sum(1), 1e-12)
        self._start_edge = (self.start * edge).sum(1)
        self._start2 = (self.start * self.start).sum(1)

    def distances2(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return squared distances (p, cycles) of points to each cycle's start, end and way.

        Args:
            points: (p, 2) m, in the root's yaw frame.
        """
        points = np.asarray(points, np.float32)
        from_start = (points * points).sum(1)[:, None] - 2 * (points @ self.start.T) + self._start2
        along = points @ self._edge.T - self._start_edge
        from_end = from_start - 2 * along + self._length2
        share = np.clip(along / self._length2, 0, 1)
        from_way = from_start + share * (share * self._length2 - 2 * along)
        return from_start, from_end, from_way

    def first_gaits(self, free: np.ndarray, depth: int | None = None) -> np.ndarray:
        """Return (K,) whether a gait starts a sequence of `depth` cycles that are all free.

        Args:
            free: (cycles,) whether each cycle of the tree may be used.
        """
        depth = self.depth if depth is None else depth
        alive, offset = np.ones(1, bool), 0
        for level in range(1, depth + 1):
            count = self.gaits**level
            alive = alive.repeat(self.gaits) & free[offset : offset + count]
            offset += count
        return np.any(alive.reshape(self.gaits, -1), axis=1)
