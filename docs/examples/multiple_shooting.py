"""A CasADi problem of one's own on the reduced dynamics: bend to a shape and be at rest there.

Multiple shooting: states and target shapes are unknowns, the kernel's step ties them together.

    python docs/examples/multiple_shooting.py body.npz fatrop
"""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.reduced import ReducedDynamics

OPTIONS = {
    "ipopt": {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-7}},
    "fatrop": {"structure_detection": "auto", "fatrop": {"print_level": 0, "tol": 1e-7}},
}


def reach(
    dynamics: ReducedDynamics, goal: np.ndarray, steps: int, solver: str = "ipopt"
) -> tuple[np.ndarray, np.ndarray, dict]:
    """Find target shapes that bring the body from rest to the shape `goal` (r,), and stop there.

    Returns:
        states (steps + 1, nx) as the solver has them, target shapes (steps, r), its statistics.
    """
    r, nx = dynamics.nu, dynamics.nx
    rest, amplitude = dynamics.rest_state(), dynamics.body.amplitude
    step = CasadiDynamics(dynamics).step_gauss_newton

    # unknowns: fatrop wants them in the order of time, x_0 u_0 x_1 u_1 ... x_N
    x = [ca.MX.sym(f"x{i}", nx) for i in range(steps + 1)]
    u = [ca.MX.sym(f"u{i}", r) for i in range(steps)]
    unknowns = ca.vertcat(*(s for pair in zip(x[:-1], u, strict=True) for s in pair), x[-1])

    # dynamics, and the start after the first of them
    constraints = []
    for i in range(steps):
        constraints.append(x[i + 1] - step(x[i], u[i]))
        if i == 0:
            constraints.append(x[0] - rest)
    constraints = ca.vertcat(*constraints)

    # objective: little effort and motion, the shape at the end, no vibration there; without the motion
    # the Hessian lacks what the dynamics' curvature would add, and Newton's steps grow
    effort = sum(ca.sumsqr(shape) for shape in u)
    motion = sum(ca.sumsqr(state[13 + r : 13 + 2 * r]) for state in x)
    miss = ca.sumsqr(x[-1][7 : 7 + r] - goal)
    vibration = ca.sumsqr(x[-1][13 + r : 13 + 2 * r])
    objective = 0.0025 * effort + 0.0005 * motion + 1000 * miss + 0.09 * vibration

    # solve
    options = {"print_time": False, **OPTIONS[solver]}
    if solver == "fatrop":
        options["equality"] = [True] * constraints.numel()
    nlp = {"x": unknowns, "f": objective, "g": constraints}
    free = np.full(nx, np.inf)
    bound = np.concatenate([np.tile(np.concatenate([free, amplitude]), steps), free])
    start = np.concatenate([np.tile(np.concatenate([rest, np.zeros(r)]), steps), rest])
    minimise = ca.nlpsol("reach", solver, nlp, options)
    solution = minimise(x0=start, lbx=-bound, ubx=bound, lbg=0, ubg=0)
    values = np.array(solution["x"]).ravel()
    stages = values[: steps * (nx + r)].reshape(steps, nx + r)
    return np.vstack([stages[:, :nx], values[-nx:]]), stages[:, nx:], minimise.stats()


def main(path: str, solver: str = "ipopt") -> None:
    """Solve for the body of a file, simulate what was found, and say how close it comes."""
    dynamics = ReducedDynamics(Body.load(path))
    states, shapes, stats = reach(dynamics, 0.4 * np.eye(dynamics.nu)[0], 8, solver)
    end = dynamics.rollout(dynamics.rest_state(), shapes)[-1]
    print(f"{solver}: {stats['iter_count']} iterations")
    print("shape at the end:", np.round(end[7 : 7 + dynamics.nu], 4))
    print("off the simulation by:", np.abs(states[-1] - end).max())


if __name__ == "__main__":
    main(*sys.argv[1:])
