"""Contact of the full FEM's surface vertices with a terrain: the reduced step's law, fully implicit.

A vertex whose distance s is less than the thickness d, that comes nearer at -s' and slides at v_t, takes

    N = k (d - s)^2 psi(-b s'),   psi(x) = (1 + x + sqrt((1 + x)^2 + eps^2)) / (1 + sqrt(1 + eps^2)),

along the normal (Hunt and Crossley 1975, without pull), and friction -mu N v_t / sqrt(|v_t|^2 + e^2); all of it
at the end of the substep, with the velocity over the substep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.body.model import Body
from defplan_mj.dynamics.terrain import Terrain, contact_law, pack_terrain
from defplan_mj.kernel.library import kernel

ROUNDING = 0.1  # eps: how round psi is where it would pull; as in kernel/contact_law.c


class FemContact:
    """The terrain around a body's surface."""

    def __init__(self, terrain: Terrain, body: Body) -> None:
        """Prepare the terrain; b is its damping, s/m."""
        self.surface, self.vertices = body.surface, len(body.vertices)
        self.packed = pack_terrain(terrain, body)
        law = contact_law(terrain, body)
        self.friction, self.stiffness, self.thickness = law.friction, law.stiffness, law.thickness
        self.slip, self.damping = law.slip_speed, law.damping
        self._planes = _planes(terrain)

    def gaps(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances (m,) of points (m, 3) from the terrain, m, and its normals (m, 3)."""
        if self._planes is not None:
            places, normals = self._planes
            gaps = points @ normals.T - (places * normals).sum(1)
            nearest = gaps.argmin(1)
            return gaps[np.arange(len(points)), nearest], normals[nearest]
        gap, normals = kernel().dp_terrain_gap, np.empty_like(points)
        values = [gap(self.packed, p, n) for p, n in zip(points, normals, strict=True)]
        return np.array(values), normals

    def normal_force(
        self, gaps: np.ndarray, rates: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return N (m,), N, and its derivatives by the distance, N/m, and by its rate, N s/m."""
        depth, x = np.maximum(self.thickness - gaps, 0.0), 1.0 - self.damping * rates
        root, scale = np.hypot(x, ROUNDING), 1.0 + np.hypot(1.0, ROUNDING)
        psi, slope = (x + root) / scale, (1.0 + x / root) / scale
        spring = self.stiffness * depth**2
        return (
            spring * psi,
            -2.0 * self.stiffness * depth * psi,
            -self.damping * spring * slope,
        )

    def hold(self, end: np.ndarray, start: np.ndarray, time: float) -> HeldContact:
        """Evaluate the law.

        Args:
            end, start: (n, 3) vertices at the end and the start of the substep.
            time: between them, s.
        """
        p, v = end[self.surface], (end - start)[self.surface] / time
        gaps, normals = self.gaps(p)
        near = np.flatnonzero(gaps < self.thickness)
        v, normal = v[near], normals[near]
        rate = (v * normal).sum(1)
        force, by_gap, by_rate = self.normal_force(gaps[near], rate)
        slide = v - rate[:, None] * normal
        speed = np.sqrt((slide**2).sum(1) + self.slip**2)
        along = slide / speed[:, None]
        limit = self.friction * force
        across = np.eye(3) - _outer(normal) - _outer(along)
        blocks = (limit / (speed * time))[:, None, None] * across
        blocks -= (by_gap + by_rate / time)[:, None, None] * _outer(normal)
        return HeldContact(
            self,
            self.surface[near],
            start[self.surface[near]],
            time,
            normal,
            force / np.maximum(self.stiffness * (self.thickness - gaps[near]) ** 2, 1e-300),
            limit,
            force[:, None] * normal - limit[:, None] * along,
            blocks,
        )


@dataclass(frozen=True)
class HeldContact:
    """Contact at an iterate, and a potential whose derivative there is its force.

    The damping's factor and the friction's normal force and direction of the ground are held in it.

    Attributes:
        forces: (m, 3) N on the vertices that touch.
        blocks: (m, 3, 3) minus their derivative, but for friction's dependence on the normal force and
            the turning of the normal: positive semidefinite, N/m.
    """

    contact: FemContact
    touching: np.ndarray
    start: np.ndarray
    time: float
    normal: np.ndarray
    factor: np.ndarray
    limit: np.ndarray
    forces: np.ndarray
    blocks: np.ndarray

    def energy(self, end: np.ndarray) -> float:
        """Return the potential (J) at vertices `end` (n, 3)."""
        law = self.contact
        gaps, _ = law.gaps(end[law.surface])
        depth = np.maximum(law.thickness - gaps, 0.0)
        factor = np.ones(law.vertices)
        factor[self.touching] = self.factor
        energy = law.stiffness / 3.0 * float(factor[law.surface] @ depth**3)
        v = (end[self.touching] - self.start) / self.time
        v -= (v * self.normal).sum(1, keepdims=True) * self.normal
        speed = np.sqrt((v**2).sum(1) + law.slip**2)
        return energy + self.time * float(self.limit @ (speed - law.slip))


def _planes(terrain: Terrain) -> tuple[np.ndarray, np.ndarray] | None:
    """Return points (g, 3) and normals (g, 3) of a terrain of planes alone, else None."""
    shapes = {geom.shape for geom in terrain.geoms}
    if terrain.heightfield is not None or shapes != {"plane"}:
        return None
    turned = rotations.matrix(np.array([geom.quaternion for geom in terrain.geoms]))
    return np.array([geom.position for geom in terrain.geoms], float), turned[:, :, 2]


def _outer(v: np.ndarray) -> np.ndarray:
    return v[:, :, None] * v[:, None, :]
