"""Fits the boundary of a tetrahedral mesh to the surface it was made from.

Isosurface stuffing cuts corners: convex parts lose volume and thin rims get teeth. Here points
spread over the surface pull the boundary triangles nearest to them, while a graph Laplacian over
all edges spreads the motion into the body; vertices of tetrahedra that would get too flat stay.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from scipy.spatial import cKDTree

from defplan_mj.body.elasticity import SYMMETRIC
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, boundary, quality

_SAMPLES_PER_FACE = 6
_NEIGHBOURS = 8  # boundary triangles looked at for each sample
_SMOOTHNESS = 0.5  # of the boundary (umbrella operator)
_BACK = 0.2  # pull of boundary vertices back to the surface
_R2 = np.array([0.7548776662466927, 0.5698402909980532])  # 1/g, 1/g^2 with g^3 = g + 1
_STIFFNESS = (
    1.0,
    0.5,
    0.3,
    0.2,
    0.2,
    0.2,
    0.1,
    0.1,
    0.1,
    0.1,
)  # of the graph Laplacian, one a round


def spread_points(surface: Surface, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `count` points (s, 3) on the surface, each for the same share of it, and normals.

    Points follow each other at equal areas through the triangles; within them a low-discrepancy
    sequence (Roberts' R2) places them.
    """
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    double = np.linalg.norm(normal, axis=1)
    reach = np.cumsum(double)
    index = np.arange(count)
    face = np.searchsorted(reach, (index + 0.5) / count * reach[-1], side="right")
    u, v = (index[:, None] * _R2 + 0.5).T % 1.0
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u)[:, None], np.where(fold, 1.0 - v, v)[:, None]
    points = a[face] + u * (b - a)[face] + v * (c - a)[face]
    return points, normal[face] / double[face, None]


def closest_on_triangles(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return barycentric weights (..., 3) of the point of triangle abc closest to p; all (..., 3).

    Ericson, Real-Time Collision Detection, section 5.1.5.
    """
    ab, ac = b - a, c - a

    def dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (x * y).sum(-1)

    d1, d2 = dot(ab, p - a), dot(ac, p - a)
    d3, d4 = dot(ab, p - b), dot(ac, p - b)
    d5, d6 = dot(ab, p - c), dot(ac, p - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    with np.errstate(divide="ignore", invalid="ignore"):
        on_ab, on_ac = d1 / (d1 - d3), d2 / (d2 - d6)
        on_bc = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        total = va + vb + vc
        v, w = vb / total, vc / total
    cases = [
        (d1 <= 0) & (d2 <= 0),
        (d3 >= 0) & (d4 <= d3),
        (d6 >= 0) & (d5 <= d6),
        (vc <= 0) & (d1 >= 0) & (d3 <= 0),
        (vb <= 0) & (d2 >= 0) & (d6 <= 0),
        (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0),
    ]
    zero, one = np.zeros_like(d1), np.ones_like(d1)
    second = np.select(cases, [zero, one, zero, on_ab, zero, 1.0 - on_bc], v)
    third = np.select(cases, [zero, zero, one, zero, on_ac, on_bc], w)
    return np.stack([1.0 - second - third, second, third], axis=-1)


def fit_boundary(mesh: TetMesh, surface: Surface, least_quality: float = 0.2) -> TetMesh:
    """Return the mesh with moved vertices.

    Args:
        least_quality: no tetrahedron falls below it, nor below what it was if that was less.
    """
    faces, _ = boundary(mesh.tetrahedra)
    rim = np.unique(faces)
    n = len(mesh.vertices)
    laplacian = _graph_laplacian(mesh.tetrahedra, n) / 6.0
    umbrella = _graph_laplacian(faces, n)
    umbrella = sp.diags(1.0 / np.maximum(umbrella.diagonal(), 1.0)) @ umbrella
    bending = _SMOOTHNESS * (umbrella.T @ umbrella)

    count = _SAMPLES_PER_FACE * len(faces)
    spacing = (surface.area / count) ** 0.5
    points, normals = spread_points(surface, count)
    weight = len(rim) / count  # a boundary vertex owns 1 on average
    tree = cKDTree(points)
    back = sp.csr_matrix((np.ones(len(rim)), (rim, rim)), (n, n)) * _BACK
    floor = np.minimum(quality(mesh.vertices, mesh.tetrahedra), least_quality)
    x = mesh.vertices
    for stiffness in _STIFFNESS:
        matrix = _nearest_on_boundary(x, faces, points, normals, spacing)
        pull = (weight * matrix.T).tocsr()
        home = np.zeros_like(x)
        home[rim] = _nearest_on_surface(x[rim], tree, points, normals) - x[rim]
        system = (pull @ matrix + back + bending + stiffness * laplacian).tocsc()
        force = pull @ (points - matrix @ x) + back @ home - bending @ x
        x = _guarded(x, sla.splu(system, **SYMMETRIC).solve(force), mesh.tetrahedra, floor)
    return TetMesh(x, mesh.tetrahedra)


def _graph_laplacian(cells: np.ndarray, n: int) -> sp.csr_matrix:
    """Return degree minus adjacency (n, n) of the edges of cells (c, 3 or 4)."""
    corners = range(cells.shape[1])
    pairs = np.concatenate([cells[:, [i, j]] for i in corners for j in corners if i != j])
    graph = sp.csr_matrix((np.ones(len(pairs)), pairs.T), (n, n))
    graph.data[:] = 1.0
    return (sp.diags(np.asarray(graph.sum(1)).ravel()) - graph).tocsr()


def _nearest_on_surface(
    x: np.ndarray, tree: cKDTree, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Return the places (m, 3) on the tangent planes at the surface points nearest to x (m, 3)."""
    _, near = tree.query(x)
    normal = normals[near]
    height = ((x - points[near]) * normal).sum(1, keepdims=True)
    return x - height * normal


def _nearest_on_boundary(
    x: np.ndarray, faces: np.ndarray, points: np.ndarray, normals: np.ndarray, spacing: float
) -> sp.csr_matrix:
    """Return the (s, n) matrix that takes x (n, 3) to the boundary places nearest to points (s, 3).

    Triangles that face away from a point's normal count as farther, so that the two sides of a
    thin fin are not taken for each other.
    """
    corners = x[faces]
    vector = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    _, near = cKDTree(corners.mean(1)).query(points, k=min(_NEIGHBOURS, len(faces)))
    a, b, c = (corners[near, i] for i in range(3))
    barycentric = closest_on_triangles(points[:, None], a, b, c)
    places = np.einsum("sni,snij->snj", barycentric, corners[near])
    distance = np.linalg.norm(places - points[:, None], axis=-1)
    facing = np.einsum("snj,sj->sn", unit[near], normals)
    best = (distance + 6.0 * spacing * np.maximum(0.0, 0.2 - facing)).argmin(1)
    rows = np.arange(len(points))
    share, columns = barycentric[rows, best], faces[near[rows, best]]
    entries = (share.ravel(), (np.repeat(rows, 3), columns.ravel()))
    return sp.csr_matrix(entries, (len(points), len(x)))


def _guarded(
    x: np.ndarray, move: np.ndarray, tetrahedra: np.ndarray, floor: np.ndarray
) -> np.ndarray:
    """Return x + move, less moved (halved, at last not at all) where a quality falls below `floor`."""
    factor = np.ones(len(x))
    for attempt in range(40):
        moved = x + factor[:, None] * move
        bad = quality(moved, tetrahedra) < floor
        if not bad.any():
            return moved
        factor[np.unique(tetrahedra[bad])] *= 0.5 if attempt % 8 < 6 else 0.0
    return x
