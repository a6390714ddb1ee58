"""How far a mesh's frequencies are from those of the body, and what its stiffness has to be multiplied by.

Linear tetrahedra are too stiff in bending. The same mesh with quadratic ones (10 nodes, consistent mass) has
the vertices of the mesh with each tetrahedron cut into eight, but errors of fourth order in a frequency, and
is taken as converged: on a bar of one cell across it is within 1% of Euler and Bernoulli's beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.elasticity import lame, linear_modes
from defplan_mj.body.model import Material
from defplan_mj.body.sparse_cholesky import SparseCholesky
from defplan_mj.body.tetmesh import TetMesh, lumped_mass, shape_gradients, volumes

_EDGES = np.array(((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)))
# Eight of a tetrahedron with corners 0 to 3 and edge middles 4 to 9: four at corners, the octahedron in four.
_EIGHT = (
    ((0, 4, 5, 6), (4, 1, 7, 8), (5, 7, 2, 9), (6, 8, 9, 3))
    + ((4, 5, 6, 8), (4, 7, 5, 8), (5, 6, 8, 9), (5, 8, 7, 9))
)  # fmt: skip


@dataclass(frozen=True)
class Frequencies:
    """Frequencies of a mesh.

    Attributes:
        name: 'linear', 'linear, refined once', ... or 'quadratic'.
        nodes: how many it takes.
        hertz: (count,) ascending.
    """

    name: str
    nodes: int
    hertz: np.ndarray


@dataclass(frozen=True)
class StiffnessCorrection:
    """What makes a mesh's stiffness that of the body.

    Attributes:
        young: factor of Young's modulus, the geometric mean of what the first three modes want.
        modal: (r,) factor of each mode's stiffness.
        hertz: (r,) of the mesh as it is.
        converged: (r,) of the body, mode by mode.
        remaining: (r,) relative error of each frequency once `young` is in.
    """

    young: float
    modal: np.ndarray
    hertz: np.ndarray
    converged: np.ndarray
    remaining: np.ndarray


def refine(mesh: TetMesh) -> TetMesh:
    """Cut each tetrahedron into eight; the vertices of `mesh` come first."""
    cells, nodes = _with_middles(mesh)
    tetrahedra = np.concatenate([cells[:, corners] for corners in _EIGHT])
    turned = volumes(nodes, tetrahedra) < 0.0
    tetrahedra[turned] = tetrahedra[turned][:, [0, 1, 3, 2]]
    return TetMesh(nodes, tetrahedra)


def _with_middles(mesh: TetMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the ten nodes of each tetrahedron (t, 10), corners and edges' middles, and all nodes (m, 3)."""
    pairs = np.sort(mesh.tetrahedra[:, _EDGES], axis=2)
    edges, index = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    middles = index.reshape(-1, 6) + len(mesh.vertices)
    nodes = np.concatenate([mesh.vertices, mesh.vertices[edges].mean(1)])
    return np.concatenate([mesh.tetrahedra, middles], axis=1), nodes


def frequencies(
    mesh: TetMesh, material: Material, refinements: int = 1, count: int = 3
) -> list[Frequencies]:
    """Return the lowest `count` frequencies of the mesh, of its refinements and of quadratic tetrahedra.

    Args:
        refinements: how often each tetrahedron is cut into eight.

    Raises:
        DefplanError: a number is not positive.
    """
    if count < 1 or refinements < 0:
        raise DefplanError(
            f"{count} frequencies on {refinements} refinements: at least 1 and 0 are wanted"
        )
    table, refined = [], mesh
    for times in range(refinements + 1):
        mass = lumped_mass(refined.vertices, refined.tetrahedra, material.density)
        squares, _ = linear_modes(refined, material, mass, count)
        name = "linear" if times == 0 else f"linear, refined {times} times"
        table.append(Frequencies(name, len(mass), np.sqrt(squares) / (2.0 * np.pi)))
        if times < refinements:
            refined = refine(refined)
    squares, modes = quadratic_modes(mesh, material, count)
    table.append(Frequencies("quadratic", len(modes), np.sqrt(squares) / (2.0 * np.pi)))
    return table


def quadratic_modes(mesh: TetMesh, material: Material, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Solve K phi = w^2 M phi with quadratic tetrahedra, the six rigid modes left out.

    Returns:
        w^2 (count,), ascending, 1/s^2, and mass-orthonormal modes (m, 3, count), kg^-1/2: the mesh's
        vertices first, then the edges' middles.
    """
    cells, nodes = _with_middles(mesh)
    n = len(nodes)
    stiffness = _quadratic_stiffness(mesh, material)
    share = material.density / 420.0 * volumes(mesh.vertices, mesh.tetrahedra)
    row, column = np.repeat(cells, 10, axis=1).ravel(), np.tile(cells, 10).ravel()
    mass = sp.csr_matrix(((share[:, None, None] * _mass_pattern()).ravel(), (row, column)), (n, n))
    mass = sp.kron(mass, sp.eye(3), format="csr")
    dof = 3 * np.stack([row, column])[:, :, None, None]
    place = dof + np.stack(np.meshgrid(range(3), range(3), indexing="ij"))[:, None]
    full = sp.csr_matrix((stiffness.ravel(), place.reshape(2, -1)), (3 * n, 3 * n))
    shift = -1e-6 * full.diagonal().mean() / mass.diagonal().mean()
    blocks = (full - shift * mass).tobsr((3, 3))
    rows = np.repeat(np.arange(n), np.diff(blocks.indptr))
    low = rows >= blocks.indices
    factor = SparseCholesky(n, rows[low], blocks.indices[low]).factor(blocks.data[low])
    if factor is None:
        raise DefplanError("the mesh's stiffness is not definite: a tetrahedron is degenerate")
    inverse = sla.LinearOperator(full.shape, factor.solve)
    start = np.random.default_rng(0).standard_normal(3 * n)
    # some more than wanted: Lanczos can miss one of a pair among the last
    values, vectors = sla.eigsh(
        full, k=count + 10, M=mass, sigma=shift, which="LM", v0=start, OPinv=inverse
    )
    order = np.argsort(values)[6 : 6 + count]
    return values[order], vectors[:, order].reshape(-1, 3, count)


def _quadratic_stiffness(mesh: TetMesh, material: Material) -> np.ndarray:
    """Return the stiffness (t, 10, 10, 3, 3) of each tetrahedron, N/m; four points integrate it exactly."""
    mu, lam = lame(material)
    linear = shape_gradients(mesh.vertices, mesh.tetrahedra)
    first, second = _EDGES.T
    total = np.zeros((len(linear), 10, 10, 3, 3))
    for corner in range(4):
        at = np.full(4, (5.0 - np.sqrt(5.0)) / 20.0)
        at[corner] = (5.0 + 3.0 * np.sqrt(5.0)) / 20.0
        corners = (4.0 * at - 1.0)[:, None] * linear
        middles = at[first][:, None] * linear[:, second] + at[second][:, None] * linear[:, first]
        g = np.concatenate([corners, 4.0 * middles], axis=1)
        dots = np.einsum("eai,ebi->eab", g, g)
        total += lam * g[:, :, None, :, None] * g[:, None, :, None, :]
        total += mu * g[:, :, None, None, :] * g[:, None, :, :, None]
        total += mu * dots[..., None, None] * np.eye(3)
    return 0.25 * volumes(mesh.vertices, mesh.tetrahedra)[:, None, None, None, None] * total


def _mass_pattern() -> np.ndarray:
    """Return the consistent mass (10, 10) of a quadratic tetrahedron over density times volume / 420."""
    pattern = np.empty((10, 10))
    pattern[:4, :4] = 1.0 + 5.0 * np.eye(4)
    touches = (_EDGES[:, :, None] == np.arange(4)).any(1)
    pattern[4:, :4] = np.where(touches, -4.0, -6.0)
    pattern[:4, 4:] = pattern[4:, :4].T
    shared = touches.astype(int) @ touches.T.astype(int)
    pattern[4:, 4:] = np.array([8.0, 16.0, 32.0])[shared]
    return pattern


def stiffness_correction(
    mesh: TetMesh,
    material: Material,
    mass: np.ndarray,
    modes: np.ndarray,
    own: np.ndarray,
    looked: int,
) -> StiffnessCorrection:
    """Return what makes the stiffness of a body's modes, and of its mesh, that of the body.

    A mode's converged stiffness is that of the body in the mode's place among the quadratic ones: modes
    that lie close together may swap, so each takes the one whose motion of the vertices is most like its own.

    Args:
        mass: (n,) vertex masses, kg.
        modes: (n, 3, r) of the mesh with linear tetrahedra, any scale.
        own: (r,) their w^2, 1/s^2.
        looked: how many modes of the mesh are as slow as the last of them.
    """
    r = modes.shape[2]
    flat = modes.reshape(-1, r) * np.repeat(np.sqrt(mass), 3)[:, None]
    flat = flat / np.linalg.norm(flat, axis=0)
    squares, shapes = quadratic_modes(mesh, material, looked + 3)
    there = shapes[: len(mass)].reshape(-1, len(squares)) * np.repeat(np.sqrt(mass), 3)[:, None]
    there = there / np.linalg.norm(there, axis=0)
    likeness = (flat.T @ there) ** 2
    match = np.empty(r, int)
    for mode in np.argsort(-likeness.max(1), kind="stable"):
        match[mode] = likeness[mode].argmax()
        likeness[:, match[mode]] = -1.0
    modal = squares[match] / own
    young = float(np.exp(np.log(modal[:3]).mean()))
    return StiffnessCorrection(
        young=young,
        modal=modal,
        hertz=np.sqrt(own) / (2.0 * np.pi),
        converged=np.sqrt(squares[match]) / (2.0 * np.pi),
        remaining=np.sqrt(young / modal) - 1.0,
    )
