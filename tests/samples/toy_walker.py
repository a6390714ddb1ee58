"""A walker of which everything is known: one rigid body on four massless feet that the target shape places."""

from __future__ import annotations

import casadi as ca
import numpy as np

from defplan_mj.dynamics.symbolic import quaternion_matrix, quaternion_product
from defplan_solvers.cio.model import Walker

MASS, INERTIA, STAND, STIFF = 2.0, 0.05, 0.3, 0.7
HOME = np.array(
    [[0.3, 0.2, -STAND], [0.3, -0.2, -STAND], [-0.3, 0.2, -STAND], [-0.3, -0.2, -STAND]]
)


def toy_walker(timestep: float = 0.03, friction: float = 0.8) -> Walker:
    """State: position, quaternion, 12 offsets of the feet (body frame, dm), velocities, target.

    Offsets follow the target shape by STIFF a step; translation and rotation are semi-implicit.
    """
    r, h = 12, timestep
    x, u, forces = ca.SX.sym("x", 13 + 3 * r), ca.SX.sym("u", r), ca.SX.sym("f", 3, 4)
    c, quat, q, v, spin = x[:3], x[3:7], x[7 : 7 + r], x[7 + r : 10 + r], x[10 + r : 13 + r]
    quat = quat / ca.norm_2(quat)
    arms = HOME.T + 0.1 * ca.reshape(q, 3, 4)
    turn = quaternion_matrix(quat)
    torque = sum(ca.cross(turn @ arms[:, f], forces[:, f]) for f in range(4))
    v = v + h * (ca.sum2(forces) / MASS - ca.DM([0, 0, 9.81]))
    spin = spin + h * (turn.T @ torque) / INERTIA
    turned = quaternion_product(quat, ca.vertcat(1, h * spin / 2))
    q_next = q + STIFF * (u - q)
    x_next = ca.vertcat(c + h * v, turned / ca.norm_2(turned), q_next, v, spin, (q_next - q) / h, u)
    feet = c + turn @ arms
    rest = np.zeros(13 + 3 * r)
    rest[2], rest[3] = STAND, 1
    return Walker(
        step=ca.Function("step", [x, u, forces], [x_next], ["x", "u", "forces"], ["x_next"]),
        feet=ca.Function("feet", [x], [feet], ["x"], ["p"]),
        rest=rest,
        carried=np.full(4, 0.25),
        give=np.full(4, 1e-3),
        timestep=h,
        weight=9.81 * MASS,
        friction=friction,
        amplitude=np.full(r, 1.0),
    )
