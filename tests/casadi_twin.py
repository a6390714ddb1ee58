"""The symbolic twin of the reduced step: the oracle of the kernel's derivatives, from the equations alone.

It shares nothing with the C code: inertia sums over all vertices (not over moments), exponentials
are power series, derivatives are CasADi's. Inputs are the kernel's state (docs/kernel.md).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.kernel.contact_points import contact_points

_TERMS = 40  # of the exponential's series: enough for |w| <= 5


def _skew(w):
    zero = 0 * w[0]
    return ca.vertcat(
        ca.horzcat(zero, -w[2], w[1]), ca.horzcat(w[2], zero, -w[0]), ca.horzcat(-w[1], w[0], zero)
    )


def _exp(w):
    """Matrix exponential of [w] by its series (Horner)."""
    out = ca.DM.eye(3)
    for k in range(_TERMS, 0, -1):
        out = ca.DM.eye(3) + ca.mtimes(_skew(w), out) / k
    return out


def _matrix(quat):
    w, v = quat[0], quat[1:4]
    return (w**2 - ca.dot(v, v)) * ca.DM.eye(3) + 2 * ca.mtimes(v, v.T) + 2 * w * _skew(v)


def _product(a, b):
    return ca.vertcat(
        a[0] * b[0] - ca.dot(a[1:4], b[1:4]),
        a[0] * b[1:4] + b[0] * a[1:4] + ca.cross(a[1:4], b[1:4]),
    )


def _half_turn(w):
    """Unit quaternion of exp([w]) by series: the exponential of the pure quaternion w / 2."""
    pure, out, one = ca.vertcat(0, w / 2), ca.DM([1, 0, 0, 0]), ca.DM([1, 0, 0, 0])
    for k in range(_TERMS, 0, -1):
        out = one + _product(pure, out) / k
    return out


def _log(quat):
    """Shortest rotation vector of a unit quaternion that is not the identity."""
    sine = ca.norm_2(quat[1:4])
    sign = ca.if_else(quat[0] < 0, -1, 1)
    return sign * 2 * ca.atan2(sine, sign * quat[0]) / sine * quat[1:4]


class CasadiTwin:
    """Energy, stationarity and derivatives of one step of `dynamics`.

    Unknowns Q = (c, t, q) of the new configuration, R = exp([t]) R_near for a given quaternion.
    """

    def __init__(self, dynamics: ReducedDynamics):
        body, self.r, self.h = dynamics.body, dynamics.body.n_modes, dynamics.timestep
        self.body = body
        self._shape = self._shape_function()
        r, h = self.r, self.h
        x, near = ca.MX.sym("x", 13 + 2 * r), ca.MX.sym("near", 4)
        u = ca.MX.sym("u", dynamics.nu)
        unknown = ca.MX.sym("Q", 6 + r)

        quat = x[3:7] / ca.norm_2(x[3:7])
        c1, q1, v = x[:3], x[7 : 7 + r], x[7 + r :]
        new = (unknown[:3], ca.mtimes(_exp(unknown[3:6]), _matrix(near)), unknown[6:])
        last = (c1, _matrix(quat), q1)
        before = (c1 - h * v[:3], ca.mtimes(last[1], _exp(-h * v[3:6])), q1 - h * v[6:])
        energy = self._energy(new, last, before, u[:r], dynamics)

        new_quat = _product(_half_turn(unknown[3:6]), near)
        turn = _log(_product(ca.vertcat(quat[0], -quat[1:4]), new_quat))
        out = ca.vertcat(
            *(new[0], new_quat, new[2]),
            *((new[0] - c1) / h, turn / h, (new[2] - q1) / h),
        )
        gradient = ca.gradient(energy, unknown)
        for points, forces in self._forces(new, last, u[r:], dynamics):
            gradient -= ca.jtimes(ca.vec(points), unknown, ca.vec(forces), True)
        inputs = [unknown, near, x, u]
        self.energy = ca.Function("energy", inputs, [energy])
        self._solve = ca.Function("solve", inputs, [gradient, ca.jacobian(gradient, unknown), out])
        wanted = [
            *(ca.jacobian(gradient, s) for s in (unknown, x, u)),
            *(ca.jacobian(out, s) for s in (unknown, x)),
        ]
        self._derivatives = ca.Function("derivatives", inputs, wanted)

    def _shape_function(self) -> ca.Function:
        """Return q -> (1, z(q)): F = exp([w]) (I + E) of the sampled tetrahedra, mapped linearly."""
        q = ca.SX.sym("q", self.r)
        features = []
        for sample in self.body.feature_map:
            x = ca.mtimes(ca.DM(sample), q)
            strain = ca.vertcat(
                ca.horzcat(x[3], x[4], x[5]),
                ca.horzcat(x[4], x[6], x[7]),
                ca.horzcat(x[5], x[7], x[8]),
            )
            f = ca.mtimes(_exp(x[:3]), ca.DM.eye(3) + strain) - ca.DM.eye(3)
            features.append(ca.vec(f.T))
        z = ca.mtimes(ca.DM(self.body.feature_weights), ca.vertcat(*features))
        return ca.Function("shape", [q], [ca.vertcat(1, z)])

    def _points(self, field: np.ndarray, shape):
        """World-frame directions (3, n) of a field (n, 3, k+1) for the coordinates (1, z)."""
        flat = ca.DM(field.reshape(-1, field.shape[2]))
        return ca.reshape(ca.mtimes(flat, shape), 3, field.shape[0])

    def _energy(self, new, last, before, u, dynamics: ReducedDynamics):
        body, h = self.body, self.h
        medium, material = body.medium, body.material
        shapes = [self._shape(config[2]) for config in (new, last, before)]
        field = np.concatenate([body.vertices[:, :, None], body.basis], axis=2)
        p, p1, p2 = (
            config[0] + ca.mtimes(config[1], self._points(field, shape))
            for config, shape in zip((new, last, before), shapes, strict=True)
        )
        mass = ca.DM(body.vertex_mass)
        energy = ca.dot(mass, ca.sum1((p - 2 * p1 + p2) ** 2).T) / (2 * h**2)
        energy -= body.mass * medium.gravity * new[0][2]
        energy -= body.mass * 9.81 * medium.righting_height * new[1][2, 2]

        stiffness, q, dq = ca.DM(body.stiffness), new[2], new[2] - last[2]
        energy += ca.dot(stiffness, q**2) / 2
        energy += material.control_stiffness * ca.dot(stiffness, (q - u) ** 2) / 2
        energy += material.damping / (2 * h) * ca.dot(stiffness, dq**2)

        if not len(body.drag_areas):
            return energy
        before_step = last[0] + ca.mtimes(last[1], self._points(body.drag_points, shapes[1]))
        after_step = new[0] + ca.mtimes(new[1], self._points(body.drag_points, shapes[0]))
        velocity = (after_step - before_step) / h
        t1, t2 = (
            ca.mtimes(last[1], self._points(tangent, shapes[1])) for tangent in body.drag_tangents
        )
        area = ca.repmat(ca.DM(body.drag_areas).T, 3, 1) * ca.cross(t1, t2, 1)
        area2, normal = ca.sum1(area**2), ca.sum1(velocity * area)
        speed2 = ca.sum1(velocity**2) + 1e-4
        pressure = medium.drag_normal * ca.fabs(normal) * normal**2 / area2
        friction = medium.drag_tangential * ca.sqrt(area2) * speed2 * ca.sqrt(speed2)
        return energy + h * medium.density / 6 * ca.sum2(pressure + friction)

    def _forces(self, new, last, given, dynamics: ReducedDynamics):
        """Return pairs of points and forces on them (3, n): of the feet, and of the terrain's geoms."""
        body, pairs = self.body, []
        field = np.concatenate([body.vertices[:, :, None], body.basis], axis=2)
        if dynamics.feet is not None:
            means = np.array([field[foot].mean(0) for foot in dynamics.feet.vertices])
            p = new[0] + ca.mtimes(new[1], self._points(means, self._shape(new[2])))
            pairs.append((p, ca.reshape(given, 3, len(means))))
        if dynamics.terrain is None:
            return pairs
        terrain, law = dynamics.terrain, dynamics.model.arrays[2]
        stiffness, thickness = float(law[2]), float(law[3])
        touching = field[body.surface][contact_points(body)]
        p, p1 = (
            config[0] + ca.mtimes(config[1], self._points(touching, self._shape(config[2])))
            for config in (new, last)
        )
        columns = []
        for s in range(len(touching)):
            force, v = ca.MX.zeros(3), (p[:, s] - p1[:, s]) / self.h
            for geom in terrain.geoms:
                axes = _matrix(ca.DM(geom.quaternion) / ca.norm_2(ca.DM(geom.quaternion)))
                arm = ca.mtimes(axes.T, p[:, s] - ca.DM(geom.position))
                if geom.shape == "plane":
                    gap, normal = arm[2], ca.mtimes(axes, ca.DM([0, 0, 1]))
                else:
                    assert geom.shape == "sphere"
                    gap, normal = (
                        ca.norm_2(arm) - geom.size[0],
                        ca.mtimes(axes, arm / ca.norm_2(arm)),
                    )
                push = stiffness * ca.fmax(thickness - gap, 0) ** 2
                slip = v - ca.dot(v, normal) * normal
                speed = ca.sqrt(ca.dot(slip, slip) + terrain.slip_speed**2)
                force += push * normal - terrain.friction * push * slip / speed
            columns.append(force)
        pairs.append((p, ca.horzcat(*columns)))
        return pairs

    def refine(self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray) -> np.ndarray:
        """Return the twin's own next state, by Newton steps from the kernel's `x_next`."""
        near = x_next[3:7]
        unknown = np.concatenate([x_next[:3], np.zeros(3), x_next[7 : 7 + self.r]])
        for _ in range(3):
            gradient, hessian, out = self._solve(unknown, near, x, u)
            unknown = unknown - np.linalg.solve(np.array(hessian), np.array(gradient).ravel())
        return np.array(self._solve(unknown, near, x, u)[2]).ravel()

    def jacobians(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return dx_next/dx and dx_next/du by the implicit function theorem."""
        unknown = np.concatenate([x_next[:3], np.zeros(3), x_next[7 : 7 + self.r]])
        values = self._derivatives(unknown, x_next[3:7], x, u)
        hessian, mixed_x, mixed_u, out_unknown, out_x = (np.array(value) for value in values)
        a = out_x - out_unknown @ np.linalg.solve(hessian, mixed_x)
        return a, -out_unknown @ np.linalg.solve(hessian, mixed_u)
