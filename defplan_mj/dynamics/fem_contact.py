"""Contact of the full FEM's surface vertices with a terrain: the reduced step's law, for tests."""

from __future__ import annotations

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.terrain import Terrain, pack_terrain
from defplan_mj.kernel.library import kernel


class FemContact:
    """Penalty and friction at the surface vertices (docs/kernel.md); friction with given normal forces."""

    def __init__(self, terrain: Terrain, body: Body, timestep: float) -> None:
        self.surface, self.timestep, self.packed = (
            body.surface,
            timestep,
            pack_terrain(terrain, body),
        )
        self.friction, self.stiffness, self.thickness, self.slip = self.packed[1:5]

    def _depths(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return depths below the rounding (m,), 0 if none, and normals (m, 3)."""
        gap, normals = kernel().dp_terrain_gap, np.empty_like(points)
        gaps = [gap(self.packed, p, n) for p, n in zip(points, normals, strict=True)]
        return np.maximum(self.thickness - np.array(gaps), 0.0), normals

    def evaluate(
        self, x: np.ndarray, x1: np.ndarray, reference: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Return energy (J), forces (m, 3) and Hessian blocks (m, 3, 3) of the surface vertices.

        Args:
            x, x1: vertices (n, 3) now and at the last step, m.
            reference: (n, 3) where friction takes its normal forces from.
        """
        p, h = x[self.surface], self.timestep
        depth, normal = self._depths(p)
        energy = self.stiffness * float((depth**3).sum()) / 3.0
        force = (self.stiffness * depth**2)[:, None] * normal
        hessian = (2.0 * self.stiffness * depth)[:, None, None] * _outer(normal)
        lagged, normal = self._depths(reference[self.surface])
        limit = self.friction * self.stiffness * lagged**2
        v = (p - x1[self.surface]) / h
        v -= (v * normal).sum(1, keepdims=True) * normal
        speed = np.sqrt((v**2).sum(1) + self.slip**2)
        s = v / speed[:, None]
        energy += h * float((limit * (speed - self.slip)).sum())
        force -= limit[:, None] * s
        across = np.eye(3) - _outer(normal) - _outer(s)
        hessian += (limit / (speed * h))[:, None, None] * across
        return energy, force, hessian


def _outer(v: np.ndarray) -> np.ndarray:
    return v[:, :, None] * v[:, None, :]
