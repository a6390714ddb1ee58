"""All gait sequences of a given depth on the surrogate, and how close they pass to points."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.surrogate import Motions

IN_PLACE = 0.2
"""A cycle that moves the centre of mass by less than this turns the robot in its place, m."""


class Ways:
    """Straight ways of cycles, and how close they pass to points.

    Args:
        start, end: (cycles, d) m.

    Attributes:
        start, end: as given, float32.
        in_place: (cycles,) whether a cycle hardly moves the robot.
    """

    def __init__(self, start: np.ndarray, end: np.ndarray) -> None:
        self.start, self.end = start.astype(np.float32), end.astype(np.float32)
        edge = self.end - self.start
        self._edge, self._length2 = edge, np.maximum((edge * edge).sum(1), 1e-12)
        self._start_edge = (self.start * edge).sum(1)
        self._start2 = (self.start * self.start).sum(1)
        self.in_place = self._length2 < IN_PLACE**2

    def distances2(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return squared distances (p, cycles) of points to each cycle's start, end and way.

        Args:
            points: (p, d) m.
        """
        points = np.asarray(points, np.float32)
        from_start = (points * points).sum(1)[:, None] - 2 * (points @ self.start.T) + self._start2
        along = points @ self._edge.T - self._start_edge
        from_end = from_start - 2 * along + self._length2
        share = np.clip(along / self._length2, 0, 1)
        from_way = from_start + share * (share * self._length2 - 2 * along)
        return from_start, from_end, from_way


class MotionTree(Ways):
    """The tree of the K + K^2 + ... + K^depth cycles that follow on each other from one pose.

    Level d (1 to depth) holds K^d cycles; the children of cycle i are K i .. K i + K - 1 of the
    next level, so the first gait of cycle i of level d is i // K^(d - 1). The tree is computed
    once, in the frame of its root: a decision only measures distances.

    Args:
        motions: of the gaits.
        depth: cycles in a sequence.

    Attributes:
        end_frames: (cycles, d, d) how the robot is turned at the end of each cycle.
    """

    def __init__(self, motions: Motions, depth: int) -> None:
        self.gaits, self.depth = len(motions.translations), depth
        starts, ends, end_frames = [], [], []
        d = motions.translations.shape[1]
        position, frames = np.zeros((1, d)), np.eye(d)[None]
        for _ in range(depth):
            position, frames = position.repeat(self.gaits, 0), frames.repeat(self.gaits, 0)
            gait = np.arange(len(position)) % self.gaits
            starts.append(position)
            position, frames = motions.of(gait).after(position, frames)
            ends.append(position)
            end_frames.append(frames)
        super().__init__(np.concatenate(starts), np.concatenate(ends))
        self.end_frames = np.concatenate(end_frames).astype(np.float32)

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
