"""Tetrahedral meshes: volumes, shape quality, gradients, boundary, mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
_SPLITS_AT_ONCE = 0.02  # share of the edges, before lengths are measured anew
_FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # outward, for positive volume


@dataclass(frozen=True)
class TetMesh:
    """A tetrahedral mesh.

    Attributes:
        vertices: (n, 3), m.
        tetrahedra: (t, 4) vertex indices, positive volume.
    """

    vertices: np.ndarray
    tetrahedra: np.ndarray


def volumes(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the signed volumes (t,), m^3."""
    a, b, c, d = (vertices[tetrahedra[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0


def quality(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return 6 sqrt(2) volume / l_rms^3 (t,): 1 for a regular tetrahedron, 0 for a flat one."""
    corners = vertices[tetrahedra]
    square = sum(((corners[:, i] - corners[:, j]) ** 2).sum(1) for i, j in _EDGES)
    return 6.0 * np.sqrt(2.0) * volumes(vertices, tetrahedra) / (square / 6.0) ** 1.5


def _face_keys(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all faces (4t, 3), face by face, outward, and a number (4t,) for their corner set."""
    faces = np.concatenate([tetrahedra[:, corners] for corners in _FACES])
    low, middle, high = np.sort(faces, axis=1).T
    base = int(tetrahedra.max()) + 1
    if base > 2_000_000:
        raise ValueError(f"{base} vertices: face numbers would overflow")
    return faces, (low * base + middle) * base + high


def boundary(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the boundary triangles (f, 3), outward, and the tetrahedron (f,) each belongs to."""
    faces, keys = _face_keys(tetrahedra)
    _, first, count = np.unique(keys, return_index=True, return_counts=True)
    keep = np.sort(first[count == 1])
    return faces[keep], keep % len(tetrahedra)


def face_pieces(tetrahedra: np.ndarray) -> tuple[np.ndarray, int]:
    """Return labels (t,) of the pieces joined through faces, and the most tetrahedra at a face."""
    _, keys = _face_keys(tetrahedra)
    count = len(tetrahedra)
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    pairs = order[same] % count, order[same + 1] % count
    graph = coo_matrix((np.ones(len(same)), pairs), (count, count))
    most = int(np.unique(keys, return_counts=True)[1].max())
    return connected_components(graph, False)[1], most


def shape_gradients(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the gradients (t, 4, 3) of the four linear shape functions, 1/m."""
    corners = vertices[tetrahedra]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    inverse = np.linalg.inv(edges)
    return np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)


def lumped_mass(vertices: np.ndarray, tetrahedra: np.ndarray, density: float) -> np.ndarray:
    """Return the vertex masses (n,), kg: a quarter of each tetrahedron goes to each corner."""
    share = np.repeat(density * volumes(vertices, tetrahedra) / 4.0, 4)
    return np.bincount(tetrahedra.ravel(), share, minlength=len(vertices))


def compact(vertices: np.ndarray, tetrahedra: np.ndarray) -> TetMesh:
    """Drop the vertices that no tetrahedron uses; the order of the others stays."""
    used, index = np.unique(tetrahedra, return_inverse=True)
    return TetMesh(vertices[used], index.reshape(tetrahedra.shape))


def split_longest_edges(mesh: TetMesh, count: int) -> TetMesh:
    """Add `count` vertices, each in the middle of a long edge; tetrahedra around it are halved."""
    vertices, tetrahedra = mesh.vertices, mesh.tetrahedra
    while count > 0:
        pairs = np.sort(np.concatenate([tetrahedra[:, edge] for edge in _EDGES]), axis=1)
        edges, index = np.unique(pairs, axis=0, return_inverse=True)
        owner = np.tile(np.arange(len(tetrahedra)), len(_EDGES))
        around = owner[np.argsort(index.ravel(), kind="stable")]
        ends = np.cumsum(np.bincount(index.ravel()))
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        free = np.ones(len(tetrahedra), dtype=bool)
        keep, halves = free.copy(), []
        middles: list[np.ndarray] = []
        for edge in np.argsort(-np.round(length / length.max(), 9), kind="stable"):
            own = around[ends[edge - 1] if edge else 0 : ends[edge]]
            if not free[own].all():
                continue
            free[own] = keep[own] = False
            new = len(vertices) + len(middles)
            middles.append(vertices[edges[edge]].mean(0))
            for end in edges[edge]:
                halves.append(np.where(tetrahedra[own] == end, new, tetrahedra[own]))
            if len(middles) == count or len(middles) >= _SPLITS_AT_ONCE * len(edges):
                break
        count -= len(middles)
        vertices = np.vstack([vertices, middles])
        tetrahedra = np.vstack([tetrahedra[keep], *halves])
    return TetMesh(vertices, tetrahedra)
