"""A* in place and time over the surrogate's cycles, among balls that move: the search is kernel/search.c."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from defplan_mj.kernel.library import SearchProblem, kernel
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.tracking import Balls
from defplan_mj.task import Navigation
from defplan_solvers.search.outlook import Outlook

CELL, HEADING = 0.3, 0.3  # poses closer than this count as one, m and (of a unit vector) 1
SINGLE = 256  # beginnings of a way, within the cycle that it begins in, that are told apart at most
ENOUGH = 15  # cycles: if there is no way, one that is safe for so long is as good as any


class SpaceTime:
    """Searches of one robot.

    Where the gait may be switched within a cycle, a way does so until its first cycle ends, then at the
    end of each: it is searched anew at every decision.

    Args:
        surrogate: f_fit, with the motions by the gait before.
        navigation: for the space and the goal.
        weight: of the estimate of what is left: more is faster, less is shorter.
        nodes: that a search makes at most.
    """

    def __init__(
        self, surrogate: Surrogate, navigation: Navigation, weight: float = 1.2, nodes: int = 50_000
    ) -> None:
        motions = surrogate.switched_motions(navigation.space)
        self.outlook = Outlook(surrogate.cycle_motions(navigation.space), navigation.goal_radius)
        self.rotations, self.translations, self.axes = (
            np.ascontiguousarray(part, float) for part in (*motions, self.outlook.axes_at)
        )
        self.past, self.gaits = surrogate.past, surrogate.gaits
        self.then, self.phase = (
            np.ascontiguousarray(table, np.int32) for table in (self.past.then, self.past.phase)
        )
        self.radius, self.d = surrogate.radius, navigation.dimension
        self.cycles = navigation.max_cycles * self.past.decisions
        self.weight, self.nodes = weight, nodes

    def way(
        self,
        balls: Balls,
        target: np.ndarray,
        before: int,
        margin: float,
        horizon: float = float("inf"),
    ) -> tuple[np.ndarray, bool]:
        """Return the gaits of a way, and whether it leads to the target (else: nearest to it).

        Args:
            balls: the obstacles, in the robot's frame.
            target: (d,) m, likewise.
            before: the past (`planning.past`).
            margin: that the robot's ball keeps, m; where there is less already, it may gain some.
            horizon: a way that gets this far from the robot is good enough, m.
        """
        kernel_ = kernel()
        wide = np.concatenate(
            [balls.centres, balls.radii[:, None] + self.radius, balls.drift], axis=1
        )
        wide, target = np.ascontiguousarray(wide, float), np.ascontiguousarray(target, float)
        arrays = {
            "rotations": self.rotations,
            "translations": self.translations,
            "target": target,
            "balls": wide,
            "axes": self.axes,
            "then": self.then,
            "phase": self.phase,
        }
        problem = SearchProblem(
            d=self.d,
            n_gaits=self.gaits,
            before=before,
            n_balls=len(wide),
            n_axes=self.axes.shape[1],
            decisions=self.past.decisions,
            single=self._single(before),
            nodes=self.nodes,
            cycles=self.cycles,
            enough=ENOUGH * self.past.decisions,
            goal_radius=self.outlook.goal_radius,
            margin=margin,
            weight=self.weight,
            cell=CELL,
            heading=HEADING,
            advance=self.outlook.advance,
            per_radian=self.outlook.per_radian,
            horizon=horizon,
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        memory = np.empty(kernel_.dp_search_size(self.nodes), np.uint8)
        plan = np.zeros(self.cycles, np.int32)
        length = kernel_.dp_search(ctypes.byref(problem), memory.ctypes.data, plan)
        return plan[: abs(length)], length > 0

    def _single(self, before: int) -> int:
        """Return how many of the first decisions are made one by one; later ones are for whole cycles."""
        left = self.past.decisions - int(self.past.phase[before])
        return max(n for n in range(1, left + 1) if n == 1 or self.gaits**n <= SINGLE)

    def first_gait(
        self, balls: Balls, target: np.ndarray, before: int, margins: Sequence[float]
    ) -> int | None:
        """Return the first gait of a way that keeps the largest of `margins` that it can; None: there is none.

        If no margin leaves a way to the target, the longest of those that lead nearer counts.
        """
        best = np.zeros(0, np.int32)
        for margin in margins:
            way, arrives = self.way(balls, target, before, margin)
            if arrives:
                return int(way[0])
            if len(way) > len(best):
                best = way
        return int(best[0]) if len(best) else None

    def values(
        self, balls: Balls, target: np.ndarray, before: int, margins: tuple[float, ...]
    ) -> np.ndarray:
        """Return (K,) minus the cycles that are left after each gait, the way's first gait first.

        Args:
            balls, target, before, margins: see `first_gait`.
        """
        values = -self.outlook.after_each(target, int(self.past.phase[before]))
        gait = self.first_gait(balls, target, before, margins)
        if gait is not None:
            values[gait] = values.max() + 1
        return values
