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

from defplan_mj.body.elasticity import SYMMETRIC, lame
from defplan_mj.body.model import Body
from defplan_mj.body.rotation_strain import RotationStrain, strain_matrices
from defplan_mj.body.tetmesh import TetMesh, boundary, shape_gradients, volumes
from defplan_mj.dynamics.corotational import Response, density, polar, respond
from defplan_mj.dynamics.fem_contact import FemContact
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.errors import DefplanError

_SPEED_SQUARED = 1e-4  # m^2/s^2: rounds the tangential drag at rest, as in the reduced step
_STANDARD_GRAVITY = 9.81
_ROUNDS = 60  # of friction


@dataclass(frozen=True)
class StepInfo:
    """How the solve of a step went: Newton iterations, and the size of the last one, m."""

    iterations: int
    residual: float


class FullFem:
    """The full dynamics of a body; a state is two successive configurations x1, x0 (n, 3), m."""

    def __init__(
        self,
        body: Body,
        timestep: float = 0.04,
        drag: bool = True,
        terrain: Terrain | None = None,
        tolerance: float = 1e-6,
        max_newton: int = 60,
    ) -> None:
        """Prepare the constant parts.

        Args:
            timestep: s.
            drag: whether the medium acts.
            terrain: what the surface touches, by the reduced step's law of contact.
            tolerance: largest last Newton step, m.
        """
        self.body, self.timestep, self.drag = body, timestep, drag
        self.contact = None if terrain is None else FemContact(terrain, body, timestep)
        self.heavy = drag or terrain is not None
        self.tolerance, self.max_newton = tolerance, max_newton
        self.mesh = TetMesh(body.vertices, body.tetrahedra)
        self.shapes = RotationStrain(self.mesh, body.vertex_mass, body.modes)
        self.volumes = volumes(body.vertices, body.tetrahedra)
        self.gradients = shape_gradients(body.vertices, body.tetrahedra)
        self.mu, self.lam = lame(body.material)
        self.faces, _ = boundary(body.tetrahedra)
        self._pattern()
        # weights with sum_v w_v X_v = z: they read the body's z axis off its vertices
        second = np.einsum("v,vi,vj->ij", body.vertex_mass, body.vertices, body.vertices)
        moment = body.vertex_mass * (body.vertices @ np.linalg.inv(second)[:, 2])
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

    def _energy(self, strain: np.ndarray) -> float:
        """Return the elastic energy (J) of strains (t, 3, 3)."""
        return float(self.volumes @ density(strain, self.mu, self.lam))

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
        if self.contact is None:
            return self._minimise(problem, 2.0 * x1 - x0)
        # friction's normal forces are those of the last solution, until they are those of this one
        x, count = x1, 0
        for _ in range(_ROUNDS):
            problem.reference = x
            new, info = self._minimise(problem, x)
            change, x, count = float(np.abs(new - x).max()), new, count + info.iterations
            if change <= 10.0 * self.tolerance:
                return x, StepInfo(count, change)
        raise DefplanError(f"friction did not converge in {_ROUNDS} rounds (last {change:.1e} m)")

    def _minimise(self, problem: _Step, x: np.ndarray) -> tuple[np.ndarray, StepInfo]:
        now = problem.evaluate(x)
        for iteration in range(1, self.max_newton + 1):
            move, slope = problem.direction(now)
            size = float(np.abs(move).max())
            fraction = 1.0
            new = problem.evaluate(x + move)
            while new.energy > now.energy + 1e-4 * fraction * slope + 1e-11 * abs(now.energy):
                fraction *= 0.5
                if fraction < 1e-6:
                    break
                new = problem.evaluate(x + fraction * move)
            x, now = x + fraction * move, new
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
            "elastic": self._energy(s - np.eye(3)),
            "potential": -float(self._lift @ x1[:, 2]) if self.heavy else 0.0,
            "momentum": mass @ velocity,
            "angular_momentum": mass @ np.cross(x1, velocity),
        }


@dataclass(frozen=True)
class _Point:
    """An iterate: energy (J), gradient (n, 3), the material's response, drag's and contact's Hessians."""

    energy: float
    gradient: np.ndarray
    elastic: Response
    drag: np.ndarray | None
    contact: np.ndarray | None


class _Step:
    """The function one step minimises, with its gradient and Hessian."""

    def __init__(
        self, fem: FullFem, x1: np.ndarray, x0: np.ndarray, target: np.ndarray | None
    ) -> None:
        self.fem, self.h = fem, fem.timestep
        material = fem.body.material
        self.before = self.reference = x1
        self.guess = 2.0 * x1 - x0
        self.mass = fem.body.vertex_mass / self.h**2
        control = 0.0 if target is None else material.control_stiffness
        damping = material.damping / self.h
        _, before = polar(fem.deformation(x1))
        strain = fem._target_strain(target)
        # the three quadratic terms are one around their weighted mean, plus a constant
        self.weight = 1.0 + control + damping
        self.centre = np.eye(3) + (control * strain + damping * (before - np.eye(3))) / self.weight
        rest = self.centre - np.eye(3)
        self.constant = fem._energy(rest) + control * fem._energy(rest - strain)
        self.constant += damping * fem._energy(self.centre - before)
        self.centroids, self.areas = fem._drag_terms(x1)
        medium = fem.body.medium
        size = np.linalg.norm(self.areas, axis=1)
        self.normal = 0.5 * medium.density * medium.drag_normal / size**2
        self.tangent = 0.5 * medium.density * medium.drag_tangential * size

    def evaluate(self, x: np.ndarray) -> _Point:
        """Return energy (J) and gradient (n, 3) at x (n, 3), and what the Hessian needs."""
        fem = self.fem
        offset = x - self.guess
        energy = 0.5 * float(self.mass @ (offset**2).sum(1)) + self.constant
        gradient = self.mass[:, None] * offset
        if fem.heavy:
            energy -= float(fem._lift @ x[:, 2])
            gradient[:, 2] -= fem._lift
        elastic = respond(fem.deformation(x), self.centre, fem.mu, fem.lam)
        energy += self.weight * float(fem.volumes @ elastic.energy)
        stress = (self.weight * fem.volumes)[:, None, None] * elastic.stress
        _scatter(gradient, fem.body.tetrahedra, fem.gradients @ stress.transpose(0, 2, 1))
        drag_hessian = None
        if fem.drag:
            drag_energy, force, drag_hessian = self._drag(x)
            energy += drag_energy
            _scatter(gradient, fem.faces, np.repeat(force[:, None], 3, axis=1))
        contact_hessian = None
        if fem.contact is not None:
            part, force, contact_hessian = fem.contact.evaluate(x, self.before, self.reference)
            energy += part
            gradient[fem.body.surface] -= force
        return _Point(energy, gradient, elastic, drag_hessian, contact_hessian)

    def direction(self, point: _Point) -> tuple[np.ndarray, float]:
        """Return the Newton step (n, 3) and its slope; always downhill."""
        for definite in (False, True):
            factor = sla.splu(self.hessian(point, definite), **SYMMETRIC)
            move = -factor.solve(point.gradient.ravel()).reshape(-1, 3)
            slope = float((move * point.gradient).sum())
            if slope < 0.0 and (definite or factor.U.diagonal().min() > 0.0):
                break
        return move, slope

    def hessian(self, point: _Point, definite: bool = False) -> sp.csc_matrix:
        """Assemble the Hessian (3n, 3n): exact, or with the elastic part made definite."""
        fem = self.fem
        tangent = (self.weight * fem.volumes)[:, None, None] * point.elastic.tangent(definite)
        # R^T dF from the corners' moves: entry (i j) takes component k of corner a by R_ki g_aj
        rotation = point.elastic.rotation.transpose(0, 2, 1)
        map_ = rotation[:, :, None, None, :] * fem.gradients.transpose(0, 2, 1)[:, None, :, :, None]
        map_ = map_.reshape(-1, 9, 12)
        entries = (map_.transpose(0, 2, 1) @ (tangent @ map_)).ravel()
        if point.drag is None:
            surface = np.zeros(81 * len(fem.faces))
        else:
            blocks = point.drag[:, None, :, None, :]
            surface = np.broadcast_to(blocks, (len(fem.faces), 3, 3, 3, 3)).ravel()
        data = np.bincount(
            fem._place, np.concatenate([entries, surface]), minlength=len(fem._indices)
        )
        data[fem._diagonal] += np.repeat(self.mass, 3)
        size = 3 * len(self.mass)
        matrix = sp.csc_matrix((data, fem._indices, fem._indptr), (size, size))
        if point.contact is None:
            return matrix
        dof = 3 * fem.body.surface[:, None] + np.arange(3)
        rows, columns = np.repeat(dof, 3, axis=1).ravel(), np.tile(dof, 3).ravel()
        return matrix + sp.csc_matrix((point.contact.ravel(), (rows, columns)), (size, size))

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


def _scatter(out: np.ndarray, cells: np.ndarray, values: np.ndarray) -> None:
    """Add values (c, corners, 3) to rows `cells` (c, corners) of out (n, 3)."""
    for i in range(3):
        out[:, i] += np.bincount(cells.ravel(), values[:, :, i].ravel(), minlength=len(out))
