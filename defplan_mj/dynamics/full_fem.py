"""f, the full finite-element dynamics on all vertices; the truth for tests.

In rotation-strain coordinates S - I (F = R S the polar decomposition of a tetrahedron's deformation
gradient) is the linear strain of the shape q. So the reduced step's energies 1/2 q^T K q and
k_c/2 (q - u)^T K (q - u) are

    V(p; u) = sum_e V_e [psi(S_e - I) + k_c psi(S_e - I - strain_e(u))],  psi(E) = mu |E|^2 + lambda/2 tr(E)^2,

without its kinematic restriction: corotational linear elasticity, and a pull towards the target shape in each
tetrahedron's own rotated frame. Two integrators:

variational (the default): the interval from p_a to p_b, h seconds, has the discrete Lagrangian
sum_v m_v |p_b - p_a|^2 / 2h - h V(m; u), m = (p_a + p_b)/2, u the target's mean over the interval, and its
forces act half on each end, which gives

    M (p2 - 2 p1 + p0)/h^2 + 1/2 [V'(m01; u01) + V'(m12; u12)] + (1 + k_c) K sum_i s_i p_i + beta K v1
        - F(v1) - contact - lift = 0,     K = W^T C W,  W = dS/dF at p1,  v1 = sum_i w_i p_i / h.

V' has no torque around m and K none around p1, so linear and angular momentum are kept exactly (discrete Noether
theorem), whatever the targets do. The weights s_i and those of the velocity v1 are given below: without them a
full mesh, which has modes and thin fins far faster than h, swings from step to step and the swing grows.
Damping and drag are whole at p1, with its areas. Contact is whole at p2, with the velocity (p2 - p1)/h. So but for
the contact all of it is the derivative of a function of m12, which the solution minimises.

implicit-euler: p2 minimises sum_v m_v |p2 - 2 p1 + p0|^2 / 2h^2 + V(p2; u) + beta/h psi(S2 - S1), drag, contact
and lift, all at p2 and with the velocity (p2 - p1)/h.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.corotational import polar
from defplan_mj.body.elasticity import lame
from defplan_mj.body.elements import Elements
from defplan_mj.body.model import Body
from defplan_mj.body.reduction import exact_shapes_of
from defplan_mj.dynamics.fem_contact import FemContact
from defplan_mj.dynamics.fem_step import Drag, Step, Touch, Viscosity, minimise
from defplan_mj.dynamics.terrain import Terrain

_Problem = tuple[Step, np.ndarray, Callable[[np.ndarray], np.ndarray]]
INTEGRATORS = ("variational", "implicit-euler")
_STANDARD_GRAVITY = 9.81

# Weights of p2, p1, p0 and the one before. The intervals' elastic forces alone are those of the mean of two
# middles, (1, 2, 1, 0)/4, which at high frequencies lets each second step swing for ever. _SMOOTH adds what makes
# them (z + 0.8)^2 (z + 0.125)/3.645, still second order: there a swing loses 20% a substep.
_ROOT, _LESS = 0.8, 0.125
_SMOOTH = np.poly([-_ROOT, -_ROOT, -_LESS]) / np.polyval([1.0, _ROOT], 1.0) ** 2 / (1.0 + _LESS)
_SMOOTH = _SMOOTH - np.array([0.25, 0.5, 0.25, 0.0])
# Of the velocity at p1 times h that damping and drag see: central, and a third difference for the same reason.
_VELOCITY = np.array([0.5, 0.0, -0.5, 0.0]) + 0.05 * np.array([1.0, -3.0, 3.0, -1.0])


@dataclass(frozen=True, eq=False)
class FemState:
    """A state of the full dynamics.

    Attributes:
        now, before: (n, 3) vertices, one substep apart, m.
        target: (r,) the last target shape, where the next ramp starts; None: no control stiffness.
        pull: (r,) the mean target of the last substep.
        earlier: (n, 3) vertices one substep before `before`, m.
    """

    now: np.ndarray
    before: np.ndarray
    target: np.ndarray | None
    pull: np.ndarray | None
    earlier: np.ndarray


@dataclass(frozen=True)
class StepInfo:
    """How the solves of a step went: Newton iterations of all substeps, and the largest last one, m."""

    iterations: int
    residual: float


class FullFem:
    """The full dynamics of a body; a state is a `FemState`."""

    def __init__(
        self,
        body: Body,
        timestep: float = 0.04,
        drag: bool = True,
        terrain: Terrain | None = None,
        integrator: str = "variational",
        substeps: int = 4,
        tolerance: float = 1e-6,
        max_newton: int = 60,
    ) -> None:
        """Prepare the constant parts.

        Args:
            timestep: of a control step, s.
            drag: whether the medium acts.
            terrain: what the surface touches, by the reduced step's law of contact.
            integrator: 'variational' or 'implicit-euler'.
            substeps: in a control step.
            tolerance: largest last Newton step, m.

        Raises:
            DefplanError: an option cannot be.
        """
        if integrator not in INTEGRATORS:
            raise DefplanError(
                f"the integrator is '{integrator}': it can be {' or '.join(INTEGRATORS)}"
            )
        if not 0.0 < timestep < np.inf or not substeps >= 1:
            raise DefplanError(
                f"the time step is {timestep} s in {substeps} substeps: both must be positive"
            )
        self.body, self.timestep, self.drag = body, timestep, drag
        self.integrator, self.substeps, self.h = integrator, substeps, timestep / substeps
        self.contact = None if terrain is None else FemContact(terrain, body)
        self.tolerance, self.max_newton = tolerance, max_newton
        self.shapes = exact_shapes_of(body)
        self.elements = Elements(self.shapes.mesh, *lame(body.mesh_material))
        self._lift = np.zeros_like(body.vertices)  # N
        if drag or terrain is not None:
            # weights with sum_v w_v X_v = z: they read the body's z axis off its vertices
            second = np.einsum("v,vi,vj->ij", body.vertex_mass, body.vertices, body.vertices)
            moment = body.vertex_mass * (body.vertices @ np.linalg.inv(second)[:, 2])
            righting = body.mass * _STANDARD_GRAVITY * body.medium.righting_height * moment
            self._lift[:, 2] = righting + body.vertex_mass * body.medium.gravity

    def at(
        self,
        shape: np.ndarray,
        position: np.ndarray | None = None,
        rotation: np.ndarray | None = None,
        velocity: np.ndarray | None = None,
        target: np.ndarray | None = None,
    ) -> FemState:
        """Return the state of the reduced body's shape.

        Args:
            shape: (r,) q.
            position: (3,) of the centre of mass, m; the origin if not given.
            rotation: (3, 3) of the body; none if not given.
            velocity: (3,) or (n, 3) m/s; at rest if not given.
            target: (r,) the last target; `shape` if not given.
        """
        shape = self._checked(shape, "shape")
        x = self.body.vertices + self.shapes.displacement(shape)[0]
        if rotation is not None:
            x = x @ np.asarray(rotation, float).T
        if position is not None:
            x = x + np.asarray(position, float)
        before = x if velocity is None else x - self.h * np.asarray(velocity, float)
        earlier = 2.0 * before - x
        target = shape if target is None else self._checked(target, "target shape")
        return FemState(x, before, target, target, earlier)

    def rest(self) -> FemState:
        """Return the state at rest, in the rest shape at the origin."""
        return self.at(np.zeros(self.body.n_modes))

    def _checked(self, shape: np.ndarray, name: str) -> np.ndarray:
        shape, expected = np.asarray(shape, float), (self.body.n_modes,)
        if shape.shape != expected:
            raise DefplanError(f"the {name} has shape {shape.shape}, wanted {expected}")
        if not np.isfinite(shape).all():
            raise DefplanError(f"the {name} has an entry that is not finite")
        return shape

    def step(self, state: FemState, target: np.ndarray | None = None) -> FemState:
        """Return the state one control step later.

        Args:
            target: (r,) target shape, reached on a ramp over the control step; None lets the control
                stiffness go, too.

        Raises:
            DefplanError: the target is of the wrong size, or the solve did not converge.
        """
        return self.step_info(state, target)[0]

    def step_info(
        self, state: FemState, target: np.ndarray | None = None
    ) -> tuple[FemState, StepInfo]:
        """Return the state after a step, see `step`, and how its solves went."""
        count, largest, n = 0, 0.0, self.substeps
        target = None if target is None else self._checked(target, "target shape")
        start = state.target if state.target is not None else target
        for j in range(1, n + 1):
            pull = None
            if target is not None and start is not None:
                # implicit Euler's interval is its end
                share = (j - 0.5 if self.integrator == "variational" else j) / n
                pull = start + share * (target - start)
            state, iterations, size = self._substep(replace(state, target=target), pull)
            count, largest = count + iterations, max(largest, size)
        return state, StepInfo(count, largest)

    def rollout(self, state: FemState, targets: np.ndarray) -> list[FemState]:
        """Return the N + 1 states from `state` on under target shapes (N, r)."""
        states = [state]
        for target in targets:
            states.append(self.step(states[-1], target))
        return states

    def _substep(self, state: FemState, pull: np.ndarray | None) -> tuple[FemState, int, float]:
        step, start, end = self.problem(state, pull)
        x, count, size = minimise(step, start, self.tolerance, self.max_newton)
        return FemState(end(x), state.now, state.target, pull, state.before), count, size

    def problem(self, state: FemState, pull: np.ndarray | None) -> _Problem:
        """Return what a substep minimises, where it starts, and the vertices p2 of a solution.

        Args:
            pull: (r,) mean target of the substep (implicit Euler: at its end), or None.
        """
        variational = self.integrator == "variational"
        make = self._variational if variational else self._implicit_euler
        step, start, end = make(state, pull)
        if self.contact is not None:
            touch = Touch(self.contact, state.now, self.h, 2.0 if variational else 1.0)
            step = replace(step, contact=touch)
        return step, start, end

    def _variational(self, state: FemState, pull: np.ndarray | None) -> _Problem:
        """Return the function of m12 to minimise, twice the equation's, a start, and p2 of m12."""
        now, before, h, fem = state.now, state.before, self.h, self.elements
        earlier = state.earlier
        linear = self._interval_force(before, now, state.pull) - 2.0 * self._lift
        control, rest = self._centre(pull)
        stiff = (1.0 + control) * _SMOOTH + self.body.material.damping / h * _VELOCITY
        friction = Viscosity(fem, now, _origin(stiff, now, before, earlier), 4.0 * stiff[0])
        drag = None
        if self.drag:
            centre, _ = fem.triangles(_origin(_VELOCITY, now, before, earlier))
            _, area = fem.triangles(now)
            drag = Drag(fem, self.body.medium, centre, area, 0.5 * h / _VELOCITY[0], 2.0)
        step = Step(
            fem,
            inertia=4.0 * self.body.vertex_mass / h**2,
            guess=now + 0.5 * (now - before),
            linear=linear,
            weight=1.0 + control,
            centre=rest,
            friction=friction,
            drag=drag,
        )
        # Newton's method starts with the acceleration of the last substep
        x = step.guess + 0.5 * (now - 2.0 * before + earlier)
        return step, x, lambda m: 2.0 * m - now

    def _implicit_euler(self, state: FemState, pull: np.ndarray | None) -> _Problem:
        """Return the function of p2 to minimise, a start, and p2 of the solution."""
        now, before, h, fem = state.now, state.before, self.h, self.elements
        control, rest = self._centre(pull)
        weight, damping = 1.0 + control, self.body.material.damping / h
        last = polar(fem.deformation(now)).stretch
        mean = (weight * rest + damping * last) / (weight + damping)
        guess = 2.0 * now - before
        step = Step(
            fem,
            inertia=self.body.vertex_mass / h**2,
            guess=guess,
            linear=-self._lift,
            weight=weight + damping,
            centre=mean,
            drag=Drag(fem, self.body.medium, *fem.triangles(now), h) if self.drag else None,
        )
        x = guess + now - 2.0 * before + state.earlier
        return step, x, lambda p2: p2

    def _centre(self, pull: np.ndarray | None) -> tuple[float, np.ndarray]:
        """Return k_c, and the mean (3, 3, t) of the rest strain and the target's, plus I."""
        one = np.eye(3)[:, :, None]
        if pull is None:
            return 0.0, one
        control = self.body.material.control_stiffness
        return control, one + control / (1.0 + control) * self.shapes.strain(pull)

    def _interval_force(
        self, before: np.ndarray, now: np.ndarray, pull: np.ndarray | None
    ) -> np.ndarray:
        """Return V'(m) (n, 3), N, of the interval from `before` to `now`."""
        fem = self.elements
        parts = polar(fem.deformation(0.5 * (before + now)))
        control, rest = self._centre(pull)
        strain = (1.0 + control) * (parts.stretch - rest)
        return fem.elastic_forces(parts, strain)

    def energy(self, state: FemState) -> dict[str, float | np.ndarray]:
        """Return kinetic, elastic and potential energy (J), linear and angular momentum of a state.

        The variational step's are those of its last interval: the elastic energy in its middle, and the
        angular momentum that it keeps, sum m x M v - h^2/4 sum v x V'.
        """
        mass, now, before = self.body.vertex_mass, state.now, state.before
        velocity = (now - before) / self.h
        moment = np.cross(now, mass[:, None] * velocity)
        place = now
        if self.integrator == "variational":
            place = 0.5 * (now + before)
            force = self._interval_force(before, now, state.pull)
            moment = moment - 0.25 * self.h**2 * np.cross(velocity, force)
        fem = self.elements
        strain = polar(fem.deformation(place)).stretch - np.eye(3)[:, :, None]
        return {
            "kinetic": 0.5 * float(mass @ (velocity**2).sum(1)),
            "elastic": fem.energy(strain),
            "potential": -float((self._lift * place).sum()),
            "momentum": mass @ velocity,
            "angular_momentum": moment.sum(0),
        }


def _origin(
    weights: np.ndarray, now: np.ndarray, before: np.ndarray, earlier: np.ndarray
) -> np.ndarray:
    """Return o (n, 3) with sum_i w_i p_i = 2 w_0 (m12 - o)."""
    first, second, third, fourth = weights
    return ((first - second) * now - third * before - fourth * earlier) / (2.0 * first)
