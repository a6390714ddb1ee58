"""Rotation-strain coordinates: from modal coordinates q to finite deformation, on all tetrahedra.

The linear displacement's gradient is split into its skew part (rotation vector w) and symmetric
part (strain e); each tetrahedron gets F = exp([w]) (I + e), and the displacement is the one whose
gradients come nearest to all F - I (Huang et al. 2011; the paper's [22]).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.elasticity import SYMMETRIC
from defplan_mj.body.model import Body
from defplan_mj.body.tetmesh import TetMesh, shape_gradients, volumes

STRAIN = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Order of the six strain components in a feature map."""
_STRAIN_INDEX = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_CHUNK = 16  # shapes reconstructed at once: what fits in the cache


def feature_map(mesh: TetMesh, modes: np.ndarray) -> np.ndarray:
    """Return (t, 9, r): maps q to rotation vector (3) and strain (6) of each tetrahedron.

    Args:
        modes: (n, 3, r) displacement per unit of q, m.
    """
    g = shape_gradients(mesh.vertices, mesh.tetrahedra)
    gradient = np.einsum("eaj,eair->eijr", g, modes[mesh.tetrahedra])
    skew = 0.5 * (gradient - gradient.transpose(0, 2, 1, 3))
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1, 3))
    rows = [skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]]
    rows += [strain[:, i, j] for i, j in STRAIN]
    return np.stack(rows, axis=1)


def exponential(w: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad, by Rodrigues' formula."""
    # not SciPy's, as `base.rotations`: it goes by quaternions and rounds otherwise, and every body's hash, which
    # gaits and policies name, depends on the last digit
    square = (w * w).sum(-1)
    small = square < 1e-8
    safe = np.where(small, 1.0, square)
    angle = np.sqrt(safe)
    a = np.where(small, 1.0 - square / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(angle)) / safe)
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    result = b[..., None, None] * (w[..., :, None] * w[..., None, :])
    diagonal = 1.0 - b * square
    for i in range(3):
        result[..., i, i] += diagonal
    result[..., 2, 1] += a * x
    result[..., 1, 2] -= a * x
    result[..., 0, 2] += a * y
    result[..., 2, 0] -= a * y
    result[..., 1, 0] += a * z
    result[..., 0, 1] -= a * z
    return result


def strain_matrices(components: np.ndarray) -> np.ndarray:
    """Return the symmetric matrices (..., 3, 3) of strain components (..., 6)."""
    return components[..., _STRAIN_INDEX]


def deformation(features: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return F - I (m, t, 3, 3) for shapes q (m, r) and a feature map (t, 9, r)."""
    values = np.einsum("tfr,mr->mtf", features, q, optimize=True)
    rotation = exponential(values[..., :3])
    return rotation @ (np.eye(3) + strain_matrices(values[..., 3:])) - np.eye(3)


def shape_coordinates(body: Body, q: np.ndarray) -> np.ndarray:
    """Return z(q) (m, k) of shapes q (m, r): the displacement of a shape is basis z (docs/kernel.md)."""
    gradients = deformation(body.feature_map, q).reshape(len(q), -1)
    return gradients @ body.feature_weights.T


def affine_coordinates(body: Body, q: np.ndarray) -> np.ndarray:
    """Return zeta = (1, z(q)) (m, k + 1) of shapes q (m, r), which `Body.moments` and fields take."""
    return np.hstack([np.ones((len(q), 1)), shape_coordinates(body, q)])


class RotationStrain:
    """The exact map q -> u(q) of a body: all tetrahedra, one Poisson solve.

    Args:
        mesh: the body at rest.
        mass: (n,) vertex masses, kg; their centre does not move.
        modes: (n, 3, r) linear modes.
    """

    def __init__(self, mesh: TetMesh, mass: np.ndarray, modes: np.ndarray) -> None:
        self.mesh = mesh
        self.features = feature_map(mesh, modes)
        self.volumes = volumes(mesh.vertices, mesh.tetrahedra)
        self.mass = mass
        self._mean = mass / mass.sum()
        g = shape_gradients(mesh.vertices, mesh.tetrahedra)
        tets, n = len(mesh.tetrahedra), len(mesh.vertices)
        rows = np.repeat(np.arange(3 * tets), 4)
        columns = np.repeat(mesh.tetrahedra, 3, axis=0).ravel()
        gradient = sp.csr_matrix((g.transpose(0, 2, 1).ravel(), (rows, columns)), (3 * tets, n))
        self._weighted = (gradient.T @ sp.diags(np.repeat(self.volumes, 3))).tocsr()
        laplacian = (self._weighted @ gradient).tocsc()
        # pinning one vertex removes the constant; the centre of mass is set afterwards
        self._factor = sla.splu(laplacian[1:, 1:].tocsc(), **SYMMETRIC)

    def displacement(self, q: np.ndarray, progress: Progress = no_progress) -> np.ndarray:
        """Return u (m, n, 3), m, of shapes q (m, r); `progress` is for what takes longer."""
        return np.concatenate(list(self.displacements(np.atleast_2d(q))))

    def displacements(self, q: np.ndarray) -> Iterator[np.ndarray]:
        """Yield u of the shapes q (m, r) in pieces of (at most 16, n, 3), m."""
        for start in range(0, len(q), _CHUNK):
            yield self.nearest(deformation(self.features, q[start : start + _CHUNK]))

    def strain(self, q: np.ndarray) -> np.ndarray:
        """Return the strains e (3, 3, t) of a shape q (r,)."""
        return strain_matrices(self.features[:, 3:] @ q).transpose(1, 2, 0)

    def nearest(self, gradients: np.ndarray) -> np.ndarray:
        """Return u (m, n, 3) whose gradients come nearest to `gradients` (m, t, 3, 3), F - I."""
        shapes, tets = gradients.shape[:2]
        columns = gradients.transpose(1, 3, 0, 2).reshape(3 * tets, 3 * shapes)
        right = self._weighted @ columns
        u = np.zeros_like(right)
        u[1:] = self._factor.solve(right[1:])
        u -= self._mean @ u
        return u.reshape(-1, shapes, 3).transpose(1, 0, 2)
