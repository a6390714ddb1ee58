"""The reduced dynamics as CasADi functions with exact derivatives, for any CasADi problem."""

from __future__ import annotations

from functools import cached_property

import casadi

from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.casadi_files import (
    Instance,
    load_function,
    load_instance,
    save_function,
    save_instance,
)
from defplan_mj.dynamics.casadi_slots import failure, make_function
from defplan_mj.dynamics.reduced import ReducedDynamics

__all__ = [
    "CasadiDynamics",
    "Instance",
    "failure",
    "load_function",
    "load_instance",
    "save_function",
    "save_instance",
]

KEPT = 4  # rollouts that a function remembers (N_KEPT in kernel/casadi.c)


class CasadiDynamics:
    """CasADi's view of reduced dynamics as they are now (a copy: later changes do not show).

    The functions run in compiled code without Python, may be mapped over threads, and stay valid
    when this object is gone. Their derivatives are exact; a step that does not converge is an
    evaluation error, which ipopt answers with a shorter step; `failure` tells why. `save_function`
    writes a function with its body. This object pickles as its dynamics: the functions are made anew.
    """

    def __init__(self, dynamics: ReducedDynamics):
        self.dynamics = dynamics
        self._rollouts: dict[int, casadi.Function] = {}

    def __reduce__(self) -> tuple:
        return CasadiDynamics, (self.dynamics,)

    @cached_property
    def step(self) -> casadi.Function:
        """(x: nx, u: nu) -> x_next: nx, with Jacobian and adjoint."""
        return self._function("defplan_step", 1)

    @cached_property
    def step_gauss_newton(self) -> casadi.Function:
        """`step` for solvers that ask for second derivatives: they are left out, taken as zero.

        With it, the exact Hessian of a Lagrangian is Gauss-Newton's: that of all but the dynamics.
        Values and first derivatives are those of `step`.
        """
        x, u = casadi.MX.sym("x", self.dynamics.nx), casadi.MX.sym("u", self.dynamics.nu)
        x_next = casadi.MX.sym("out_x_next", self.dynamics.nx)
        blocks = [casadi.no_grad(block) for block in self.step.jacobian()(x, u, x_next)]
        names = ["jac_x_next_x", "jac_x_next_u"]
        jacobian = casadi.Function(
            "jac_step", [x, u, x_next], blocks, ["x", "u", "out_x_next"], names
        )
        options = {"custom_jacobian": jacobian, "never_inline": True}
        options |= {"enable_forward": False, "enable_reverse": False}
        return casadi.Function("step", [x, u], [self.step(x, u)], ["x", "u"], ["x_next"], options)

    @cached_property
    def step_forced(self) -> casadi.Function:
        """(x: nx, u: r, forces: 3 x n_feet) -> x_next: nx, for dynamics with feet; as `step`."""
        self._needs_feet()
        return self._split(self.step)

    @cached_property
    def step_forced_gauss_newton(self) -> casadi.Function:
        """`step_forced` with second derivatives taken as zero, as in `step_gauss_newton`."""
        self._needs_feet()
        return self._split(self.step_gauss_newton)

    @cached_property
    def feet(self) -> casadi.Function:
        """x: nx -> p: 3 x n_feet, the world positions of the feet (m), with Jacobian."""
        self._needs_feet()
        return self._function("defplan_feet", 1)

    def _needs_feet(self) -> None:
        if self.dynamics.feet is None:
            raise DefplanError("these dynamics have no feet: give ReducedDynamics some")

    def _split(self, step: casadi.Function) -> casadi.Function:
        """Return `step` with the forces as an argument of their own."""
        dynamics = self.dynamics
        x, u = casadi.MX.sym("x", dynamics.nx), casadi.MX.sym("u", dynamics.body.n_modes)
        forces = casadi.MX.sym("forces", 3, len(dynamics.feet or ()))
        out = step(x, casadi.vertcat(u, casadi.vec(forces)))
        return casadi.Function(
            "step_forced", [x, u, forces], [out], ["x", "u", "forces"], ["x_next"]
        )

    def rollout(self, n: int) -> casadi.Function:
        """Return (x0: nx, u: nu x n) -> x: nx x n, the states after each step, with adjoint."""
        if n not in self._rollouts:
            self._rollouts[n] = self._function("defplan_rollout", n)
        return self._rollouts[n]

    def rollouts(self, n: int, count: int, threads: int = 1) -> casadi.Function:
        """Return `count` rollouts in parallel, side by side in the columns of the arguments.

        (x0: nx x count, u: nu x (n count)) -> x: nx x (n count), with adjoint.
        """
        x0, u = (
            casadi.MX.sym("x0", self.dynamics.nx, count),
            casadi.MX.sym("u", self.dynamics.nu, n * count),
        )
        parts = []
        for first in range(0, count, KEPT):
            some = min(KEPT, count - first)
            rollout = self._function("defplan_rollout", n)
            one = rollout.map(some, "thread", threads) if threads > 1 else rollout.map(some)
            parts.append(one(x0[:, first : first + some], u[:, n * first : n * (first + some)]))
        return casadi.Function("rollouts", [x0, u], [casadi.horzcat(*parts)])

    def _function(self, name: str, steps: int) -> casadi.Function:
        return make_function(self.dynamics.model.arrays, name, steps)
