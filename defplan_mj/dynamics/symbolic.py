"""Rotations and tangent coordinates as CasADi expressions: what `base.rotations` and `tangent` are for arrays."""

from __future__ import annotations

import casadi as ca
import numpy as np


def quaternion_product(p: ca.SX, q: ca.SX) -> ca.SX:
    """Return the product (4,) of quaternions w x y z."""
    return ca.vertcat(
        p[0] * q[0] - ca.dot(p[1:4], q[1:4]),
        p[0] * q[1:4] + q[0] * p[1:4] + ca.cross(p[1:4], q[1:4]),
    )


def conjugate(q: ca.SX) -> ca.SX:
    """Return the quaternion (4,) of the turn back."""
    return ca.vertcat(q[0], -q[1:4])


def quaternion_matrix(q: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) of a unit quaternion w x y z."""
    w, a, b, c = (q[i] for i in range(4))
    return ca.vertcat(
        ca.horzcat(1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)),
        ca.horzcat(2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)),
        ca.horzcat(2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)),
    )


def forward_axis(x: ca.SX) -> ca.SX:
    """Return the body's x axis (3,) in the world, of a state (nx,)."""
    w, a, b, c = (x[3 + i] for i in range(4))
    return ca.vertcat(1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b))


def retract(x: ca.SX, change: ca.SX) -> ca.SX:
    """Return the state (nx,) after a change (nx - 1,), its rotation a vector in the body frame.

    To first order as `tangent.retract`, and smooth for every change.
    """
    turned = quaternion_product(x[3:7], ca.vertcat(1, change[3:6] / 2))
    return ca.vertcat(x[:3] + change[:3], turned / ca.norm_2(turned), x[7:] + change[6:])


def difference(x: ca.SX, origin: ca.SX) -> ca.SX:
    """Return the change (nx - 1,) from `origin` to `x`, as `tangent.difference`."""
    turn = quaternion_product(conjugate(origin[3:7]), x[3:7])
    return ca.vertcat(x[:3] - origin[:3], 2 * ca.sign(turn[0]) * turn[1:4], x[7:] - origin[7:])


def difference_function(nx: int, scale: np.ndarray) -> ca.Function:
    """Return (x, origin) -> scale times the difference; its Jacobians over x's change and over origin."""
    x, origin, change = ca.SX.sym("a", nx), ca.SX.sym("b", nx), ca.SX.sym("da", nx - 1)
    scaled = scale * difference(retract(x, change), origin)
    outputs = [scaled, ca.jacobian(scaled, change), ca.jacobian(scaled, origin)]
    return ca.Function("difference", [x, origin], [_unchanged(out, change) for out in outputs])


def tangent_function(nx: int) -> ca.Function:
    """Return x -> derivative (nx, nx - 1) of the state by its change."""
    x, change = ca.SX.sym("x", nx), ca.SX.sym("dx", nx - 1)
    by_change = ca.jacobian(retract(x, change), change)
    return ca.Function("tangent", [x], [_unchanged(by_change, change)])


def retract_function(nx: int) -> ca.Function:
    """Return (x, change) -> state after the change."""
    x, change = ca.SX.sym("x", nx), ca.SX.sym("step", nx - 1)
    return ca.Function("retract", [x, change], [retract(x, change)])


def _unchanged(value: ca.SX, change: ca.SX) -> ca.SX:
    """Return an expression where the change is zero."""
    return ca.substitute(value, change, ca.DM.zeros(change.shape))
