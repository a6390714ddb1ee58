"""What a gait cycle costs (a term of E_obj), in CasADi: in the plane and in space."""

from __future__ import annotations

import casadi as ca
import numpy as np

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
        turn, direction, advance: what is wanted, as in `GaitProblem.wanted`.
    """
    forward, end = _forward(start), _forward(x[:, -1])
    yaw = ca.atan2(
        forward[0] * end[1] - forward[1] * end[0], forward[0] * end[0] + forward[1] * end[1]
    )
    move = x[:3, -1] - start[:3]
    ahead = forward[:2] / ca.sqrt(ca.sumsqr(forward[:2]) + 1e-12)
    left = ca.vertcat(-ahead[1], ahead[0])
    moved = ca.vertcat(ca.dot(ahead, move[:2]), ca.dot(left, move[:2]))
    # squared tilt 2 (1 - R_zz), to second order
    tilts = [4 * ca.sumsqr(x[4:6, i]) for i in range(x.shape[1])]
    tilt = sum(tilts) / len(tilts)
    lean = sum(ca.fmax(0, t - np.radians(15) ** 2) ** 2 for t in tilts) / len(tilts)
    return (
        weights.turn * (yaw - turn[2]) ** 2
        + _move(weights, moved, direction[:2], advance)
        + weights.tilt * tilt
        + weights.upright * lean
        + weights.sink * move[2] ** 2
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
    made = quaternion_product(_conjugate(start[3:7]), x[3:7, -1])
    error = quaternion_product(_conjugate(target), made)[1:4]
    roll = ca.dot(error, axis)
    moved = quaternion_matrix(start[3:7]).T @ (x[:3, -1] - start[:3])
    return (
        weights.turn * 4 * (ca.sumsqr(error) - roll**2)
        + weights.roll * 4 * roll**2
        + _move(weights, moved, direction, advance)
    )


def _move(weights: Weights, moved: ca.SX, direction: ca.SX, advance: ca.SX) -> ca.SX:
    along = ca.dot(direction, moved)
    drift = ca.sumsqr(moved - along * direction)
    shortfall = ca.fmax(0, advance - along)
    return weights.move * shortfall**2 + weights.drift * drift


def _forward(x: ca.SX) -> ca.SX:
    """The body's x axis in the world, from the state's quaternion."""
    w, a, b, c = (x[3 + i] for i in range(4))
    return ca.vertcat(1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b))


def quaternion_product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the product of quaternions (w x y z), symbolic."""
    return ca.vertcat(
        a[0] * b[0] - ca.dot(a[1:4], b[1:4]),
        a[0] * b[1:4] + b[0] * a[1:4] + ca.cross(a[1:4], b[1:4]),
    )


def _conjugate(q: ca.SX) -> ca.SX:
    return ca.vertcat(q[0], -q[1:4])


def quaternion_matrix(q: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) of a unit quaternion (w x y z), symbolic."""
    w, a, b, c = (q[i] for i in range(4))
    return ca.vertcat(
        ca.horzcat(1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)),
        ca.horzcat(2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)),
        ca.horzcat(2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)),
    )
