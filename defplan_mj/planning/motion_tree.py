"""All gait sequences of a given depth on the surrogate, and how close they pass to points that may move."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.past import Past, past_of
from defplan_mj.planning.surrogate import Motions

IN_PLACE = 0.2
"""A cycle that moves the centre of mass by less than this turns the robot in its place, m."""
IN_PLACE_SHARE = 0.4
"""Of the longest way of a cycle, if that is shorter: a slow robot's steps are steps all the same."""


def least_way(lengths: np.ndarray, decisions: int = 1) -> float:
    """Return the way from which on a decision moves the robot and does not turn it in its place, m.

    Args:
        lengths: of the ways of all decisions, m.
        decisions: in a cycle.
    """
    return min(IN_PLACE / decisions, IN_PLACE_SHARE * float(lengths.max(initial=0.0)))


class Ways:
    """Straight ways of cycles, and how close they pass to points.

    Where the gait may be switched within a cycle, 'cycle' means the part of it that a decision plays.

    Args:
        start, end: (cycles, d) m.
        begun: (cycles,) how many cycles were done before each; None: none, nothing moves.
        decisions: in a gait cycle.

    Attributes:
        start, end, begun: as given, float32.
        in_place: (cycles,) whether a cycle hardly moves the robot.
    """

    def __init__(
        self,
        start: np.ndarray,
        end: np.ndarray,
        begun: np.ndarray | None = None,
        decisions: int = 1,
    ) -> None:
        self.start, self.end = start.astype(np.float32), end.astype(np.float32)
        self.begun = np.zeros(len(start), np.float32) if begun is None else begun.astype(np.float32)
        edge = self.end - self.start
        self._edge, self._length2 = edge, np.maximum((edge * edge).sum(1), 1e-12)
        self._start_edge = (self.start * edge).sum(1)
        self._start2 = (self.start * self.start).sum(1)
        self.in_place = self._length2 < least_way(np.sqrt(self._length2), decisions) ** 2

    def distances2(
        self, points: np.ndarray, drift: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return squared distances (p, cycles) of points to each cycle's start, end and way.

        Args:
            points: (p, d) m, at the root.
            drift: (p, d) how far each moves in a cycle, m; None: nothing moves.
        """
        points = np.asarray(points, np.float32)
        if drift is not None and drift.any():
            return self._moving(points, np.asarray(drift, np.float32))
        from_start = (points * points).sum(1)[:, None] - 2 * (points @ self.start.T) + self._start2
        along = points @ self._edge.T - self._start_edge
        from_end = from_start - 2 * along + self._length2
        share = np.clip(along / self._length2, 0, 1)
        from_way = from_start + share * (share * self._length2 - 2 * along)
        return from_start, from_end, from_way

    def _moving(
        self, points: np.ndarray, drift: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the same for moving points: seen from a point, the robot's way is another segment."""
        offset = points[:, None] + drift[:, None] * self.begun[:, None] - self.start
        edge = self._edge - drift[:, None]
        length2 = np.maximum(np.einsum("pcd,pcd->pc", edge, edge), 1e-12)
        along = np.einsum("pcd,pcd->pc", offset, edge)
        from_start = np.einsum("pcd,pcd->pc", offset, offset)
        from_end = from_start - 2 * along + length2
        share = np.clip(along / length2, 0, 1)
        return from_start, from_end, from_start + share * (share * length2 - 2 * along)


class MotionTree(Ways):
    """The tree of gait sequences that can follow on each other from one pose.

    At each level the robot chooses one of K gaits and keeps it for some cycles. Level l (from 1) has K^l
    branches of `holds[l - 1]` cycles each, the first cycles of all branches before their second ones;
    the children of branch i are K i .. K i + K - 1 of the next level. The tree is computed once, in the
    frame of its root: a decision only measures distances.

    Args:
        motions: of the gaits, plain or switched.
        holds: cycles of each level's choice.
        before: the past (`planning.past`) at the root; -1: the robot is at rest.
        pasts: that the motions are by; None: the gait before.

    Attributes:
        end_frames: (cycles, d, d) how the robot is turned at the end of each cycle.
    """

    def __init__(
        self,
        motions: Motions,
        holds: tuple[int, ...],
        before: int = -1,
        pasts: Past | None = None,
    ) -> None:
        motions = motions.switched()
        _, self.gaits, d = motions.translations.shape
        pasts = past_of(self.gaits) if pasts is None else pasts
        self.holds = holds
        starts, ends, end_frames, begun = [], [], [], []
        position, frames = np.zeros((1, d)), np.eye(d)[None]
        last, done = np.array([before]), 0
        for hold in holds:
            position, frames = position.repeat(self.gaits, 0), frames.repeat(self.gaits, 0)
            last = last.repeat(self.gaits)
            gait = np.arange(len(position)) % self.gaits
            for _ in range(hold):
                starts.append(position)
                position, frames = motions.of((last, gait)).after(position, frames)
                ends.append(position)
                end_frames.append(frames)
                begun.append(np.full(len(position), done))
                last, done = pasts.then[last, gait], done + 1
        start, end, done_before = (np.concatenate(part) for part in (starts, ends, begun))
        super().__init__(start, end, done_before, pasts.decisions)
        self.end_frames = np.concatenate(end_frames).astype(np.float32)

    def first_gaits(self, free: np.ndarray, depth: int | None = None) -> np.ndarray:
        """Return (K,) whether a gait starts a sequence of `depth` levels whose cycles are all free.

        Args:
            free: (cycles,) whether each cycle of the tree may be used.
        """
        return self.best_room(free, depth)

    def best_room(self, room: np.ndarray, depth: int | None = None) -> np.ndarray:
        """Return (..., K) what the narrowest cycle of the best sequence of each first gait has.

        Args:
            room: (..., cycles) of each cycle of the tree.
            depth: levels of a sequence; None: all.
        """
        best, offset = None, 0
        for level, hold in enumerate(self.holds[:depth], 1):
            count = self.gaits**level
            own = room[..., offset : offset + hold * count]
            own = own.reshape(*room.shape[:-1], hold, count).min(-2)
            best = own if best is None else np.minimum(best.repeat(self.gaits, -1), own)
            offset += hold * count
        assert best is not None
        return best.reshape(*best.shape[:-1], self.gaits, best.shape[-1] // self.gaits).max(-1)


_HOLDS = {1: (1, 2, 4), 2: (1, 1, 2, 3), 3: (1, 1, 2, 3)}


def lookahead(gaits: int) -> tuple[int, ...]:
    """Return cycles of each level of a tree that looks 6 or 7 cycles ahead, and has some hundred of them."""
    return _HOLDS.get(gaits, (1, 2, 3))


def motion_trees(
    motions: Motions, holds: tuple[int, ...], pasts: Past | None = None, whole: bool = True
) -> list[MotionTree]:
    """Return the trees after each past, the last one from rest.

    Args:
        holds: whole cycles of each level's choice, whatever the decisions in one.
        pasts: that the motions are by; None: the gait before.
        whole: the first choice is kept until its cycle ends, so that all others are of whole cycles of the gaits:
            what can follow a choice can still follow it one decision later. Else trees of all pasts
            have the same cycles, and the first choice is kept for as long as a cycle lasts.
    """
    pasts = past_of(motions.translations.shape[-2]) if pasts is None else pasts
    trees = []
    for past, phase in enumerate(pasts.phase):
        first, *others = (pasts.decisions * hold for hold in holds)
        trees.append(MotionTree(motions, (first - whole * phase, *others), past, pasts))
    return trees
