"""The reduced dynamics: one implicit step of c, R and q under a target shape, in compiled code."""

from __future__ import annotations

import ctypes

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.errors import DefplanError
from defplan_mj.kernel.library import Info, kernel
from defplan_mj.kernel.pack import pack_body, pack_options


class ReducedDynamics:
    """f reduced: x_{i+1} = step(x_i, u_i); see kernel/kernel.h for the state's layout.

    A state is (13 + 2r,): position (3, m), unit quaternion (w x y z), q (r), then world velocity
    (3, m/s), angular velocity in the body frame (3, rad/s), dq/dt (r, 1/s). All calls are
    thread-safe and release the GIL.
    """

    def __init__(
        self, body: Body, timestep: float = 0.04, tolerance: float = 1e-7, max_newton: int = 60
    ):
        self.body = body
        self.blob = pack_body(body)
        self.par = pack_options(body, timestep, tolerance, max_newton)
        self._lib = kernel()
        if self._lib.dp_check(self.blob, self.blob.size):
            raise DefplanError(f"the kernel does not take the body {body.name}: reinstall defplan")

    @property
    def timestep(self) -> float:
        """Time step, s."""
        return float(self.par[0])

    @property
    def nu(self) -> int:
        """r, the size of the target shape."""
        return self.body.n_modes

    @property
    def nx(self) -> int:
        """Size of the state, 13 + 2r."""
        return 13 + 2 * self.nu

    def rest_state(self) -> np.ndarray:
        """Return the state at rest at the origin, (nx,)."""
        x = np.zeros(self.nx)
        x[3] = 1.0
        return x

    def step(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the state (nx,) one time step after `x` under the target shape `u` (r,)."""
        return self.step_info(x, u)[0]

    def step_info(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, Info]:
        """Like `step`, with Newton iterations and whether the solve failed."""
        x_next, info = np.empty(self.nx), Info()
        self._lib.dp_step(
            self.blob, self.par, self._state(x), self._shape(u), x_next, ctypes.byref(info)
        )
        return x_next, info

    def rollout(self, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the states (N + 1, nx) from `x0` under target shapes `u` (N, r).

        Raises:
            DefplanError: a solve failed.
        """
        states, failed = self.rollout_count(x0, u)
        if failed:
            raise DefplanError(f"{failed} of {len(u)} reduced steps did not converge")
        return states

    def rollout_count(self, x0: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, int]:
        """Like `rollout`, but return the number of failed solves instead of raising."""
        u = np.ascontiguousarray(u, np.float64)
        if u.ndim != 2 or u.shape[1] != self.nu:
            raise DefplanError(f"target shapes have shape {u.shape}, wanted (N, {self.nu})")
        states = np.empty((len(u) + 1, self.nx))
        states[0] = self._state(x0)
        failed = self._lib.dp_rollout(self.blob, self.par, len(u), u, states, None)
        return states, failed

    def step_jacobian(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return dx_next/dx (nx, nx) and dx_next/du (nx, r) at a solved step, exact."""
        a, b = np.empty((self.nx, self.nx)), np.empty((self.nx, self.nu))
        args = (self._state(x), self._shape(u), self._state(x_next))
        if self._lib.dp_step_jac(self.blob, self.par, *args, a, b):
            raise DefplanError("the reduced step has no derivative here: its Hessian is singular")
        return a, b

    def step_adjoint(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray, g_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients over x (nx,) and u (r,) of g_next . x_next."""
        gx, gu = np.empty(self.nx), np.empty(self.nu)
        args = (self._state(x), self._shape(u), self._state(x_next), self._state(g_next))
        if self._lib.dp_step_adj(self.blob, self.par, *args, gx, gu):
            raise DefplanError("the reduced step has no derivative here: its Hessian is singular")
        return gx, gu

    def rollout_adjoint(
        self, u: np.ndarray, states: np.ndarray, g_states: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradient over x0 (nx,) and over u (N, r) of a function of the states.

        Args:
            u: (N, r) target shapes of the rollout.
            states: (N + 1, nx) its states.
            g_states: (N + 1, nx) partial derivatives of the function by the states.
        """
        u = np.ascontiguousarray(u, np.float64)
        total, gu = np.array(g_states, np.float64, order="C"), np.empty_like(u)
        states = np.ascontiguousarray(states, np.float64)
        if self._lib.dp_rollout_adj(self.blob, self.par, len(u), u, states, total, gu):
            raise DefplanError("the rollout has no derivative: a step's Hessian is singular")
        return total[0], gu

    def energy(self, x: np.ndarray) -> dict[str, float | np.ndarray]:
        """Return kinetic, elastic and potential energy (J), linear (kg m/s) and angular momentum."""
        out = np.empty(9)
        self._lib.dp_energy(self.blob, self.par, self._state(x), out)
        return {
            "kinetic": out[0],
            "elastic": out[1],
            "potential": out[2],
            "momentum": out[3:6].copy(),
            "angular_momentum": out[6:9].copy(),
        }

    def surface(self, x: np.ndarray) -> np.ndarray:
        """Return the world positions (n_s, 3) of the body's surface vertices, m."""
        points = np.empty((len(self.body.surface), 3))
        self._lib.dp_surface(self.blob, np.ascontiguousarray(x[: 7 + self.nu], np.float64), points)
        return points

    def _state(self, x: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(x, np.float64)
        if x.shape != (self.nx,):
            raise DefplanError(f"the state has shape {x.shape}, wanted ({self.nx},)")
        return x

    def _shape(self, u: np.ndarray) -> np.ndarray:
        u = np.ascontiguousarray(u, np.float64)
        if u.shape != (self.nu,):
            raise DefplanError(f"the target shape has shape {u.shape}, wanted ({self.nu},)")
        return u
