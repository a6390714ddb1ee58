"""Linear elasticity of a tetrahedral mesh: stiffness matrix and vibration modes."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from defplan_mj.body.model import Material
from defplan_mj.body.tetmesh import TetMesh, shape_gradients, volumes


def lame(material: Material) -> tuple[float, float]:
    """Return the Lame parameters (mu, lambda), Pa."""
    e, nu = material.youngs_modulus, material.poissons_ratio
    return e / (2.0 * (1.0 + nu)), e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def element_stiffness(mesh: TetMesh, material: Material) -> np.ndarray:
    """Return the stiffness of each tetrahedron (t, 4, 3, 4, 3), N/m."""
    mu, lam = lame(material)
    g = shape_gradients(mesh.vertices, mesh.tetrahedra)
    dots = np.einsum("eai,ebi->eab", g, g)
    stiffness = lam * np.einsum("eai,ebj->eaibj", g, g)
    stiffness += mu * np.einsum("eaj,ebi->eaibj", g, g)
    stiffness += mu * np.einsum("eab,ij->eaibj", dots, np.eye(3))
    return stiffness * volumes(mesh.vertices, mesh.tetrahedra)[:, None, None, None, None]


def stiffness_matrix(mesh: TetMesh, material: Material) -> sp.csc_matrix:
    """Return the linear stiffness matrix (3n, 3n), N/m; coordinates of a vertex are adjacent."""
    dof = (3 * mesh.tetrahedra[:, :, None] + np.arange(3)).reshape(-1, 12)
    rows, columns = np.repeat(dof, 12, axis=1).ravel(), np.tile(dof, (1, 12)).ravel()
    size = 3 * len(mesh.vertices)
    data = element_stiffness(mesh, material).ravel()
    return sp.csc_matrix((data, (rows, columns)), (size, size))


def linear_modes(
    mesh: TetMesh, material: Material, mass: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Solve K phi = w^2 M phi for the slowest modes, the six rigid ones left out.

    Args:
        mass: (n,) vertex masses, kg.
        count: modes wanted.

    Returns:
        w^2 (count,), ascending, 1/s^2, and mass-orthonormal modes (n, 3, count), kg^-1/2. The
        component of largest size of each mode is positive.
    """
    root = np.repeat(np.sqrt(mass), 3)
    scaling = sp.diags(1.0 / root)
    matrix = (scaling @ stiffness_matrix(mesh, material) @ scaling).tocsc()
    shift = -1e-6 * matrix.diagonal().mean()
    start = np.random.default_rng(0).standard_normal(matrix.shape[0])
    factor = sla.splu(matrix - shift * sp.eye(matrix.shape[0], format="csc"), **SYMMETRIC)
    inverse = sla.LinearOperator(matrix.shape, factor.solve)
    values, vectors = sla.eigsh(
        matrix, k=count + 6, sigma=shift, which="LM", v0=start, OPinv=inverse
    )
    order = np.argsort(values)[6:]
    modes = vectors[:, order] / root[:, None]
    largest = np.take_along_axis(modes, np.abs(modes).argmax(0)[None], axis=0)
    return values[order], (modes * np.sign(largest)).reshape(-1, 3, count)


def moving_modes(
    mesh: TetMesh, material: Material, mass: np.ndarray, count: int, moved: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the slowest modes that move some of the body, and not only an ear or a horn.

    Args:
        mass: (n,) vertex masses, kg.
        count: modes wanted.
        moved: least `moved_share` of a mode; 0: the slowest modes of all. Where too few of the first 64 have it,
            those of them that move the most fill up.

    Returns:
        w^2 (count,), ascending, 1/s^2, and modes (n, 3, count), as `linear_modes` does; how many modes
        (count,) are as slow as each of them.
    """
    looked = count
    values, modes = linear_modes(mesh, material, mass, looked)
    if not moved:
        return values, modes, np.arange(count) + 1
    most = min(_MOST_LOOKED, 3 * len(mass) - 7)
    while looked < most and np.sum(moved_share(modes, mass) >= moved) < count:
        looked = min(2 * looked, most)
        values, modes = linear_modes(mesh, material, mass, looked)
    share = moved_share(modes, mass)
    enough = np.flatnonzero(share >= moved)[:count]
    rest = np.setdiff1d(np.argsort(-share, kind="stable"), enough, assume_unique=True)
    places = np.sort(np.concatenate([enough, rest[: count - len(enough)]]))
    return values[places], modes[..., places], places + 1


_MOST_LOOKED = 64


def moved_share(modes: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Return how much of the mass takes part in modes (n, 3, r), in (0, 1]: 1 if all of it moves as far.

    With d a vertex's way it is (sum m d^2)^2 / (sum m sum m d^4), the participation ratio.
    """
    way = (modes**2).sum(1)
    return (mass @ way) ** 2 / (mass.sum() * (mass @ way**2))


SYMMETRIC: dict = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
"""Options with which `splu` factors a symmetric positive definite matrix with little fill-in."""
