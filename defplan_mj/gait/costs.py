"""What a gait cycle costs (a term of E_obj), in CasADi: in the plane and in space."""

from __future__ import annotations

import casadi as ca
import numpy as np

from defplan_mj.dynamics.symbolic import conjugate, quaternion_matrix, quaternion_product
from defplan_mj.gait import residuals
from defplan_mj.task import Weights


def planar(
    weights: Weights, start: ca.SX, x: ca.SX, turn: ca.SX, direction: ca.SX, advance: ca.SX
) -> ca.SX:
    """Return the cost of a cycle in the plane.

    Yaw and displacement count in the yaw frame at the start, tilt and depth in the world.

    Args:
        weights: of the terms.
        start: (nx,) state at the start.
        x: (nx, n) states of the cycle.
        turn, direction, advance: what is wanted, as in `GaitProblem.goals`.
    """
    end = residuals.planar(start, x[:, -1], turn, direction, advance)
    states = [x[:, i] for i in range(x.shape[1])]
    tilt = sum(ca.sumsqr(residuals.tilt(state)) for state in states) / len(states)
    lean = sum(residuals.lean(state) ** 2 for state in states) / len(states)
    return (
        weights.turn * end.turn**2
        + _move(weights, end.shortfall, end.drift)
        + weights.tilt * tilt
        + weights.upright * lean
        + weights.sink * end.rise**2
    )


def spatial(
    weights: Weights,
    axis: np.ndarray,
    start: ca.SX,
    x: ca.SX,
    turn: ca.SX,
    direction: ca.SX,
    advance: ca.SX,
) -> ca.SX:
    """Return the cost of a cycle in space; arguments as of `planar`, and the body's own axis y (3,).

    Rotation and displacement count in the body frame at the start; no attitude is preferred. With p
    the vector part of the rotation's error as a quaternion, 4 |p across y|^2 is the paper's
    |R(x_start)^T R(x_end) y - y_j|^2, and 4 (p . y)^2 is the squared roll about it, both to second
    order.
    """
    angle = ca.sqrt(ca.sumsqr(turn) + 1e-30)
    target = ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) / angle * turn)
    made = quaternion_product(conjugate(start[3:7]), x[3:7, -1])
    error = quaternion_product(conjugate(target), made)[1:4]
    roll = ca.dot(error, axis)
    moved = quaternion_matrix(start[3:7]).T @ (x[:3, -1] - start[:3])
    return (
        weights.turn * 4 * (ca.sumsqr(error) - roll**2)
        + weights.roll * 4 * roll**2
        + _move(weights, *residuals.displacement(moved, direction, advance))
    )


def _move(weights: Weights, shortfall: ca.SX, drift: ca.SX) -> ca.SX:
    return weights.move * shortfall**2 + weights.drift * ca.sumsqr(drift)
