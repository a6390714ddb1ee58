"""A tetrahedral mesh in bulk: deformation gradients, forces, and where blocks go in a sparse matrix."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from defplan_mj.body.corotational import PAIRS, Polar, density, isotropic, second_derivative, stress
from defplan_mj.body.sparse_cholesky import SparseCholesky
from defplan_mj.body.tetmesh import TetMesh, boundary, shape_gradients, volumes

_FACE_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))


class Elements:
    """What stays the same whatever the shape: the mesh, its gradients, and where blocks go in the matrix.

    Args:
        mesh: at rest.
        mu, lam: Lame parameters, Pa.
    """

    def __init__(self, mesh: TetMesh, mu: float, lam: float) -> None:
        self.mu, self.lam = mu, lam
        # corners in ascending order, so that block (a, b), a > b, is below the diagonal
        self.cells = np.sort(mesh.tetrahedra, axis=1)
        self.volumes = volumes(mesh.vertices, mesh.tetrahedra)
        self.gradients = np.ascontiguousarray(
            shape_gradients(mesh.vertices, self.cells).transpose(1, 2, 0)
        )
        self.faces, _ = boundary(mesh.tetrahedra)
        n = len(mesh.vertices)
        faces = np.sort(self.faces, axis=1)
        pairs = [(self.cells[:, a], self.cells[:, b]) for a, b in PAIRS]
        pairs += [(faces[:, a], faces[:, b]) for a, b in _FACE_PAIRS]
        keys = np.concatenate([row * n + column for row, column in pairs])
        keys, place = np.unique(keys, return_inverse=True)
        self.rows, self.columns = np.divmod(keys, n)
        self.diagonal = np.flatnonzero(self.rows == self.columns)
        inner = len(PAIRS) * len(self.cells)
        self._sum_cells = _summing(place[:inner], len(keys))
        self._sum_faces = _summing(place[inner:], len(keys))
        self._scatter_cells = _summing(self.cells.T.ravel(), n)
        self._scatter_faces = _summing(self.faces.T.ravel(), n)
        self.order = SparseCholesky(n, self.rows, self.columns)

    def deformation(self, x: np.ndarray) -> np.ndarray:
        """Return the deformation gradients F (3, 3, t) at vertices x (n, 3)."""
        corners = np.ascontiguousarray(x.T)[:, self.cells.T]
        return np.einsum("iat,ajt->ijt", corners, self.gradients)

    def forces(self, first: np.ndarray) -> np.ndarray:
        """Return the gradient (n, 3) by the vertices from V dpsi/dF (3, 3, t)."""
        corners = np.einsum("ijt,ajt->iat", first, self.gradients)
        return np.stack([self._scatter_cells @ part.ravel() for part in corners], axis=1)

    def energy(self, strain: np.ndarray) -> float:
        """Return the elastic energy of strains (3, 3, t), J."""
        return float(self.volumes @ density(strain, self.mu, self.lam))

    def elastic_forces(self, parts: Polar, strain: np.ndarray) -> np.ndarray:
        """Return the gradient (n, 3), N, of the energy of strains S - T (3, 3, t) where F = R S is `parts`."""
        return self.forces(stress(parts, isotropic(strain, self.mu, self.lam) * self.volumes))

    def stiffness(self, parts: Polar, factor: float = 1.0) -> np.ndarray:
        """Return the definite part (3, 3, 10, t), N/m, of `factor` times the energy's second derivative.

        It takes no notice of the stress.
        """
        size = factor * self.volumes
        return second_derivative(
            parts,
            np.zeros_like(parts.stretch),
            self.gradients,
            self.mu * size,
            self.lam * size,
            definite=True,
        )

    def face_forces(self, force: np.ndarray) -> np.ndarray:
        """Return (n, 3): each triangle's vector (3, f) given to each of its corners."""
        return np.stack([self._scatter_faces @ np.tile(part, 3) for part in force], axis=1)

    def blocks(self, inner: np.ndarray, surface: np.ndarray | None) -> np.ndarray:
        """Assemble the blocks (b, 3, 3) of the matrix, below and on its diagonal.

        Args:
            inner: (3, 3, 10, t) of the tetrahedra.
            surface: (3, 3, f) of each pair of corners of each triangle.
        """
        out = np.empty((len(self.rows), 3, 3))
        for i in range(3):
            for j in range(3):
                out[:, i, j] = self._sum_cells @ inner[i, j].ravel()
                if surface is not None:
                    out[:, i, j] += self._sum_faces @ np.tile(surface[i, j], len(_FACE_PAIRS))
        return out

    def triangles(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the centres (3, f) and area vectors (3, f) of the surface triangles."""
        a, b, c = (x[self.faces[:, i]] for i in range(3))
        return ((a + b + c) / 3.0).T, 0.5 * np.cross(b - a, c - a).T


def _summing(place: np.ndarray, size: int) -> sp.csr_matrix:
    """Return the matrix (size, m) that adds entry i to `place[i]`."""
    count = len(place)
    return sp.csr_matrix((np.ones(count), (place, np.arange(count))), (size, count))
