"""A swimming problem of one's own in CasADi: come as far ahead as wanted in a given time, with little effort.

By single shooting (`rollout`: only the target shapes are unknown, ipopt with a quasi-Newton method), then
by multiple shooting (states are unknown, too) from what that found. Each plan is simulated.

    python docs/examples/swimming.py body.npz
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import casadi as ca
import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.reduced import ReducedDynamics

EFFORT, SMOOTH = 1e-3, 3e-3  # weights of a target shape and of its change, beside the miss in m^2
NEAR = 0.1  # weight of the way from the start, in multiple shooting


@dataclass(frozen=True)
class Plan:
    """What a solver found.

    Attributes:
        shapes: (N, r) target shapes.
        states: (N + 1, nx) as the solver has them.
        stats: the solver's statistics.
    """

    shapes: np.ndarray
    states: np.ndarray
    stats: dict


def cost(dynamics: ReducedDynamics, x_end: ca.MX, u: ca.MX, goal: np.ndarray) -> ca.MX:
    """Return how far the body ends from `goal` (3,), and what its target shapes u (r x N) cost."""
    scaled = u / ca.DM(dynamics.body.amplitude)
    changes = scaled[:, 1:] - scaled[:, :-1]
    return (
        ca.sumsqr(x_end[:3] - goal)
        + (EFFORT * ca.sumsqr(scaled) + SMOOTH * ca.sumsqr(changes)) / u.shape[1]
    )


def wave(dynamics: ReducedDynamics, steps: int, period: float) -> np.ndarray:
    """Return shapes (steps, r) to start from: rest has no slope, so the modes swing a little in turn."""
    r = dynamics.body.n_modes
    time = dynamics.timestep * np.arange(1, steps + 1)[:, None]
    phase = 2 * np.pi * (time / period - np.arange(r) / r)
    return 0.3 * dynamics.body.amplitude * np.sin(phase)


def single_shooting(
    dynamics: ReducedDynamics, goal: np.ndarray, start: np.ndarray, iterations: int = 60
) -> Plan:
    """Find target shapes from `start` (N, r); the states follow from them by the rollout."""
    steps, rest = len(start), dynamics.rest_state()
    u = ca.MX.sym("u", dynamics.nu, steps)
    x = CasadiDynamics(dynamics).rollout(steps)(rest, u)
    nlp = {"x": ca.vec(u), "f": cost(dynamics, x[:, -1], u, goal)}
    options = {
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {
            "hessian_approximation": "limited-memory",
            "max_iter": iterations,
            "tol": 1e-4,
            "print_level": 0,
            "sb": "yes",
        },
    }
    bound = np.tile(dynamics.body.amplitude, steps)
    solver = ca.nlpsol("single", "ipopt", nlp, options)
    solution = solver(x0=start.ravel(), lbx=-bound, ubx=bound)
    shapes = np.array(solution["x"]).reshape(steps, -1)
    return Plan(shapes, dynamics.rollout(rest, shapes), solver.stats())


def multiple_shooting(
    dynamics: ReducedDynamics, goal: np.ndarray, start: Plan, iterations: int = 15
) -> Plan:
    """Find states and target shapes together; the kernel's step ties each state to the next.

    The solver's Hessian leaves out the curvature of the dynamics (`step_gauss_newton`), so the plan is
    to stay near the start (NEAR): call it again from what it returns to go on.
    """
    steps, r, nx = len(start.shapes), dynamics.nu, dynamics.nx
    step = CasadiDynamics(dynamics).step_gauss_newton
    unknowns = ca.MX.sym("unknowns", (r + nx) * steps)  # in the order of time: banded matrices
    table = ca.reshape(unknowns, r + nx, steps)
    u, x = table[:r, :], table[r:, :]  # x after each step
    before = ca.horzcat(ca.DM(dynamics.rest_state()), x[:, :-1])
    gaps = x - step.map(steps)(before, u)
    nlp = {
        "x": unknowns,
        "f": cost(dynamics, x[:, -1], u, goal)
        + NEAR * ca.sumsqr((u - start.shapes.T) / ca.DM(dynamics.body.amplitude)) / steps,
        "g": ca.vec(gaps),
    }
    options = {
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {
            "max_iter": iterations,
            "tol": 1e-6,
            # the start is a rollout that does well: the barrier is not to drive it away
            "mu_init": 1e-6,
            "bound_push": 1e-8,
            "bound_frac": 1e-8,
            "print_level": 0,
            "sb": "yes",
        },
    }
    bound = np.hstack([np.tile(dynamics.body.amplitude, (steps, 1)), np.full((steps, nx), np.inf)])
    values = np.hstack([start.shapes, start.states[1:]])
    solver = ca.nlpsol("multiple", "ipopt", nlp, options)
    solution = solver(x0=values.ravel(), lbx=-bound.ravel(), ubx=bound.ravel(), lbg=0, ubg=0)
    rows = np.array(solution["x"]).reshape(steps, r + nx)
    states = np.vstack([start.states[:1], rows[:, r:]])
    return Plan(rows[:, :r], states, solver.stats())


def report(dynamics: ReducedDynamics, name: str, plan: Plan, goal: np.ndarray) -> float:
    """Simulate a plan, print how it did, and return how far from `goal` the simulation ends, m."""
    states = dynamics.rollout(dynamics.rest_state(), plan.shapes)
    miss = float(np.linalg.norm(states[-1, :3] - goal))
    gap = np.abs(states - plan.states).max()
    print(
        f"{name}: {plan.stats['return_status']} after {plan.stats['iter_count']} iterations,"
        f" simulated {1000 * miss:.2f} mm from the goal, off the plan by {gap:.1e}"
    )
    return miss


def main(path: str, ahead: float = 1.0, seconds: float = 2.4) -> tuple[float, float]:
    """Swim `ahead` body lengths along x in `seconds` s; return both ways' misses, m."""
    dynamics = ReducedDynamics(Body.load(path))
    goal = np.array([ahead * dynamics.body.length, 0.0, 0.0])
    steps = round(seconds / dynamics.timestep)
    single = single_shooting(dynamics, goal, wave(dynamics, steps, period=0.6))
    first = report(dynamics, "single shooting", single, goal)
    multiple = multiple_shooting(dynamics, goal, single)
    return first, report(dynamics, "multiple shooting", multiple, goal)


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
