"""f, the full finite-element dynamics: implicit Euler on all vertices; the truth for tests.

A step minimises, over the vertex positions x,

    sum_v m_v |x_v - (2 x_v,1 - x_v,0)|^2 / 2 h^2  +  sum_e V_e [psi(S_e - I)
        + k_c psi(S_e - I - strain_e(u)) + beta/h psi(S_e - S_e,1)]  +  drag  +  righting, gravity,

with psi(E) = mu |E|^2 + lambda/2 tr(E)^2 and F_e = R_e S_e the polar decomposition of the
deformation gradient: corotational linear elasticity. In rotation-strain coordinates S_e - I is
the linear strain of the shape q, so the three terms are those of the reduced step,
1/2 q^T K q, k_c/2 (q - u)^T K (q - u) and beta/2h (q - q_1)^T K (q - q_1), without its kinematic
restriction: the pull towards a target shape u acts on the strain in each tetrahedron's own
rotated frame. Drag is the reduced step's potential, on every surface triangle instead of patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from defplan_mj.body.elasticity import SYMMETRIC, element_stiffness, lame
from defplan_mj.body.model import Body
from defplan_mj.body.rotation_strain import RotationStrain, strain_matrices
from defplan_mj.body.tetmesh import TetMesh, boundary, shape_gradients, volumes
from defplan_mj.errors import DefplanError

_SPEED_SQUARED = 1e-4  # m^2/s^2: rounds the tangential drag at rest, as in the reduced step
_STANDARD_GRAVITY = 9.81


@dataclass(frozen=True)
class StepInfo:
    """How the solve of a step went: Newton iterations, and the size of the last one, m."""

    iterations: int
    residual: float


def polar(f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split F = R S: rotations R (t, 3, 3), det 1, and symmetric S (t, 3, 3)."""
    u, s, vt = np.linalg.svd(f)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= sign[:, None]
    s[:, 2] *= sign
    return u @ vt, np.einsum("eji,ej,ejk->eik", vt, s, vt)


def _axial(y: np.ndarray) -> np.ndarray:
    """Return the axial vector (t, 3) of Y - Y^T (t, 3, 3)."""
    skew = y - y.transpose(0, 2, 1)
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def _cross_matrix(w: np.ndarray) -> np.ndarray:
    """Return the matrices [w] (..., 3, 3) with [w] v = w x v."""
    matrix = np.zeros((*w.shape, 3))
    matrix[..., 2, 1], matrix[..., 1, 2] = w[..., 0], -w[..., 0]
    matrix[..., 0, 2], matrix[..., 2, 0] = w[..., 1], -w[..., 1]
    matrix[..., 1, 0], matrix[..., 0, 1] = w[..., 2], -w[..., 2]
    return matrix


class FullFem:
    """The full dynamics of a body; a state is two successive configurations x1, x0 (n, 3), m."""

    def __init__(
        self,
        body: Body,
        timestep: float = 0.04,
        drag: bool = True,
        tolerance: float = 1e-6,
        max_newton: int = 60,
    ) -> None:
        """Prepare the constant parts.

        Args:
            timestep: s.
            drag: whether the medium acts.
            tolerance: largest last Newton step, m.
        """
        self.body, self.timestep, self.drag = body, timestep, drag
        self.tolerance, self.max_newton = tolerance, max_newton
        self.mesh = TetMesh(body.vertices, body.tetrahedra)
        self.shapes = RotationStrain(self.mesh, body.vertex_mass, body.modes)
        self.volumes = volumes(body.vertices, body.tetrahedra)
        self.gradients = shape_gradients(body.vertices, body.tetrahedra)
        self.mu, self.lam = lame(body.material)
        self.stiffness = element_stiffness(self.mesh, body.material)
        crosses = _cross_matrix(self.gradients)
        self._twist = crosses * np.sqrt(self.volumes)[:, None, None, None]
        self.faces, _ = boundary(body.tetrahedra)
        self._pattern()
        height = body.vertices[:, 2]
        moment = body.vertex_mass * height / (body.vertex_mass @ height**2)
        righting = body.mass * _STANDARD_GRAVITY * body.medium.righting_height * moment
        self._lift = righting + body.vertex_mass * body.medium.gravity  # N along z

    def _pattern(self) -> None:
        """Find where element and surface entries go in the sparse matrix, once."""
        n = len(self.body.vertices)
        rows, columns = [], []
        for cells in (self.body.tetrahedra, self.faces):
            dof = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), -1)
            rows.append(np.repeat(dof, dof.shape[1], axis=1).ravel())
            columns.append(np.tile(dof, (1, dof.shape[1])).ravel())
        row, column = np.concatenate(rows), np.concatenate(columns)
        keys, self._place = np.unique(column * (3 * n) + row, return_inverse=True)
        self._indices = (keys % (3 * n)).astype(np.int32)
        starts = np.searchsorted(keys // (3 * n), np.arange(3 * n + 1))
        self._indptr = starts.astype(np.int32)
        self._diagonal = np.searchsorted(keys, np.arange(3 * n) * (3 * n + 1))
        self._n_element = len(rows[0])

    def shape(self, q: np.ndarray) -> np.ndarray:
        """Return the vertices (n, 3) of the exact shape q (r,), centre of mass at the origin."""
        return self.body.vertices + self.shapes.displacement(q)[0]

    def deformation(self, x: np.ndarray) -> np.ndarray:
        """Return the deformation gradients F (t, 3, 3) at vertices x (n, 3)."""
        return np.einsum("eai,eaj->eij", x[self.body.tetrahedra], self.gradients, optimize=True)

    def _target_strain(self, target: np.ndarray | None) -> np.ndarray:
        if target is None:
            return np.zeros((len(self.volumes), 3, 3))
        target = np.asarray(target, float)
        if target.shape != (self.body.n_modes,):
            raise DefplanError(
                f"the target shape has shape {target.shape}, wanted ({self.body.n_modes},)"
            )
        return strain_matrices(self.shapes.features[:, 3:] @ target)

    def _psi(self, strain: np.ndarray) -> np.ndarray:
        trace = np.trace(strain, axis1=1, axis2=2)
        return self.mu * (strain**2).sum((1, 2)) + 0.5 * self.lam * trace**2

    def _drag_terms(self, x1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return centres (f, 3) and area vectors (f, 3) of the surface triangles at x1."""
        a, b, c = (x1[self.faces[:, i]] for i in range(3))
        return (a + b + c) / 3.0, 0.5 * np.cross(b - a, c - a)

    def step(self, x1: np.ndarray, x0: np.ndarray, target: np.ndarray | None = None) -> np.ndarray:
        """Return the configuration (n, 3) one time step after x1, which came after x0.

        Args:
            target: (r,) target shape; None lets the control stiffness go, too.

        Raises:
            DefplanError: the solve did not converge.
        """
        return self.step_info(x1, x0, target)[0]

    def step_info(
        self, x1: np.ndarray, x0: np.ndarray, target: np.ndarray | None = None
    ) -> tuple[np.ndarray, StepInfo]:
        """Like `step`, with how the solve went."""
        problem = _Step(self, x1, x0, target)
        x = 2.0 * x1 - x0
        energy, gradient, hessian = problem.evaluate(x, True)
        size = np.inf
        for iteration in range(1, self.max_newton + 1):
            move = -sla.splu(hessian, **SYMMETRIC).solve(gradient.ravel()).reshape(-1, 3)
            slope = float((move * gradient).sum())
            size = float(np.abs(move).max())
            fraction = 1.0
            while True:
                new, new_gradient, new_hessian = problem.evaluate(
                    x + fraction * move, size > self.tolerance
                )
                enough = energy + 1e-4 * fraction * slope + 1e-11 * abs(energy)
                if new <= enough or fraction < 1e-6:
                    break
                fraction *= 0.5
            x = x + fraction * move
            energy, gradient, hessian = new, new_gradient, new_hessian
            if size <= self.tolerance:
                return x, StepInfo(iteration, size)
        raise DefplanError(
            f"the full FEM step did not converge in {self.max_newton} iterations"
            f" (last one {size:.1e} m)"
        )

    def rollout(self, x1: np.ndarray, x0: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return the configurations (N + 1, n, 3) from x1 on under target shapes (N, r)."""
        states = [np.asarray(x0, float), np.asarray(x1, float)]
        for target in targets:
            states.append(self.step(states[-1], states[-2], target))
        return np.stack(states[1:])

    def energy(self, x1: np.ndarray, x0: np.ndarray) -> dict[str, float | np.ndarray]:
        """Return kinetic, elastic and potential energy (J), linear and angular momentum of a state."""
        mass, velocity = self.body.vertex_mass, (x1 - x0) / self.timestep
        _, s = polar(self.deformation(x1))
        return {
            "kinetic": 0.5 * float(mass @ (velocity**2).sum(1)),
            "elastic": float(self.volumes @ self._psi(s - np.eye(3))),
            "potential": -float(self._lift @ x1[:, 2]) if self.drag else 0.0,
            "momentum": mass @ velocity,
            "angular_momentum": mass @ np.cross(x1, velocity),
        }


class _Step:
    """The function one step minimises, with its gradient and a positive definite Hessian."""

    def __init__(
        self, fem: FullFem, x1: np.ndarray, x0: np.ndarray, target: np.ndarray | None
    ) -> None:
        self.fem, self.h = fem, fem.timestep
        material = fem.body.material
        self.guess = 2.0 * x1 - x0
        self.mass = fem.body.vertex_mass / self.h**2
        control = 0.0 if target is None else material.control_stiffness
        damping = material.damping / self.h
        _, before = polar(fem.deformation(x1))
        strain = fem._target_strain(target)
        # the three quadratic terms are one around their weighted mean, plus a constant
        self.weight = 1.0 + control + damping
        self.centre = np.eye(3) + (control * strain + damping * (before - np.eye(3))) / self.weight
        self.constant = float(
            fem.volumes
            @ (
                fem._psi(self.centre - np.eye(3))
                + control * fem._psi(self.centre - np.eye(3) - strain)
                + damping * fem._psi(self.centre - before)
            )
        )
        self.centroids, self.areas = fem._drag_terms(x1)
        medium = fem.body.medium
        size = np.linalg.norm(self.areas, axis=1)
        self.normal = 0.5 * medium.density * medium.drag_normal / size**2
        self.tangent = 0.5 * medium.density * medium.drag_tangential * size

    def evaluate(self, x: np.ndarray, derivatives: bool):
        """Return energy (J), gradient (n, 3) and Hessian (3n, 3n); the last None if not wanted."""
        fem = self.fem
        offset = x - self.guess
        energy = 0.5 * float(self.mass @ (offset**2).sum(1)) + self.constant
        gradient = self.mass[:, None] * offset
        if fem.drag:
            energy -= float(fem._lift @ x[:, 2])
            gradient[:, 2] -= fem._lift

        rotation, s = polar(fem.deformation(x))
        strain = s - self.centre
        energy += self.weight * float(fem.volumes @ fem._psi(strain))
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        stress = 2.0 * fem.mu * strain + fem.lam * trace
        # S also changes because R turns with F; zero if S and the centre have the same axes
        spin = np.trace(s, axis1=1, axis2=2)[:, None, None] * np.eye(3) - s
        spin = np.linalg.inv(_away_from_zero(spin))
        torque = np.einsum("eij,ej->ei", spin, _axial(stress @ s))
        local = self.weight * fem.volumes[:, None, None] * (stress - _cross_matrix(torque))
        force = np.einsum("eij,eaj->eai", rotation @ local, fem.gradients, optimize=True)
        for i in range(3):
            gradient[:, i] += np.bincount(
                fem.body.tetrahedra.ravel(), force[:, :, i].ravel(), minlength=len(x)
            )
        drag_hessian = None
        if fem.drag:
            drag_energy, drag_force, drag_hessian = self._drag(x)
            energy += drag_energy
            for i in range(3):
                gradient[:, i] += np.bincount(
                    fem.faces.ravel(), np.repeat(drag_force[:, i], 3), minlength=len(x)
                )
        if not derivatives:
            return energy, gradient, None
        return energy, gradient, self._hessian(rotation, strain, spin, drag_hessian)

    def _hessian(
        self,
        rotation: np.ndarray,
        strain: np.ndarray,
        spin: np.ndarray,
        drag: np.ndarray | None,
    ) -> sp.csc_matrix:
        """Assemble: warped stiffness, the rotations' own stiffness where positive, drag, mass."""
        fem = self.fem
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        held = fem.lam * trace - 2.0 * fem.mu * self.centre
        whole = np.trace(held, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        turning = 0.5 * (whole - held) @ spin
        turning = fem.mu * np.eye(3) + 0.5 * (turning + turning.transpose(0, 2, 1))
        values, axes = np.linalg.eigh(turning)
        root = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        twist = np.einsum("eaij,eik->eajk", fem._twist, root, optimize=True).reshape(-1, 12, 3)
        element = fem.stiffness.reshape(-1, 12, 12) + twist @ twist.transpose(0, 2, 1)
        element = element.reshape(-1, 4, 3, 4, 3).transpose(0, 1, 3, 2, 4)
        turned = (
            rotation[:, None, None] @ element @ rotation[:, None, None].transpose(0, 1, 2, 4, 3)
        )
        entries = self.weight * turned.transpose(0, 1, 3, 2, 4).ravel()
        if drag is None:
            surface = np.zeros(81 * len(fem.faces))
        else:
            surface = np.broadcast_to(drag[:, None, :, None, :], (len(drag), 3, 3, 3, 3)).ravel()
        data = np.bincount(
            fem._place, np.concatenate([entries, surface]), minlength=len(fem._indices)
        )
        data[fem._diagonal] += np.repeat(self.mass, 3)
        size = 3 * len(self.mass)
        return sp.csc_matrix((data, fem._indices, fem._indptr), (size, size))

    def _drag(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Return energy, force per corner (f, 3) and Hessian per pair of corners (f, 3, 3)."""
        corners = x[self.fem.faces]
        v = (corners.mean(1) - self.centroids) / self.h
        through = np.einsum("fi,fi->f", v, self.areas)
        speed = np.sqrt(np.einsum("fi,fi->f", v, v) + _SPEED_SQUARED)
        energy = self.h / 3.0 * (self.normal * np.abs(through) ** 3 + self.tangent * speed**3).sum()
        normal = self.normal * np.abs(through)
        tangent = self.tangent * speed
        force = (normal * through)[:, None] * self.areas + tangent[:, None] * v
        hessian = 2.0 * normal[:, None, None] * self.areas[:, :, None] * self.areas[:, None, :]
        hessian += tangent[:, None, None] * np.eye(3)
        hessian += (self.tangent / speed)[:, None, None] * v[:, :, None] * v[:, None, :]
        return float(energy), force / 3.0, hessian / (9.0 * self.h)


def _away_from_zero(spin: np.ndarray) -> np.ndarray:
    """Keep tr(S) I - S invertible: it is singular only where a tetrahedron is turned inside out."""
    values, axes = np.linalg.eigh(spin)
    values = np.maximum(values, 0.05)
    return (axes * values[:, None, :]) @ axes.transpose(0, 2, 1)
