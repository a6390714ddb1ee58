"""A* over manoeuvres among points that stand still: the search is kernel/astar.c."""

from __future__ import annotations

import ctypes

import numpy as np

from defplan_mj.kernel.library import AstarProblem, kernel
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation
from defplan_solvers.search.manoeuvres import Manoeuvres
from defplan_solvers.search.outlook import Outlook

NODES = 10000  # of one search
CELL, HEADING = 0.45, 0.3  # poses closer than this count as one, m and (of a unit vector) 1
WEIGHT = 1.2  # of the estimate: more is faster, less is shorter


class ManoeuvreSearch:
    """Searches of one robot.

    Args:
        surrogate: f_fit.
        navigation: for the space and the goal.

    Attributes:
        outlook: estimates what is left.
        steps: of the search, after each past (`planning.past`), and last those from rest.
        alike: headings closer than this count as one: what one manoeuvre reaches anyway.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.outlook = Outlook(surrogate.cycle_motions(navigation.space), navigation.goal_radius)
        motions, heading = surrogate.switched_motions(navigation.space), self.outlook.axes[0]
        past = surrogate.past
        self.steps = [Manoeuvres(motions, heading, i, past) for i in range(past.rest + 1)]
        self.alike = max(HEADING, max(after.span for after in self.steps))
        self._arrays = self._packed()

    def _packed(self) -> dict[str, np.ndarray]:
        """Return what the kernel's search takes of the robot, one set of steps after the other."""
        sets = self.steps
        numbers = {
            "reach": [np.array([after.reach]) for after in sets],
            "starts": [after.start for after in sets],
            "ends": [after.end for after in sets],
            "rotations": [after.motions.rotations for after in sets],
            "translations": [after.motions.translations for after in sets],
            "cycles": [after.cycles for after in sets],
            "axes": [self.outlook.axes],
        }
        indices = {
            "ways_at": [np.cumsum([0, *(len(after.start) for after in sets)])],
            "steps_at": [np.cumsum([0, *(len(after.first) for after in sets)])],
            "parents": [after.parent for after in sets],
            "in_place": [after.in_place for after in sets],
            "ends_with": [after.last for after in sets],
            "firsts": [after.first for after in sets],
            "finals": [after.final for after in sets],
        }
        return {
            name: np.ascontiguousarray(np.concatenate(parts), kind)
            for kind, named in ((np.float64, numbers), (np.int32, indices))
            for name, parts in named.items()
        }

    def first_gait(
        self,
        points: np.ndarray,
        clearance: float,
        least: float,
        target: np.ndarray,
        before: int,
        horizon: float,
    ) -> int | None:
        """Return the first gait of a short way to the target, or else of what comes nearest; None: there is none.

        Args:
            points: (p, d) what to keep away from, m, in the robot's frame.
            clearance: that cycles keep, m; where there is less already, cycles may gain some, or
                turn the robot in its place.
            least: clearance that cycles keep in any case, m.
            target: (d,) m, in the robot's frame.
            before: the past (`planning.past`); -1: the robot is at rest.
            horizon: a way that gets this far is good enough, m.
        """
        given = {
            name: np.ascontiguousarray(a, float)
            for name, a in (("points", points), ("target", target))
        }
        arrays = self._arrays | given
        problem = AstarProblem(
            d=len(target),
            n_sets=len(self.steps),
            before=before % len(self.steps),
            n_points=len(points),
            n_axes=len(self.outlook.axes),
            nodes=NODES,
            goal_radius=self.outlook.goal_radius,
            clearance=clearance,
            least=least,
            weight=WEIGHT,
            cell=CELL,
            heading=self.alike,
            advance=self.outlook.advance,
            per_radian=self.outlook.per_radian,
            horizon=horizon,
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        memory = np.empty(kernel().dp_astar_size(ctypes.byref(problem)), np.uint8)
        gait = int(kernel().dp_astar(ctypes.byref(problem), memory.ctypes.data))
        return None if gait < 0 else gait
