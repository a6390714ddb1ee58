"""Shapes as the material takes them: from modal coordinates q to the nearest finite deformation in energy.

Rotation-strain coordinates take the displacement whose gradients come nearest to exp([w]) (I + e), as
`RotationStrain` does. But the rotations w of neighbours need not fit together, and then its own stretch S is not
I + e. A body with the control stiffness k_c and the target u rests where

    sum_e V_e [psi(S_e - I) + k_c psi(S_e - I - e(u))]

is least, which is, up to a constant, (1 + k_c) sum_e V_e psi(S_e - I - e(q)), q = k_c/(1 + k_c) u. So the shape

    x(q) = argmin_x sum_e V_e psi(S_e(x) - I - e(q)),     psi(E) = mu |E|^2 + lambda/2 tr(E)^2,

is where the full FEM rests, and 1/2 q^T K q its energy up to the square of the little that is left. It is found by
Gauss and Newton's method from the shape of `RotationStrain`, and turned to lie on it as well as it can.
"""

from __future__ import annotations

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.corotational import Polar, polar
from defplan_mj.body.elasticity import lame
from defplan_mj.body.elements import Elements
from defplan_mj.body.model import Material
from defplan_mj.body.rotation_strain import RotationStrain

_TOLERANCE = 1e-3  # of the last step, of the length: the next would be a hundredth of it
_MOST = 12  # iterations; four are enough for all but a few shapes
_HELD = 1e-5  # stiffness that holds the body where it began, of mu times the length
_LEAST_FRACTION = 1e-3  # of a step
_SAID = 20  # shapes between two words of progress
_ONE = np.eye(3)[:, :, None]


class ElasticShapes:
    """The map q -> u(q) to the least elastic energy; takes the place of the `RotationStrain` it begins with."""

    def __init__(self, nearest: RotationStrain, material: Material) -> None:
        self.nearest, self.features, self.volumes = nearest, nearest.features, nearest.volumes
        self.mesh, self.mass = nearest.mesh, nearest.mass
        self._elements = Elements(self.mesh, *lame(material))
        self._length = float(np.ptp(self.mesh.vertices, axis=0).max())
        share = self.mass / self.mass.sum()
        self._held = (_HELD * self._elements.mu * self._length * share)[:, None]

    def displacement(self, q: np.ndarray, progress: Progress = no_progress) -> np.ndarray:
        """Return u (m, n, 3), m, of shapes q (m, r)."""
        q = np.atleast_2d(q)
        u = np.empty((len(q), *self.mesh.vertices.shape))
        for i, shape in enumerate(q):
            if i % _SAID == 0:
                progress(f"shape {i} of {len(q)} of least elastic energy", i / len(q))
            u[i] = self._displacement(shape)
        return u

    def strain(self, q: np.ndarray) -> np.ndarray:
        """Return the strains e (3, 3, t) of a shape q (r,), which its stretch comes near to."""
        return self.nearest.strain(q)

    def misfit(self, q: np.ndarray, u: np.ndarray) -> float:
        """Return the energy of what the stretch of displacement u (n, 3) lacks, of that of shape q (r,)."""
        goal = self._wanted(q)
        stretch = self._parts(self.mesh.vertices + u).stretch
        fem = self._elements
        return fem.energy(stretch - goal) / fem.energy(goal - _ONE)

    def _wanted(self, q: np.ndarray) -> np.ndarray:
        return _ONE + self.strain(q)

    def _parts(self, x: np.ndarray) -> Polar:
        return polar(self._elements.deformation(x))

    def _displacement(self, q: np.ndarray) -> np.ndarray:
        start = self.mesh.vertices + self.nearest.displacement(q)[0]
        goal, x = self._wanted(q), start
        parts = self._parts(x)
        energy = self._elements.energy(parts.stretch - goal)
        for _ in range(_MOST):
            move = self._move(x - start, parts, goal)
            fraction = 1.0
            while True:
                new = x + fraction * move
                new_parts = self._parts(new)
                held = 0.5 * float((self._held * (new - start) ** 2).sum())
                new_energy = self._elements.energy(new_parts.stretch - goal) + held
                if new_energy <= energy or fraction < _LEAST_FRACTION:
                    break
                fraction *= 0.5
            if not new_energy <= energy:
                break  # as low as can be told
            x, parts, energy = new, new_parts, new_energy
            if np.abs(move).max() < _TOLERANCE * self._length:
                break
        return self._laid_on(x, start) - self.mesh.vertices

    def _move(self, offset: np.ndarray, parts: Polar, goal: np.ndarray) -> np.ndarray:
        """Return the Gauss-Newton step (n, 3), m."""
        fem, strain = self._elements, parts.stretch - goal
        gradient = fem.elastic_forces(parts, strain) + self._held * offset
        blocks = fem.blocks(fem.stiffness(parts), None)
        blocks[fem.diagonal] += self._held[:, :, None] * np.eye(3)
        factor = fem.order.factor(blocks)
        if factor is None:  # flat or not finite: the shape stays where it is
            return np.zeros_like(gradient)
        return -factor.solve(gradient)

    def _laid_on(self, x: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return x (n, 3), its centre of mass at the origin, turned to be nearest to `start`."""
        x = x - self.mass @ x / self.mass.sum()
        return x @ rotations.kabsch((start * self.mass[:, None]).T @ x).T
