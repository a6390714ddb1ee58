"""Reads surface and tetrahedral meshes, and refuses the bad ones with one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.intersections import crossing_triangles
from defplan_mj.body.tetmesh import TetMesh, compact, face_pieces, volumes


@dataclass(frozen=True)
class Surface:
    """A closed triangle mesh: vertices (n, 3) in m, outward faces (f, 3)."""

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def volume(self) -> float:
        """Enclosed volume, m^3."""
        centre = self.vertices.mean(0)
        a, b, c = (self.vertices[self.faces[:, i]] - centre for i in range(3))
        return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6.0)

    @property
    def area(self) -> float:
        """Total area, m^2."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def check_extent(vertices: np.ndarray, cells: np.ndarray, path: Path | str) -> np.ndarray:
    """Return the extents (3,), m, of what the cells use.

    Raises:
        DefplanError: coordinates are not finite, or the extents span no volume.
    """
    used = np.unique(cells)
    finite = np.isfinite(vertices[used]).all(1)
    if not finite.all():
        raise DefplanError(
            f"{path} has {int((~finite).sum())} vertices whose coordinates are not finite numbers:"
            " export it again"
        )
    extent = np.ptp(vertices[used], axis=0)
    if extent.min() <= 1e-9 * extent.max():
        what = "a point" if extent.max() == 0.0 else f"flat along {'xyz'[extent.argmin()]}"
        raise DefplanError(f"{path} encloses no volume (it is {what}): give it a size")
    return extent


def merge_vertices(
    vertices: np.ndarray, faces: np.ndarray, tolerance: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Join vertices at one place (up to rounding to `tolerance`) and drop collapsed triangles."""
    places = vertices if tolerance == 0.0 else np.round(vertices / tolerance)
    _, first, index = np.unique(places + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))  # keep the file's order
    faces = order[index.ravel()][faces]
    a, b, c = faces.T
    return vertices[np.sort(first)], faces[(a != b) & (b != c) & (c != a)]


def check_surface(vertices: np.ndarray, faces: np.ndarray, path: Path | str) -> Surface:
    """Return the surface if it is closed, whole, outward and free of crossings.

    Files that give every triangle its own vertices (STL) are welded first.

    Raises:
        DefplanError: it is not; the sentence says what mends it.
    """
    scale = np.ptp(vertices[np.unique(faces)], axis=0).max()
    vertices, faces = merge_vertices(vertices, faces)
    if len(faces) and _open_edges(faces)[0]:
        vertices, faces = merge_vertices(vertices, faces, 1e-7 * scale)
    if len(faces) == 0:
        raise DefplanError(f"{path} is empty: all its triangles collapse")
    single, crowded, disagree = _open_edges(faces)
    if single:
        raise DefplanError(
            f"{path} is open: {single} edges have a triangle on one side only; close its holes"
        )
    if crowded:
        raise DefplanError(
            f"{path} is no simple surface: {crowded} edges have more than two triangles;"
            " remove double and inner faces"
        )
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3)
    pieces = _pieces(faces)
    if pieces > 1:
        raise DefplanError(f"{path} is in {pieces} pieces: join them into one closed surface")
    if disagree:
        raise DefplanError(
            f"{path} has triangles that do not agree which side is outside ({disagree} edges):"
            " make its normals consistent"
        )
    surface = Surface(vertices, faces)
    if abs(surface.volume) < 1e-12 * scale**3:
        raise DefplanError(f"{path} encloses no volume: give it a thickness")
    if surface.volume < 0.0:
        raise DefplanError(f"{path} is inside out (its triangles face inwards): flip its normals")
    pairs = crossing_triangles(vertices, faces)
    if len(pairs):
        x, y, z = vertices[faces[pairs[0, 0]]].mean(0)
        raise DefplanError(
            f"{path} intersects itself ({len(pairs)} pairs of triangles cross, the first near"
            f" {x:.3g}, {y:.3g}, {z:.3g}): make it one surface, for instance by a boolean union"
        )
    return surface


def _open_edges(faces: np.ndarray) -> tuple[int, int, int]:
    """Count edges with one triangle, with more than two, and with two that run the same way."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = directed[:, 0] < directed[:, 1]
    low, high = directed.min(1), directed.max(1)
    _, index, count = np.unique(
        low * (faces.max() + 1) + high, return_inverse=True, return_counts=True
    )
    balance = np.bincount(index, np.where(forward, 1.0, -1.0))
    return (
        int((count == 1).sum()),
        int((count > 2).sum()),
        int(((count == 2) & (balance != 0)).sum()),
    )


def _pieces(faces: np.ndarray) -> int:
    """Count the connected pieces of a triangle mesh without unused vertices."""
    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    n = faces.max() + 1
    return connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), (n, n)), False)[0]


def check_tetrahedra(vertices: np.ndarray, tetrahedra: np.ndarray, path: Path | str) -> TetMesh:
    """Return the mesh if it is conforming, in one piece and without inverted tetrahedra.

    A file whose tetrahedra are all negative uses the other order of corners: it is turned.

    Raises:
        DefplanError: it is not; the sentence says what mends it.
    """
    mesh = compact(vertices, tetrahedra)
    size = volumes(mesh.vertices, mesh.tetrahedra)
    flat = np.abs(size) <= 1e-12 * np.abs(size).max()
    if flat.any() or size.max() == 0.0:
        raise DefplanError(f"{path} has {int(flat.sum())} tetrahedra without volume: mesh it again")
    if (size < 0.0).all():
        mesh = TetMesh(mesh.vertices, mesh.tetrahedra[:, [0, 2, 1, 3]])
    elif (size < 0.0).any():
        raise DefplanError(
            f"{path} has {int((size < 0).sum())} inverted tetrahedra of {len(size)}: mesh it again"
        )
    label, most = face_pieces(mesh.tetrahedra)
    if most > 2:
        raise DefplanError(f"{path} has a face with {most} tetrahedra: remove double ones")
    if label.max() > 0:
        raise DefplanError(
            f"{path} is in {label.max() + 1} pieces: join them (merge vertices at one place)"
        )
    return mesh
