"""What contact-invariant optimisation knows of a walker: its step under foot forces, its feet, the ground."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.feet import Feet, lowest_feet
from defplan_mj.dynamics.terrain import contact_law
from defplan_mj.gait.problem import GaitProblem

_WIDE = 0.3  # of the body's length: a foot that wide can tip, and is two
_GRIP = 0.75  # share of the terrain's friction: rounded friction creeps before it slips


@dataclass(frozen=True)
class Walker:
    """A body with F feet on level ground; forces are in units of its weight.

    Attributes:
        step: (x: nx, u: r, forces: 3 x F, N) -> x_next: nx, with Jacobian.
        feet: x: nx -> (3 x F) world positions, m, with Jacobian.
        rest: (nx,) standing.
        carried: (F,) share of the weight on each foot at rest.
        give: (F,) m: how far a foot gives under the weight; it gives as the root of the force.
        timestep: s.
        weight: N.
        friction: Coulomb's coefficient that the plan may use.
        amplitude: (r,) bound of the target shape.
    """

    step: ca.Function
    feet: ca.Function
    rest: np.ndarray
    carried: np.ndarray
    give: np.ndarray
    timestep: float
    weight: float
    friction: float
    amplitude: np.ndarray

    @property
    def nx(self) -> int:
        """Size of the state."""
        return len(self.rest)

    @property
    def nu(self) -> int:
        """r, the size of the target shape."""
        return len(self.amplitude)

    @property
    def n_feet(self) -> int:
        """F."""
        return len(self.carried)

    @property
    def level(self) -> np.ndarray:
        """(F,) height of each foot that just touches the ground, m."""
        height = np.array(self.feet(self.rest)).reshape(3, -1)[2]
        return height + self.give * np.sqrt(self.carried)


def pads(body: Body) -> Feet:
    """Return the feet of a body, a wide one as the outer quarters of its two ends."""
    groups = []
    for group in lowest_feet(body).vertices:
        parts = [group]
        for axis in (0, 1):
            place = body.vertices[group, axis]
            low, width = place.min(), np.ptp(place)
            if width > _WIDE * body.length:
                ends = (group[place < low + width / 4], group[place > low + 3 * width / 4])
                parts = [np.intersect1d(part, end) for part in parts for end in ends]
        groups += parts
    return Feet(tuple(groups))


def walker_of(problem: GaitProblem) -> Walker:
    """Return the walker of a gait problem.

    Raises:
        DefplanError: its body has no level ground to walk on.
    """
    dynamics = problem.dynamics
    body, world = dynamics.body, dynamics.world
    if not world.level:
        raise DefplanError(
            "contact-invariant optimisation is for bodies that walk on level ground: take another"
            " gait solver, e.g. shooting"
        )
    feet = pads(body)
    forced = dynamics.with_feet(feet)
    symbolic, rest = CasadiDynamics(forced), dynamics.rest_state()
    contacts = dynamics.contacts(rest)
    weight = -body.mass * body.medium.gravity
    places = forced.feet_positions(rest)
    nearest = ((contacts.points[:, None] - places) ** 2).sum(2).argmin(1)
    carried = np.bincount(nearest, contacts.forces[:, 2], len(feet)) / contacts.forces[:, 2].sum()
    points = np.maximum(np.bincount(nearest, minlength=len(feet)), 1)
    stiffness = contact_law(world.ground, body).stiffness
    return Walker(
        step=symbolic.step_forced,
        feet=symbolic.feet,
        rest=rest,
        carried=carried,
        give=np.sqrt(weight / (stiffness * points)),
        timestep=dynamics.timestep,
        weight=weight,
        friction=_GRIP * world.ground.friction,
        amplitude=body.amplitude,
    )
