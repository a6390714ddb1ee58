"""The steps of a search over gaits: a cycle that moves the robot, after up to a few turns in its place."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import Ways, least_way
from defplan_mj.planning.surrogate import Motions

TURNS = 3  # cycles in place before the one that moves, at most
ALIKE = 0.2  # turns that lead to headings closer than this are one, rad


class Manoeuvres(Ways):
    """A robot that turns in its place is searched in steps of 'turn, turn, go'.

    Were each turn a step of its own, a search would lose itself among the headings of every place.
    A manoeuvre is a sequence of cycles: up to `TURNS` in place and then one that moves, or `TURNS`
    in place alone. Of sequences of turns that lead to the same heading the shortest stays. For a
    robot that moves in every cycle the manoeuvres are the gaits.

    Cycle i of the tree (a `Ways`) comes after cycle `parent[i]` (-1: at the root), and manoeuvre m
    ends with cycle `last[m]`.

    Args:
        motions: of the gaits, plain or switched.
        heading: (d,) unit vector, the robot's own, whose directions are told apart.
        before: the gait before the first one; -1: the robot is at rest.

    Attributes:
        first, final: (M,) the first and the last gait of each manoeuvre.
        cycles: (M,) how many it has.
        motions: of the M manoeuvres: where each leads.
        reach: how far it gets from its start, m.
        span: how far it may turn the heading before it moves, rad.
    """

    def __init__(self, motions: Motions, heading: np.ndarray, before: int = -1) -> None:
        motions = motions.switched()
        d = motions.translations.shape[-1]
        starts, ends, frames, self.levels = [], [], [], []
        parents: list[int] = []
        firsts: list[int] = []
        depths: list[int] = []
        gaits: list[int] = []
        last: list[int] = []
        known = heading[None]
        roots = [(-1, np.zeros(d), np.eye(d), -1)]  # cycle, place, frame, first gait
        # one that moves the robot does so whatever was before: the steps stay the same ones
        ways = np.linalg.norm(motions.translations, axis=2).mean(0)
        moves = ways >= least_way(ways)
        for depth in range(1, TURNS + 2):
            level, following = len(parents), []
            for parent, place, frame, begun in roots:
                after = motions.of(gaits[parent] if parent >= 0 else before)
                places, turns = after.after(place[None], frame[None])
                for gait, (there, turned) in enumerate(zip(places, turns, strict=True)):
                    if not moves[gait]:
                        if depth > TURNS or (known @ (turned @ heading)).max() > np.cos(ALIKE):
                            continue
                        known = np.vstack([known, turned @ heading])
                    first = gait if begun < 0 else begun
                    index = len(parents)
                    starts.append(place)
                    ends.append(there)
                    frames.append(turned)
                    parents.append(parent)
                    firsts.append(first)
                    gaits.append(gait)
                    depths.append(depth)
                    if not moves[gait]:
                        following.append((index, there, turned, first))
                    if moves[gait] or depth == TURNS:
                        last.append(index)
            self.levels.append(slice(level, len(parents)))
            roots = following
        super().__init__(np.array(starts), np.array(ends))
        self.span = float(np.arccos(np.clip(known @ heading, -1, 1)).max())
        self.last, self.parent = np.array(last), np.array(parents)
        self.first, self.final = np.array(firsts)[last], np.array(gaits)[last]
        self.cycles = np.array(depths)[last]
        self.motions = Motions(np.array(frames)[last], np.array(ends)[last])
        self.reach = float(np.linalg.norm(np.array(ends), axis=1).max())

    def free(self, cycles: np.ndarray) -> np.ndarray:
        """Return (n, M) which manoeuvres are free if `cycles` (n, cycles) says it of their cycles."""
        whole = cycles.copy()
        for level in self.levels[1:]:
            whole[:, level] &= whole[:, self.parent[level]]
        return whole[:, self.last]
