"""How far a walker's loaded contacts slide, in CasADi: the work that friction takes, as a cost."""

from __future__ import annotations

import casadi as ca
import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.feet import MAX_FEET, Feet
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import contact_law
from defplan_mj.gait.footing import SOLE
from defplan_mj.kernel.contact_points import contact_points


class Sliding:
    """How far the loaded soles of a body slide on level ground z = 0, as a CasADi expression."""

    def __init__(self, dynamics: ReducedDynamics):
        """Take dynamics with level ground.

        Raises:
            DefplanError: the ground is not level.
        """
        body, world = dynamics.body, dynamics.world
        if not world.level:
            raise DefplanError("gaits that are not to slide are optimised on level ground")
        points = contact_points(body)
        height = body.vertices[body.surface[points], 2]
        low = body.surface[points[height < height.min() + SOLE * np.ptp(body.vertices[:, 2])]]
        groups = [low[i : i + MAX_FEET] for i in range(0, len(low), MAX_FEET)]
        feet = [Feet(tuple(group[:, None])) for group in groups]
        self._places = [CasadiDynamics(dynamics.with_feet(some)).feet for some in feet]
        weight = body.mass * abs(body.medium.gravity)
        law = contact_law(world.ground, body)
        before, after = ca.SX.sym("before", 3), ca.SX.sym("after", 3)
        load = law.stiffness * ca.fmax(0, law.thickness - after[2]) ** 2 / weight
        moved = ca.sumsqr((after - before)[:2])
        path = load * moved / ca.sqrt(moved + (law.slip_speed * dynamics.timestep) ** 2)
        self._path = ca.Function("path", [before, after], [path])

    def path(self, x: ca.MX) -> ca.MX:
        """Return how far they slide along states x (nx, steps + 1), m.

        It is the work of friction over mu times the weight: each contact's path counts as its share
        of the weight, and less where friction holds it below its limit (slower than `slip_speed`).
        """
        total, steps = 0, x.shape[1] - 1
        for place in self._places:
            count = place.size2_out(0) * steps
            places = place.map(steps + 1)(x)
            total += ca.sum2(self._path.map(count)(places[:, :count], places[:, -count:]))
        return total
