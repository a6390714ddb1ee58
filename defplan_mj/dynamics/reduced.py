"""The reduced dynamics: a step of c, R and q under a target shape, in compiled code."""

from __future__ import annotations

import ctypes
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.dynamics.feet import Feet, pack_feet
from defplan_mj.dynamics.terrain import Terrain, pack_terrain
from defplan_mj.dynamics.world import World
from defplan_mj.kernel.contact_points import contact_points
from defplan_mj.kernel.library import Info, Model, kernel
from defplan_mj.kernel.pack import StepOptions, pack_body, pack_options

_CALM_STEPS, _CALM_TIMESTEP = 4000, 0.2  # to settle on the terrain; s


@dataclass(frozen=True)
class Contacts:
    """What touches the terrain in a state.

    Attributes:
        points: (n, 3) world positions of the contact points that touch, m.
        forces: (n, 3) forces on the body, normal and friction, N.
        depths: (n,) how far each is below the surface, m; negative above it, within the thickness.
        which: (n,) which of the body's contact points each is (`kernel.contact_points`).
    """

    points: np.ndarray
    forces: np.ndarray
    depths: np.ndarray
    which: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """Sum of the forces (3,), N."""
        return self.forces.sum(0)


class ReducedDynamics:
    """f reduced: x_{i+1} = step(x_i, u_i); see kernel/kernel.h for the state's layout.

    A state is (13 + 3r,): position (3, m), unit quaternion (w x y z), q (r), then world velocity
    (3, m/s), angular velocity in the body frame (3, rad/s), dq/dt (r, 1/s), differences over the last
    substep, then the last target shape (r), from which the next one is reached by a ramp. All calls
    are thread-safe and release the GIL.
    """

    def __init__(
        self,
        body: Body,
        timestep: float = 0.04,
        terrain: Terrain | None = None,
        feet: Feet | None = None,
        tolerance: float = 1e-7,
        max_newton: int = 60,
        *,
        substeps: int = 2,
        integrator: str = "variational",
    ):
        """Prepare the kernel's arrays.

        Raises:
            DefplanError: something about the body, the terrain, the feet or an option makes no sense.

        Args:
            timestep: of a control step, s.
            substeps: of the integrator in a control step.
            integrator: 'variational' (momentum-conserving, second order) or 'implicit-euler'.
            terrain: what the body touches, or None.
            feet: points that take given forces: an input is then (r + 3 n_feet,), the target shape
                and a world force (N) on each foot.
        """
        self.body, self.terrain, self.feet = body, terrain, feet
        self.blob = pack_body(body)
        self.options = StepOptions(timestep, tolerance, max_newton, substeps, integrator)
        self.par = pack_options(body, self.options)
        self._lib = kernel()
        self.model = Model(
            self.blob,
            self.par,
            None if terrain is None else pack_terrain(terrain, body),
            None if feet is None else pack_feet(feet, body),
        )
        if code := self._lib.dp_check_model(self.model):
            raise DefplanError(
                f"the kernel does not take the body {body.name} with this medium, material, terrain and"
                f" feet (code {code}): a number of them is not finite, or defplan has to be reinstalled"
            )
        self._rest: np.ndarray | None = None

    def __reduce__(self) -> tuple:
        """Pickle as the body and the options; the kernel's arrays are laid out anew."""
        return _restore, (self.body, self.terrain, self.feet, self.options)

    @property
    def world(self) -> World:
        """What surrounds the body. Raises DefplanError if nothing holds it on its terrain."""
        return World(self.body.medium, self.terrain)

    @property
    def timestep(self) -> float:
        """Time step, s."""
        return self.options.timestep

    @property
    def nu(self) -> int:
        """Size of an input: r, and 3 for each foot."""
        return self.body.n_modes + 3 * len(self.feet or ())

    @property
    def nx(self) -> int:
        """Size of the state, 13 + 3r."""
        return 13 + 3 * self.body.n_modes

    @property
    def substeps(self) -> int:
        """Substeps in a control step."""
        return self.options.substeps

    @property
    def integrator(self) -> str:
        """Name of the integrator."""
        return self.options.integrator

    @property
    def stepping(self) -> dict[str, Any]:
        """'substeps' and 'integrator', as they are given to this class."""
        return self.options.stepping

    def rest_state(self) -> np.ndarray:
        """Return the state at rest, (nx,): at the origin, or standing on the terrain at x = y = 0.

        Raises:
            DefplanError: the body does not come to rest there.
        """
        if self._rest is None:
            self._rest = self._undeformed() if self.terrain is None else self._settled()
        return self._rest.copy()

    def _undeformed(self) -> np.ndarray:
        x = np.zeros(self.nx)
        x[3] = 1.0
        return x

    def _settled(self) -> np.ndarray:
        """Let the body down on the terrain, without friction, and take its velocity after each step.

        Rounded friction does not hold a body under a sideways load: it creeps until there is none,
        which is where it stands without friction.
        """
        assert self.terrain is not None
        # implicit Euler takes energy fast, at any step
        calm = ReducedDynamics(
            self.body,
            _CALM_TIMESTEP,
            replace(self.terrain, friction=0.0),
            tolerance=1e-10,
            substeps=1,
            integrator="implicit-euler",
        )
        n, u = 7 + self.body.n_modes, np.zeros(calm.nu)
        x = self._undeformed()
        x[2] = self._height()
        for _ in range(_CALM_STEPS):
            x_next = calm.step(x, u)
            moved = np.abs(x_next - x)[2:n].max()
            x = np.concatenate([[0.0, 0.0], x_next[2:n], np.zeros(self.nx - n)])
            if moved < 1e-10:
                return x
        raise DefplanError(f"the body {self.body.name} does not come to rest on its terrain")

    def _height(self) -> float:
        """Return the height at which the undeformed body just touches the terrain."""
        x, n = self._undeformed(), len(contact_points(self.body))
        points, forces, gaps = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
        low, high = -1e3, 1e3
        for _ in range(60):
            x[2] = 0.5 * (low + high)
            self._lib.dp_contacts(self.model, x, points, forces, gaps)
            low, high = (low, x[2]) if gaps.min() > 0.0 else (x[2], high)
        return high

    def step(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the state (nx,) one time step after `x` under the input `u` (nu,)."""
        return self.step_info(x, u)[0]

    def step_info(
        self, x: np.ndarray, u: np.ndarray, near: np.ndarray | None = None
    ) -> tuple[np.ndarray, Info]:
        """Like `step`, with Newton iterations and whether the solve failed.

        Args:
            near: a guess (nx,) of the state after the step, to save iterations: the result is the same
                within the tolerance.
        """
        x_next, info = np.empty(self.nx), Info()
        arguments = self.model, self._state(x), self._input(u)
        if near is None:
            self._lib.dp_step(*arguments, x_next, ctypes.byref(info))
        else:
            self._lib.dp_step_near(*arguments, self._state(near), x_next, ctypes.byref(info))
        return x_next, info

    def rollout(self, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the states (N + 1, nx) from `x0` under inputs `u` (N, nu).

        Raises:
            DefplanError: a solve failed.
        """
        states, failed = self.rollout_count(x0, u)
        if failed:
            raise DefplanError(f"{failed} of {len(u)} reduced steps did not converge")
        return states

    def rollout_count(self, x0: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, int]:
        """Like `rollout`, but return the number of failed solves instead of raising."""
        u = self._inputs(u)
        states = np.empty((len(u) + 1, self.nx))
        states[0] = self._state(x0)
        failed = self._lib.dp_rollout(self.model, len(u), u, states, None)
        return states, failed

    def step_jacobian(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return dx_next/dx (nx, nx) and dx_next/du (nx, nu) at a solved step, exact."""
        a, b = np.empty((self.nx, self.nx)), np.empty((self.nx, self.nu))
        args = (self._state(x), self._input(u), self._state(x_next))
        if self._lib.dp_step_jac(self.model, *args, a, b):
            raise DefplanError("the reduced step has no derivative here: its Hessian is singular")
        return a, b

    def step_adjoint(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray, g_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients over x (nx,) and u (nu,) of g_next . x_next."""
        gx, gu = np.empty(self.nx), np.empty(self.nu)
        args = (self._state(x), self._input(u), self._state(x_next), self._state(g_next))
        if self._lib.dp_step_adj(self.model, *args, gx, gu):
            raise DefplanError("the reduced step has no derivative here: its Hessian is singular")
        return gx, gu

    def rollout_adjoint(
        self, u: np.ndarray, states: np.ndarray, g_states: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradient over x0 (nx,) and over u (N, nu) of a function of the states.

        Args:
            u: (N, nu) inputs of the rollout.
            states: (N + 1, nx) its states.
            g_states: (N + 1, nx) partial derivatives of the function by the states.
        """
        u = self._inputs(u)
        total, gu = np.array(g_states, np.float64, order="C"), np.empty_like(u)
        states = np.ascontiguousarray(states, np.float64)
        for name, array in (("states", states), ("gradients", total)):
            if array.shape != (len(u) + 1, self.nx):
                raise DefplanError(
                    f"the {name} have shape {array.shape}, wanted ({len(u) + 1}, {self.nx})"
                )
        if self._lib.dp_rollout_adj(self.model, len(u), u, states, total, gu):
            raise DefplanError("the rollout has no derivative: a step's Hessian is singular")
        return total[0], gu

    def energy(self, x: np.ndarray) -> dict[str, float | np.ndarray]:
        """Return kinetic, elastic and potential energy (J), linear (kg m/s) and angular momentum."""
        out = np.empty(9)
        self._lib.dp_energy(self.model, self._state(x), out)
        return {
            "kinetic": out[0],
            "elastic": out[1],
            "potential": out[2],
            "momentum": out[3:6].copy(),
            "angular_momentum": out[6:9].copy(),
        }

    def surface(self, x: np.ndarray) -> np.ndarray:
        """Return the world positions (n_s, 3) of the body's surface vertices, m."""
        points, x = np.empty((len(self.body.surface), 3)), np.ascontiguousarray(x, np.float64)
        if x.shape not in ((self.nx,), (7 + self.body.n_modes,)):
            raise DefplanError(
                f"the state has shape {x.shape}, wanted ({self.nx},) or its first"
                f" {7 + self.body.n_modes} numbers"
            )
        self._lib.dp_surface(self.blob, x, points)
        return points

    def contacts(self, x: np.ndarray) -> Contacts:
        """Return what touches the terrain in `x`, with the forces of the step that led to it."""
        n = len(contact_points(self.body))
        points, forces, gaps = np.empty((n, 3)), np.zeros((n, 3)), np.empty(n)
        if self.terrain is None:
            return Contacts(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0, int))
        self._lib.dp_contacts(self.model, self._state(x), points, forces, gaps)
        touch = (forces != 0.0).any(axis=1)
        return Contacts(points[touch], forces[touch], -gaps[touch], np.flatnonzero(touch))

    def with_feet(self, feet: Feet) -> ReducedDynamics:
        """Return the same dynamics with given forces on `feet` in the place of contact."""
        return _restore(self.body, None, feet, self.options)

    def step_forced(self, x: np.ndarray, u: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Like `step`, with the target shape `u` (r,) and the forces on the feet (n_feet, 3), N."""
        return self.step(x, np.concatenate([u, np.ravel(forces)]))

    def feet_positions(self, x: np.ndarray) -> np.ndarray:
        """Return the world positions (n_feet, 3) of the feet, m."""
        return self._feet(x, None)

    def feet_jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return d feet_positions / dx (n_feet, 3, nx)."""
        size = 7 + self.body.n_modes
        jacobian = np.empty((3 * len(self.feet or ()), size))
        self._feet(x, jacobian)
        whole = np.zeros((len(self.feet or ()), 3, self.nx))
        whole[:, :, :size] = jacobian.reshape(-1, 3, size)
        return whole

    def _feet(self, x: np.ndarray, jacobian: np.ndarray | None) -> np.ndarray:
        if self.feet is None:
            raise DefplanError("these dynamics have no feet: give ReducedDynamics some")
        points = np.empty((len(self.feet), 3))
        address = None if jacobian is None else jacobian.ctypes.data
        self._lib.dp_feet(self.model, self._state(x), points, address)
        return points

    def _state(self, x: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(x, np.float64)
        if x.shape != (self.nx,):
            raise DefplanError(f"the state has shape {x.shape}, wanted ({self.nx},)")
        return x

    def _inputs(self, u: np.ndarray) -> np.ndarray:
        u = np.ascontiguousarray(u, np.float64)
        if u.ndim != 2 or u.shape[1] != self.nu:
            raise DefplanError(f"the inputs have shape {u.shape}, wanted (N, {self.nu})")
        return u

    def _input(self, u: np.ndarray) -> np.ndarray:
        u = np.ascontiguousarray(u, np.float64)
        if u.shape != (self.nu,):
            raise DefplanError(f"the input has shape {u.shape}, wanted ({self.nu},)")
        return u


def _restore(
    body: Body, terrain: Terrain | None, feet: Feet | None, options: StepOptions
) -> ReducedDynamics:
    """Return the dynamics of given options."""
    return ReducedDynamics(body, terrain=terrain, feet=feet, **asdict(options))
