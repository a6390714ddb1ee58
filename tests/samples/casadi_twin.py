"""The symbolic twin of the reduced step: the oracle of the kernel's derivatives, from the equations alone.

It shares nothing with the C code: inertia sums over all vertices (not over moments), exponentials
are power series, the variational step comes from its discrete Lagrangian, derivatives are CasADi's.
Inputs are the kernel's state (docs/kernel.md).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.kernel.contact_points import contact_points

_TERMS = 40  # of the exponential's series: enough for |w| <= 5
_ROUNDING = 0.1  # of the normal force at speeds that would make it pull


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


def _with_jacobian(outputs, inputs, h) -> ca.Function:
    """Return a function of inputs and h: the outputs, then their derivatives by each input."""
    wanted = [ca.jacobian(out, s) for out in outputs for s in inputs]
    return ca.Function("f", [*inputs, h], [*outputs, *wanted])


def _flat(value) -> np.ndarray:
    return np.array(value).ravel()


class CasadiTwin:
    """Equations, solution and derivatives of one control step of `dynamics`, by either integrator.

    A node is (c, quaternion, q); an unknown Q = (c, t, q), its quaternion exp(t) times a given one.
    `division` of the methods: into how many parts the kernel divided each substep.
    """

    def __init__(self, dynamics: ReducedDynamics):
        self.dynamics, self.body, self.r = dynamics, dynamics.body, dynamics.body.n_modes
        self.h = ca.MX.sym("h")  # substep, the last input of all functions
        self._shape = self._shape_function()
        self._substep = self._substep_function()
        r = self.r
        x, u = ca.MX.sym("x", dynamics.nx), ca.MX.sym("u", dynamics.nu)
        before, last = nodes = [ca.MX.sym("before", 7 + r), ca.MX.sym("last", 7 + r)]
        self._first = _with_jacobian(self._nodes_of(x), [x], self.h)
        self._last = _with_jacobian([self._state_of(before, last, u)], [*nodes, u], self.h)
        unknown, near = ca.MX.sym("Q", 6 + r), ca.MX.sym("near", 4)
        self._placed = ca.Function(
            "placed",
            [unknown, near],
            [
                self._node(unknown, near),
                ca.jacobian(self._node(unknown, near), unknown),
            ],
        )

    # --- states and nodes

    def _nodes_of(self, x):
        """Return the node before that of the state x, and its own."""
        r, h, v = self.r, self.h, x[7 + self.r :]
        quat, q = x[3:7] / ca.norm_2(x[3:7]), x[7 : 7 + r]
        back = _product(quat, _half_turn(-h * v[3:6]))
        before = ca.vertcat(x[:3] - h * v[:3], back, q - h * v[6 : 6 + r])
        return before, ca.vertcat(x[:3], quat, q)

    def _state_of(self, before, last, u):
        h, r = self.h, self.r
        turn = _log(_product(ca.vertcat(before[3], -before[4:7]), last[3:7]))
        return ca.vertcat(
            last, (last[:3] - before[:3]) / h, turn / h, (last[7:] - before[7:]) / h, u[:r]
        )

    def _node(self, unknown, near):
        return ca.vertcat(unknown[:3], _product(_half_turn(unknown[3:6]), near), unknown[6:])

    def _share(self, k: int, n: int) -> float:
        """Of the way from the last target to the next, at node 1 (implicit Euler: 2) of substep k of n."""
        return (k if self.dynamics.integrator == "variational" else k + 1) / n

    # --- places

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

    def _directions(self, node, field: np.ndarray):
        """World-frame directions (3, n) of a field (n, 3, k+1) at a node."""
        flat = ca.DM(field.reshape(-1, field.shape[2]))
        local = ca.reshape(ca.mtimes(flat, self._shape(node[7:])), 3, field.shape[0])
        return ca.mtimes(_matrix(node[3:7]), local)

    def _points(self, node, field: np.ndarray):
        return node[:3] + self._directions(node, field)

    def _field(self) -> np.ndarray:
        return np.concatenate([self.body.vertices[:, :, None], self.body.basis], axis=2)

    # --- one substep

    def _substep_function(self) -> ca.Function:
        """Return (node 0, node 1, node 2, input) -> equations and their derivatives by each.

        The equations are derivatives by a virtual move of node 1, or for implicit Euler of node 2.
        """
        r = self.r
        nodes = [ca.MX.sym(f"x{i}", 7 + r) for i in range(3)]
        u, move = ca.MX.sym("u", self.dynamics.nu), ca.MX.sym("move", 6 + r)
        free = 1 if self.dynamics.integrator == "variational" else 2
        moved = list(nodes)
        moved[free] = ca.vertcat(
            nodes[free][:3] + move[:3],
            _product(_half_turn(move[3:6]), nodes[free][3:7]),
            nodes[free][7:] + move[6:],
        )
        potential = self._action(moved, u) if free == 1 else self._energy(moved, u)
        equations = ca.gradient(potential, move)
        for points, forces in self._forces(moved, nodes, u[r:], free == 1):
            equations -= ca.jtimes(ca.vec(points), move, ca.vec(forces), True)
        if free == 1:  # damping of both intervals, half each
            rate = (nodes[2][7:] - nodes[0][7:]) / (2 * self.h)
            equations[6:] += self.body.material.damping * ca.DM(self.body.stiffness) * rate
        equations = ca.substitute(equations, move, ca.DM.zeros(6 + r))
        return _with_jacobian([equations], [*nodes, u], self.h)

    def _fixed_potential(self, node):
        """Of gravity and righting."""
        medium, mass = self.body.medium, self.body.mass
        upright = _matrix(node[3:7])[2, 2]
        return -mass * medium.gravity * node[2] - mass * 9.81 * medium.righting_height * upright

    def _action(self, nodes, u):
        """-(L(x0, x1) + L(x1, x2)) / h, with L the discrete Lagrangian of an interval.

        L(a, b) = sum m |p_b - p_a|^2 / 2h - h V at the middle; gravity and righting at the ends.
        """
        h, action = self.h, 0
        mass, stiffness = ca.DM(self.body.vertex_mass), ca.DM(self.body.stiffness)
        control = self.body.material.control_stiffness
        for a, b in ((nodes[0], nodes[1]), (nodes[1], nodes[2])):
            way = self._points(b, self._field()) - self._points(a, self._field())
            kinetic = ca.dot(mass, ca.sum1(way**2).T) / (2 * h)
            middle = (a[7:] + b[7:]) / 2
            potential = ca.dot(stiffness, middle**2) / 2
            potential += control * ca.dot(stiffness, (middle - u[: self.r]) ** 2) / 2
            potential += (self._fixed_potential(a) + self._fixed_potential(b)) / 2
            action += kinetic - h * potential
        return -action / h

    def _energy(self, nodes, u):
        """Of which implicit Euler's next configuration is the stationary point."""
        h, (_, last, new) = self.h, nodes
        mass, stiffness = ca.DM(self.body.vertex_mass), ca.DM(self.body.stiffness)
        material = self.body.material
        p2, p1, p = (self._points(node, self._field()) for node in nodes)
        energy = ca.dot(mass, ca.sum1((p - 2 * p1 + p2) ** 2).T) / (2 * h**2)
        energy += self._fixed_potential(new)
        q, dq = new[7:], new[7:] - last[7:]
        energy += ca.dot(stiffness, q**2) / 2
        energy += material.control_stiffness * ca.dot(stiffness, (q - u[: self.r]) ** 2) / 2
        return energy + material.damping / (2 * h) * ca.dot(stiffness, dq**2)

    # --- forces

    def _forces(self, moved, nodes, given, variational: bool):
        """Return pairs of points that a virtual move takes along and forces on them, (3, n) each."""
        pairs, body = [], self.body
        at = moved[1 if variational else 2]
        if len(body.drag_areas):
            x0, x1, x2 = nodes
            a0, a1 = self._areas(x0), self._areas(x1)
            if variational:
                force = self._drag(x0, x1, (a0 + a1) / 2) + self._drag(x1, x2, (3 * a1 - a0) / 2)
                force /= 2
            else:
                force = self._drag(x1, x2, a1)
            pairs.append((self._points(at, body.drag_points), force))
        if self.dynamics.feet is not None:
            means = np.array([self._field()[foot].mean(0) for foot in self.dynamics.feet.vertices])
            pairs.append((self._points(at, means), ca.reshape(given, 3, len(means))))
        if self.dynamics.terrain is not None:
            touching = self._field()[body.surface][contact_points(body)]
            pairs.append((self._points(at, touching), self._contact(nodes[1], nodes[2], touching)))
        return pairs

    def _areas(self, node):
        t1, t2 = (self._directions(node, tangent) for tangent in self.body.drag_tangents)
        return ca.repmat(ca.DM(self.body.drag_areas).T, 3, 1) * ca.cross(t1, t2, 1)

    def _drag(self, a, b, area):
        """Forces of an interval: pressure along the area vectors, and friction of the skin."""
        medium = self.body.medium
        velocity = (
            self._points(b, self.body.drag_points) - self._points(a, self.body.drag_points)
        ) / self.h
        area2, normal = ca.sum1(area**2), ca.sum1(velocity * area)
        speed = ca.sqrt(ca.sum1(velocity**2) + 1e-4)
        pressure = medium.drag_normal * ca.fabs(normal) * normal / area2
        friction = medium.drag_tangential * ca.sqrt(area2) * speed
        wide = [ca.repmat(row, 3, 1) for row in (pressure, friction)]
        return -medium.density / 2 * (wide[0] * area + wide[1] * velocity)

    def _contact(self, last, new, touching: np.ndarray):
        """Forces of the terrain at the later end of an interval, with its velocity."""
        terrain, law = self.dynamics.terrain, self.dynamics.model.arrays[2]
        assert terrain is not None and law is not None
        stiffness, thickness = float(law[2]), float(law[3])
        p, p1 = self._points(new, touching), self._points(last, touching)
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
                approach = 1 - terrain.damping * ca.dot(v, normal)
                damped = approach + ca.sqrt(approach**2 + _ROUNDING**2)
                push = stiffness * ca.fmax(thickness - gap, 0) ** 2
                push *= damped / (1 + np.sqrt(1 + _ROUNDING**2))
                slip = v - ca.dot(v, normal) * normal
                speed = ca.sqrt(ca.dot(slip, slip) + terrain.slip_speed**2)
                force += push * normal - terrain.friction * push * slip / speed
            columns.append(force)
        return ca.horzcat(*columns)

    # --- numbers

    def _start(self, x: np.ndarray, x_next: np.ndarray, n: int) -> tuple[list[np.ndarray], float]:
        """Nodes (7 + r) of n substeps near the solution, the last two those of `x_next`; the substep."""
        h = self.dynamics.timestep / n
        last = _flat(self._first(x, h)[1])
        end = [_flat(node) for node in self._first(x_next, h)[:2]]
        between = [last + (end[0] - last) * (k + 1) / (n - 1) for k in range(n - 2)]
        nodes = [*between, *end][-n:]
        for node in nodes:
            node[3:7] /= np.linalg.norm(node[3:7])
        return nodes, h

    def _linearised(self, x: np.ndarray, u: np.ndarray, nodes: list[np.ndarray], h: float):
        """Equations of all substeps, their derivatives by all unknowns, by x and by u; of the nodes."""
        n, r, size = len(nodes), self.r, 6 + self.r
        before, last, *first = (np.array(value) for value in self._first(x, h))
        path = [before.ravel(), last.ravel(), *nodes]
        moves = [*first, *(np.array(self._placed(self._at(node), node[3:7])[1]) for node in nodes)]
        residual, matrix = np.zeros(n * size), np.zeros((n * size, n * size))
        a, b = np.zeros((n * size, len(x))), np.zeros((n * size, len(u)))
        for k in range(n):
            rows, share = slice(k * size, (k + 1) * size), self._share(k, n)
            target = x[13 + 2 * r :] + share * (u[:r] - x[13 + 2 * r :])
            value, *by = self._substep(*path[k : k + 3], np.concatenate([target, u[r:]]), h)
            residual[rows] = _flat(value)
            for i in range(3):
                moved, unknown = np.array(by[i]) @ moves[k + i], k + i - 2
                if unknown < 0:
                    a[rows] += moved
                else:
                    matrix[rows, unknown * size : (unknown + 1) * size] += moved
            a[rows, 13 + 2 * r :] += (1 - share) * np.array(by[3])[:, :r]
            b[rows] = np.array(by[3]) * np.where(np.arange(len(u)) < r, share, 1.0)
        return residual, matrix, a, b, moves

    def _at(self, node: np.ndarray, move: np.ndarray | None = None) -> np.ndarray:
        """Return the unknown of a node that is moved."""
        return np.concatenate([node[:3], np.zeros(3), node[7:]]) + (0.0 if move is None else move)

    def _solved(self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray, division: int):
        """The nodes (7 + r) of all substeps together, by Newton's method; the substep."""
        nodes, h = self._start(x, x_next, self.dynamics.substeps * division)
        size = np.inf
        for _ in range(20):
            residual, matrix = self._linearised(x, u, nodes, h)[:2]
            steps = -np.linalg.solve(matrix, residual).reshape(len(nodes), -1)
            nodes = [
                _flat(self._placed(self._at(node, step), node[3:7])[0])
                for node, step in zip(nodes, steps, strict=True)
            ]
            size, before = np.abs(steps).max(), size
            if size < 1e-13 or (size < 1e-9 and size > 0.1 * before):  # only rounding is left
                return nodes, h
        raise AssertionError(f"the twin's Newton steps do not end: {size}")

    def refine(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray, division: int = 1
    ) -> np.ndarray:
        """Return the twin's own next state, by Newton steps from the kernel's `x_next`."""
        nodes, h = self._solved(x, u, x_next, division)
        ends = [_flat(self._first(x, h)[1]), *nodes][-2:]
        return _flat(self._last(*ends, u, h)[0])

    def jacobians(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray, division: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return dx_next/dx and dx_next/du by the implicit function theorem."""
        nodes, h = self._solved(x, u, x_next, division)
        _, matrix, a, b, moves = self._linearised(x, u, nodes, h)
        ends = [_flat(self._first(x, h)[1]), *nodes][-2:]
        *by_ends, direct = (np.array(value) for value in self._last(*ends, u, h)[1:])
        size, out_x, out_u = 6 + self.r, np.zeros((len(x), len(x))), direct
        moved_x, moved_u = (-np.linalg.solve(matrix, m) for m in (a, b))
        for k, by in zip((len(nodes) - 2, len(nodes) - 1), by_ends, strict=True):
            if k < 0:
                out_x += by @ moves[1]
                continue
            rows = slice(k * size, (k + 1) * size)
            out_x += by @ moves[k + 2] @ moved_x[rows]
            out_u = out_u + by @ moves[k + 2] @ moved_u[rows]
        return out_x, out_u
