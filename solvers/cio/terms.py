"""The residuals of contact-invariant optimisation (E_phys, E_cio, E_obj of Eq. 1) and their Jacobians, in CasADi.

After Mordatch, Todorov and Popovic 2012 (the paper's [29]): a foot that carries a force is on the
ground and does not slip. Every term is a square, so that Gauss-Newton applies.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import casadi as ca
import numpy as np

from defplan_mj.dynamics.symbolic import difference_function, tangent_function
from defplan_mj.gait import residuals
from defplan_mj.gait.problem import GaitProblem
from defplan_solvers.cio.model import Walker

_TURN, _SHAPE = 0.3, 0.1  # metres that one radian, and one unit of q, count in E_phys
_TOUCH = 0.02  # share of the weight from which a foot counts as touching
_HEIGHT, _DEPTH = 0.05, 0.02  # m: unit of a gap or a slip, and of a penetration
_ROUNDING = 1e-4  # of roots of forces


@dataclass(frozen=True)
class Weights:
    """Of residuals (their squares' weights are these squared), all but the last for each step.

    Attributes:
        physics: E_phys; the unit is an acceleration of 1 g that no force explains.
        contact: the gap of a foot that carries, and its slip, a step; unit 5 cm.
        penetration: of a foot; unit 2 cm.
        cone: forces that pull or leave the friction cone; unit the weight.
        force: all forces; unit the weight.
        amplitude: target shapes past the body's amplitude; unit the amplitude.
        dmp: E_dmp, of target shapes that are unknowns of their own.
        objective: E_obj.
    """

    physics: float
    contact: float
    penetration: float = 3.0
    cone: float = 3.0
    force: float = 0.02
    amplitude: float = 3.0
    dmp: float = 0.0
    objective: float = 1.0

    def array(self) -> np.ndarray:
        """Return all of them, in order."""
        return np.array(astuple(self))


def state_scale(walker: Walker) -> np.ndarray:
    """Return what makes the tangent of a state (nx - 1,) metres: velocities count for a step."""
    scale = np.concatenate([np.ones(3), _TURN * np.ones(3), _SHAPE * np.ones(walker.nu)])
    return np.concatenate([scale, walker.timestep * scale, _SHAPE * np.ones(walker.nu)])


def foot_residuals(walker: Walker) -> ca.Function:
    """(before, after: 3 x F positions, force: 3 x F in weights, weights) -> E_cio's residuals."""
    before, after, force = (ca.SX.sym(name, 3, walker.n_feet) for name in ("p", "p_next", "l"))
    weights = ca.SX.sym("weights", len(Weights(0, 0).array()))
    _, contact, penetration, cone, reg = ca.vertsplit(weights)[:5]
    rows = []
    for f in range(walker.n_feet):
        normal, tangent = force[2, f], force[:2, f]
        touch = normal / ca.sqrt(normal**2 + _TOUCH**2)
        give = walker.give[f] * ca.sqrt(ca.fmax(normal, 0) + _ROUNDING)
        gap = after[2, f] - (walker.level[f] - give)
        slip = after[:2, f] - before[:2, f]
        sideways = ca.sqrt(ca.sumsqr(tangent) + _ROUNDING**2)
        rows += [
            contact * touch * gap / _HEIGHT,
            contact * touch * slip / _HEIGHT,
            penetration * ca.fmin(0, gap) / _DEPTH,
            cone * ca.fmax(0, sideways - walker.friction * normal),
            cone * ca.fmax(0, -normal),
            reg * force[:, f],
        ]
    names = ["before", "after", "force", "weights"]
    return ca.Function("foot", [before, after, force, weights], [ca.vertcat(*rows)], names, ["r"])


def stage_function(
    walker: Walker, problem: GaitProblem, judged: int, jacobian: bool
) -> ca.Function:
    """Return the residuals of one step.

    (x, x_next: nx, force: 3F in weights, u: r, target: r, weights) -> residuals: E_phys (nx - 1),
    E_cio, posture and amplitude, E_dmp (r); with `jacobian` also its transpose, over
    (x, x_next in the tangent, force, u).

    Args:
        judged: cycles that E_obj is the mean of.
    """
    nx, r, feet = walker.nx, walker.nu, walker.n_feet
    unit = 1 / (9.81 * walker.timestep**2)
    x, x_next = ca.MX.sym("x", nx), ca.MX.sym("x_next", nx)
    force, u, target = ca.MX.sym("l", 3 * feet), ca.MX.sym("u", r), ca.MX.sym("target", r)
    weights = ca.MX.sym("weights", len(Weights(0, 0).array()))
    scale, newtons = unit * state_scale(walker), walker.weight * ca.reshape(force, 3, feet)

    y = walker.step(x, u, newtons)
    physics, by_next, by_y = difference_function(nx, scale)(x_next, y)
    cio = _with_jacobian(foot_residuals(walker), (0, 1, 2))(
        walker.feet(x), walker.feet(x_next), ca.reshape(force, 3, feet), weights
    )
    rest = _with_jacobian(_posture(walker, problem, judged), (0, 1))(x_next, u, target, weights)
    outputs = [ca.vertcat(weights[0] * physics, cio[0], rest[0])]
    if jacobian:
        tangent = tangent_function(nx)
        t, t_next = tangent(x), tangent(x_next)
        step_x, step_u, step_f = walker.step.jacobian()(x, u, newtons, y)
        feet_x, feet_next = (walker.feet.jacobian()(at, walker.feet(at)) for at in (x, x_next))
        first = weights[0] * ca.horzcat(
            by_y @ (step_x @ t), by_next, walker.weight * (by_y @ step_f), by_y @ step_u
        )
        n_cio, n_rest = cio[0].numel(), rest[0].numel()
        second = ca.horzcat(
            cio[1] @ (feet_x @ t), cio[2] @ (feet_next @ t_next), cio[3], ca.MX(n_cio, r)
        )
        third = ca.horzcat(
            ca.MX(n_rest, nx - 1), rest[1] @ t_next, ca.MX(n_rest, 3 * feet), rest[2]
        )
        outputs.append(ca.densify(ca.vertcat(first, second, third)))
    return ca.Function("stage", [x, x_next, force, u, target, weights], outputs)


def _posture(walker: Walker, problem: GaitProblem, judged: int) -> ca.Function:
    """(x_next, u, target, weights) -> E_obj's tilt of a step, bound of u, E_dmp."""
    x, weights = ca.SX.sym("x", walker.nx), ca.SX.sym("weights", len(Weights(0, 0).array()))
    u, target = ca.SX.sym("u", walker.nu), ca.SX.sym("target", walker.nu)
    share = weights[7] / np.sqrt(problem.steps_per_cycle * judged)
    rows = [
        share * np.sqrt(problem.weights.tilt) * residuals.tilt(x),
        share * np.sqrt(problem.weights.upright) * residuals.lean(x),
        weights[5] * ca.fmax(0, ca.fabs(u) / walker.amplitude - 1),
        weights[6] * (u - target),
    ]
    return ca.Function("posture", [x, u, target, weights], [ca.vertcat(*rows)])


def cycle_function(problem: GaitProblem, nx: int, judged: int, jacobian: bool) -> ca.Function:
    """Return the residuals of a cycle's motion in E_obj.

    (x at its start, x at its end: nx, goal: 7, objective's weight) -> (yaw, shortfall, drift, sink),
    with `jacobian` also over both states, in the tangent.
    """
    start, end, goal = ca.SX.sym("x", nx), ca.SX.sym("x_end", nx), ca.SX.sym("goal", 7)
    weight, weights = ca.SX.sym("weight"), problem.weights
    ends = residuals.planar(start, end, goal[:3], goal[3:6], goal[6])
    rows = [
        np.sqrt(weights.turn) * ends.turn,
        np.sqrt(weights.move) * ends.shortfall,
        np.sqrt(weights.drift) * ends.drift,
        np.sqrt(weights.sink) * ends.rise,
    ]
    r = weight / np.sqrt(judged) * ca.vertcat(*rows)
    value = ca.Function("cycle", [start, end, goal, weight], [r])
    if not jacobian:
        return value
    _, by_start, by_end = _with_jacobian(value, (0, 1))(start, end, goal, weight)
    tangent = tangent_function(nx)
    both = ca.horzcat(by_start @ tangent(start), by_end @ tangent(end))
    return ca.Function("cycle", [start, end, goal, weight], [r, ca.densify(both)])


def _with_jacobian(function: ca.Function, over: tuple[int, ...]) -> ca.Function:
    """Return an SX function with the Jacobians of its output over some inputs."""
    arguments = function.sx_in()
    value = function(*arguments)
    by = [ca.jacobian(value, arguments[i]) for i in over]
    return ca.Function(function.name(), arguments, [value, *by])
