"""One step of the full FEM: the function that it minimises, its derivatives, and Newton's method on it.

With the unknown x (n, 3), V the volumes and F(x) = R S the deformation gradients,

    E(x) = 1/2 sum_v a_v |x_v - guess_v|^2 + l.x + sum_e V_e sum_i c_i psi(S_e - T_i)
           + friction(x) + drag(x) + contact(x),     psi(E) = mu |E|^2 + lambda/2 tr(E)^2.

`full_fem` says what a, guess, l and the centres T_i are for each integrator. The terms in psi are one around
the mean centre, plus a constant that is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.corotational import (
    Polar,
    isotropic,
    polar,
    second_derivative,
    stress,
)
from defplan_mj.body.elements import Elements
from defplan_mj.body.model import Medium
from defplan_mj.body.sparse_cholesky import CholeskyFactor
from defplan_mj.dynamics.fem_contact import FemContact, HeldContact

_SPEED_SQUARED = 1e-4  # m^2/s^2: rounds the tangential drag at rest, as in the reduced step
_KEPT = 0.1  # of the last step's size: how small the next must be for the factor to be kept
_NOISE = 1e-11  # of the energy, which a line search does not mind


class Drag:
    """The medium's force on every surface triangle over an interval, with a potential in its end x.

    f = -(rho C_d/2) |v.a| (v.a) a/|a|^2 - (rho C_f/2) |a| sqrt(|v|^2 + 1e-4) v, with the area vector a.
    """

    def __init__(
        self,
        elements: Elements,
        medium: Medium,
        centres: np.ndarray,
        areas: np.ndarray,
        time: float,
        factor: float = 1.0,
    ) -> None:
        """Prepare the coefficients; v = (centre(x) - centres) / time, m/s; centres, areas (3, f)."""
        size = np.linalg.norm(areas, axis=0)
        self._elements, self._centres, self._areas, self._time = elements, centres, areas, time
        self._normal = 0.5 * factor * medium.density * medium.drag_normal / size**2
        self._tangent = 0.5 * factor * medium.density * medium.drag_tangential * size

    def _motion(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        centre = x[self._elements.faces].mean(1).T
        v = (centre - self._centres) / self._time
        through = (v * self._areas).sum(0)
        return v, through, np.sqrt((v * v).sum(0) + _SPEED_SQUARED)

    def energy(self, x: np.ndarray) -> float:
        """Return the potential at vertices x (n, 3), J."""
        _, through, speed = self._motion(x)
        density = self._normal * np.abs(through) ** 3 + self._tangent * speed**3
        return float(self._time / 3.0 * density.sum())

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Return the gradient (n, 3) of the potential, minus the force, N."""
        v, through, speed = self._motion(x)
        force = self._normal * np.abs(through) * through * self._areas + self._tangent * speed * v
        return self._elements.face_forces(force / 3.0)

    def hessian(self, x: np.ndarray) -> np.ndarray:
        """Return the second derivative (3, 3, f) by each pair of corners, N/m."""
        v, through, speed = self._motion(x)
        tangent = self._tangent * speed
        hessian = 2.0 * self._normal * np.abs(through) * self._areas[:, None] * self._areas
        hessian += self._tangent / speed * v[:, None] * v
        hessian += tangent * np.eye(3)[:, :, None]
        return hessian / (9.0 * self._time)


class Viscosity:
    """Inner friction with the potential c sum_e V_e psi(dS/dF (F(x) - F(origin))), dS/dF that at a place."""

    def __init__(
        self, elements: Elements, place: np.ndarray, origin: np.ndarray, factor: float
    ) -> None:
        """Prepare dS/dF at `place` (n, 3); c is `factor`."""
        self._elements, self._origin, self._factor = elements, origin, factor
        self._parts = polar(elements.deformation(place))
        self.hessian = elements.stiffness(self._parts, factor)  # (3, 3, 10, t), N/m

    def _strain(self, x: np.ndarray) -> np.ndarray:
        return self._parts.strain_rate(self._elements.deformation(x - self._origin))

    def energy(self, x: np.ndarray) -> float:
        """Return the potential at vertices x (n, 3), J."""
        return self._factor * self._elements.energy(self._strain(x))

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Return the gradient (n, 3) of the potential, N."""
        return self._elements.elastic_forces(self._parts, self._factor * self._strain(x))


@dataclass(frozen=True)
class Touch:
    """Contact in a step whose substep ends in `scale` x - (`scale` - 1) start, `time` seconds after start."""

    contact: FemContact
    start: np.ndarray
    time: float
    scale: float

    def end(self, x: np.ndarray) -> np.ndarray:
        """Return the vertices (n, 3) at the end of the substep."""
        return self.scale * x - (self.scale - 1.0) * self.start

    def hold(self, x: np.ndarray) -> HeldContact:
        """Evaluate the law of contact at x (n, 3)."""
        return self.contact.hold(self.end(x), self.start, self.time)


@dataclass(frozen=True)
class Step:
    """The function E that one step minimises.

    Attributes:
        elements: the mesh.
        inertia: (n,) a, kg/s^2.
        guess: (n, 3) m, also where Newton's method starts if no better start is known.
        linear: (n, 3) l, N.
        weight: sum of the c_i.
        centre: (3, 3, t) mean of the T_i, weighted with the c_i.
        friction, drag: or None.
        contact: or None.
    """

    elements: Elements
    inertia: np.ndarray
    guess: np.ndarray
    linear: np.ndarray
    weight: float
    centre: np.ndarray
    friction: Viscosity | None = None
    drag: Drag | None = None
    contact: Touch | None = None

    def hold(self, x: np.ndarray) -> HeldContact | None:
        """Return the contact of vertices x (n, 3), if there is any."""
        return None if self.contact is None else self.contact.hold(x)

    def energy(self, x: np.ndarray, parts: Polar, held: HeldContact | None = None) -> float:
        """Return E (J) of vertices x (n, 3), with what contact holds."""
        offset = x - self.guess
        energy = 0.5 * float(self.inertia @ (offset**2).sum(1)) + float((self.linear * x).sum())
        energy += self.weight * self.elements.energy(parts.stretch - self.centre)
        for part in (self.friction, self.drag):
            energy += 0.0 if part is None else part.energy(x)
        if self.contact is not None and held is not None:
            energy += held.energy(self.contact.end(x))
        return energy

    def normal(self, parts: Polar) -> np.ndarray:
        """Return V dpsi/dS (3, 3, t), J."""
        fem = self.elements
        strain = parts.stretch - self.centre
        return isotropic(strain, self.weight * fem.mu, self.weight * fem.lam) * fem.volumes

    def gradient(self, x: np.ndarray, parts: Polar, held: HeldContact | None = None) -> np.ndarray:
        """Return dE/dx (n, 3), N,."""
        gradient = self.inertia[:, None] * (x - self.guess) + self.linear
        gradient += self.elements.forces(stress(parts, self.normal(parts)))
        for part in (self.friction, self.drag):
            if part is not None:
                gradient += part.gradient(x)
        if self.contact is not None and held is not None:
            gradient[held.touching] -= self.contact.scale * held.forces
        return gradient

    def blocks(
        self,
        x: np.ndarray,
        parts: Polar,
        held: HeldContact | None = None,
        definite: bool = False,
    ) -> np.ndarray:
        """Return the second derivative's blocks (b, 3, 3), or those of a definite one near it."""
        fem = self.elements
        size = self.weight * fem.volumes
        inner = second_derivative(
            parts,
            self.normal(parts),
            fem.gradients,
            fem.mu * size,
            fem.lam * size,
            definite,
        )
        if self.friction is not None:
            inner += self.friction.hessian
        surface = None if self.drag is None else self.drag.hessian(x)
        blocks = fem.blocks(inner, surface)
        blocks[fem.diagonal] += self.inertia[:, None, None] * np.eye(3)
        if self.contact is not None and held is not None:
            blocks[fem.diagonal[held.touching]] += self.contact.scale**2 * held.blocks
        return blocks

    def matrix(self, blocks: np.ndarray) -> sp.csr_matrix:
        """Return the symmetric matrix (3n, 3n) of blocks on and below its diagonal."""
        fem, n = self.elements, len(self.inertia)
        above = np.flatnonzero(fem.rows != fem.columns)
        rows = np.concatenate([fem.rows, fem.columns[above]])
        columns = np.concatenate([fem.columns, fem.rows[above]])
        full = np.concatenate([blocks, blocks[above].transpose(0, 2, 1)])
        dof = 3 * np.stack([rows, columns])[:, :, None, None]
        place = dof + np.stack(np.meshgrid(range(3), range(3), indexing="ij"))[:, None]
        return sp.csr_matrix((full.ravel(), place.reshape(2, -1)), (3 * n, 3 * n))

    def factor(
        self, x: np.ndarray, parts: Polar, held: HeldContact | None = None
    ) -> CholeskyFactor:
        """Return the factor of the second derivative at x (n, 3), or of a definite one near it.

        Raises:
            DefplanError: neither has one.
        """
        for definite in (False, True):
            factor = self.elements.order.factor(self.blocks(x, parts, held, definite))
            if factor is not None:
                return factor
        raise DefplanError("the full FEM's state is not finite, or its mesh is degenerate")


def minimise(
    step: Step, x: np.ndarray, tolerance: float, most: int
) -> tuple[np.ndarray, int, float]:
    """Return the solution (n, 3), the iterations it took and the size of the last one, m.

    Args:
        x: (n, 3) start.
        tolerance: of the last Newton step, m.
        most: iterations.

    Raises:
        DefplanError: it did not converge.
    """
    fem = step.elements
    parts = polar(fem.deformation(x))
    factor, last = None, 0.0
    for iteration in range(1, most + 1):
        held = step.hold(x)
        gradient = step.gradient(x, parts, held)
        if factor is None:
            factor = step.factor(x, parts, held)
        move = -factor.solve(gradient)
        size = float(np.abs(move).max())
        if size <= tolerance:
            return x + move, iteration, size
        slope = float((move * gradient).sum())
        energy, fraction = step.energy(x, parts, held), 1.0
        while True:
            new = x + fraction * move
            new_parts = polar(fem.deformation(new))
            limit = energy + 1e-4 * fraction * slope + _NOISE * abs(energy)
            if fraction < 1e-6 or step.energy(new, new_parts, held) <= limit:
                break
            fraction *= 0.5
        x, parts = new, new_parts
        if size > _KEPT * last or fraction < 1.0:
            factor = None
        last = size
    raise DefplanError(
        f"the full FEM step did not converge in {most} iterations (last one {size:.1e} m)"
    )
