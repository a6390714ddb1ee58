"""The steps of a search over gaits: a cycle that moves the robot, after up to a few turns in its place."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import Ways, least_way
from defplan_mj.planning.past import Past, past_of
from defplan_mj.planning.surrogate import Motions

TURNS = 3  # cycles in place before the one that moves, at most
ALIKE = 0.2  # turns that lead to headings closer than this are one, rad


class Manoeuvres(Ways):
    """A robot that turns in its place is searched in steps of 'turn, turn, go'.

    Were each turn a step of its own, a search would lose itself among the headings of every place.
    A manoeuvre is a sequence of cycles: up to `TURNS` in place and then one that moves, or `TURNS`
    in place alone. Of sequences of turns that lead to the same heading the shortest stays. For a
    robot that moves in every cycle the manoeuvres are the gaits. Where the gait may be switched within a
    cycle, the first one is kept until that ends: all others are of whole cycles.

    Cycle i of the tree (a `Ways`) comes after cycle `parent[i]` (-1: at the root), and manoeuvre m
    ends with cycle `last[m]`; a cycle here is what a decision plays.

    Args:
        motions: of the gaits, plain or switched.
        heading: (d,) unit vector, the robot's own, whose directions are told apart.
        before: the past (`planning.past`) at the start; -1: the robot is at rest.
        pasts: that the motions are by; None: the gait before.

    Attributes:
        first, final: (M,) the first gait of each manoeuvre, and the past after it.
        cycles: (M,) how many gait cycles it takes.
        motions: of the M manoeuvres: where each leads.
        reach: how far it gets from its start, m.
        span: how far it may turn the heading before it moves, rad.
    """

    def __init__(
        self,
        motions: Motions,
        heading: np.ndarray,
        before: int = -1,
        pasts: Past | None = None,
    ) -> None:
        motions = motions.switched()
        _, k, d = motions.translations.shape
        pasts = past_of(k) if pasts is None else pasts
        starts, ends, frames, self.levels = [], [], [], []
        parents: list[int] = []
        firsts: list[int] = []
        spent: list[float] = []
        afters: list[int] = []
        last: list[int] = []
        known, gaits = heading[None], np.arange(k)
        # parent, place, frame, first gait, past
        roots = [(-1, np.zeros((1, d)), np.eye(d)[None], -1, before)]
        # one that moves the robot does so whatever was before: the steps stay the same ones
        ways = np.linalg.norm(motions.translations, axis=2).mean(0)
        moves = ways >= least_way(ways, pasts.decisions)
        done, hold = 0, pasts.decisions - int(pasts.phase[before])
        for depth in range(1, TURNS + 2):
            taken, following = [], []
            for parent, place, frame, begun, past in roots:
                way, pasts_now = [(place.repeat(k, 0), frame.repeat(k, 0))], np.full(k, past)
                for _ in range(hold):
                    way.append(motions.of((pasts_now, gaits)).after(*way[-1]))
                    pasts_now = pasts.then[pasts_now, gaits]
                for gait, turned in enumerate(way[-1][1]):
                    if not moves[gait]:
                        if depth > TURNS or (known @ (turned @ heading)).max() > np.cos(ALIKE):
                            continue
                        known = np.vstack([known, turned @ heading])
                    first = gait if begun < 0 else begun
                    taken.append((parent, gait, first, int(pasts_now[gait]), way))
            above = [parent for parent, *_ in taken]
            for part in range(hold):
                level = len(parents)
                for i, (_, gait, first, past, way) in enumerate(taken):
                    starts.append(way[part][0][gait])
                    ends.append(way[part + 1][0][gait])
                    frames.append(way[part + 1][1][gait])
                    parents.append(above[i])
                    firsts.append(first)
                    afters.append(past)
                    spent.append((done + part + 1) / pasts.decisions)
                    above[i] = level + i
                self.levels.append(slice(level, len(parents)))
            for index, (_, gait, first, past, way) in zip(above, taken, strict=True):
                if not moves[gait]:
                    there, turned = (part[gait][None] for part in way[-1])
                    following.append((index, there, turned, first, past))
                if moves[gait] or depth == TURNS:
                    last.append(index)
            roots, done, hold = following, done + hold, pasts.decisions
        super().__init__(np.array(starts), np.array(ends), decisions=pasts.decisions)
        self.span = float(np.arccos(np.clip(known @ heading, -1, 1)).max())
        self.last, self.parent = np.array(last), np.array(parents)
        self.first, self.final = np.array(firsts)[last], np.array(afters)[last]
        self.cycles = np.array(spent)[last]
        self.motions = Motions(np.array(frames)[last], np.array(ends)[last])
        self.reach = float(np.linalg.norm(np.array(ends), axis=1).max())

    def free(self, cycles: np.ndarray) -> np.ndarray:
        """Return (n, M) which manoeuvres are free if `cycles` (n, cycles) says it of their cycles."""
        whole = cycles.copy()
        for level in self.levels[1:]:
            whole[:, level] &= whole[:, self.parent[level]]
        return whole[:, self.last]
