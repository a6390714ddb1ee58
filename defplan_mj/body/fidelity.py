"""How far a tetrahedral mesh is from the surface it was made of: distance, extents, volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from defplan_mj.body.fitting import closest_on_triangles, spread_points
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, boundary, volumes

MOST_DISTANCE, MOST_VOLUME = 0.01, 0.03  # of the length; relative
_SAMPLES, _ASKED = 60_000, 20_000  # points that stand for a surface, and points asked for
_CANDIDATES = 6  # triangles looked at for a point
_NEAR = 1e-3  # of the length: so near it does not matter on which side
_SLIVERS = 2e-3  # share of the surface
_LINES = 300  # along each side of the box, to integrate a volume


@dataclass(frozen=True)
class Fidelity:
    """How like the mesh is to its surface.

    Attributes:
        surface_distance: the largest distance from one surface to the other, either way, as a share
            of the length; what lies inside the joined shape does not count if pieces overlap, and
            0.2% of the surface (slivers at a rim) may be three times as far.
        extents_error: the largest relative error of the three extents.
        volume_error: relative error of the volume.
        repaired: what was done to the file's surface, a sentence each.
    """

    surface_distance: float
    extents_error: float
    volume_error: float
    repaired: tuple[str, ...] = ()

    def within(self, distance: float = MOST_DISTANCE) -> bool:
        """Whether the mesh may pass for the surface."""
        return (
            self.surface_distance <= distance
            and self.extents_error <= MOST_VOLUME
            and abs(self.volume_error) <= MOST_VOLUME
        )

    @property
    def badness(self) -> float:
        """At most 1 if good; the smaller the better."""
        return max(
            self.surface_distance / MOST_DISTANCE,
            self.extents_error / MOST_VOLUME,
            abs(self.volume_error) / MOST_VOLUME,
        )

    def __str__(self) -> str:
        return (
            f"surface within {self.surface_distance:.2%} of the length, extents within"
            f" {self.extents_error:.2%}, volume {self.volume_error:+.2%}"
        )


def measure(
    mesh: TetMesh, surface: Surface, overlaps: bool = False, own: Surface | None = None
) -> Fidelity:
    """Compare a mesh with the surface it was made of.

    Args:
        surface: closed; its triangles may cross if `overlaps`.
        overlaps: the surface is the outside of pieces that overlap: what of it lies inside the mesh
            has no distance, and its volume is that of the joined shape.
        own: the part of the surface that the file has, without caps of holes.
    """
    built = Surface(mesh.vertices, boundary(mesh.tetrahedra)[0])
    extents = np.ptp(surface.vertices[np.unique(surface.faces)], axis=0)
    length = extents.max()
    points = asked_points(own or surface)
    there, inside = distances_of(points, built)
    if overlaps:
        there = np.where(inside, 0.0, there)
        # beside an edge the nearest triangle does not tell the side: the winding number does
        for k in np.argsort(-there):
            if there[k] < _NEAR * length or winding(points[k], built.vertices, built.faces) < 0.5:
                break
            there[k] = 0.0
    back, _ = distances(built, surface)
    volume = covered_volume(surface) if overlaps else surface.volume
    return Fidelity(
        surface_distance=float(max(_worst(there), _worst(back)) / length),
        extents_error=float(np.abs(np.ptp(mesh.vertices, axis=0) / extents - 1.0).max()),
        volume_error=float(volumes(mesh.vertices, mesh.tetrahedra).sum() / volume - 1.0),
    )


def _worst(distance: np.ndarray) -> float:
    """Return the distance that all points keep, but for slivers, which keep three times as much."""
    return max(float(np.quantile(distance, 1.0 - _SLIVERS)), float(distance.max()) / 3.0)


def distances(asked: Surface, other: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (p,) of points on a surface from another one, and whether they lie inside."""
    return distances_of(asked_points(asked), other)


def asked_points(surface: Surface, count: int = _ASKED) -> np.ndarray:
    """Return vertices of the surface and points spread evenly over it (p, 3)."""
    corners = surface.vertices[np.unique(surface.faces)]
    spread, _ = spread_points(surface, count)
    return np.vstack([spread, corners[:: max(1, len(corners) // count)]])


def distances_of(points: np.ndarray, other: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (p,) of points from a surface, and whether they are behind its nearest triangle."""
    samples, normals, faces = _samples(other)
    near = cKDTree(samples).query(points, k=_CANDIDATES)[1]
    a, b, c = (other.vertices[other.faces[faces[near], i]] for i in range(3))
    weights = closest_on_triangles(points[:, None], a, b, c)
    feet = weights[..., :1] * a + weights[..., 1:2] * b + weights[..., 2:] * c
    gap = points[:, None] - feet
    distance = np.linalg.norm(gap, axis=-1)
    least = distance.min(1)
    # of triangles equally near, the one that is seen least edge-on says which side it is
    height = (gap * normals[near]).sum(-1)
    height = np.where(distance <= least[:, None] * (1.0 + 1e-6), height, 0.0)
    side = np.take_along_axis(height, np.abs(height).argmax(1)[:, None], axis=1)[:, 0]
    return least, side < 0.0


def _samples(surface: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (s, 3) on the surface, normals and triangles (s,): evenly, and all centres."""
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    double = np.linalg.norm(normal, axis=1)
    reach = np.cumsum(double)
    points, _ = spread_points(surface, _SAMPLES)
    place = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * reach[-1]
    every = np.arange(len(double))
    faces = np.concatenate([np.searchsorted(reach, place, side="right"), every])
    points = np.vstack([points, (a + b + c) / 3.0])
    return points, (normal / np.maximum(double, 1e-300)[:, None])[faces], faces


def winding(point: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the winding number of a closed surface about a point (van Oosterom and Strackee)."""
    a, b, c = (vertices[faces[:, i]] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    top = np.einsum("fi,fi->f", a, np.cross(b, c))
    dot = [np.einsum("fi,fi->f", u, v) for u, v in ((a, b), (b, c), (c, a))]
    bottom = la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb
    return float(np.arctan2(top, bottom).sum() / (2.0 * np.pi))


def covered_volume(surface: Surface) -> float:
    """Return the volume, m^3, of what closed pieces cover together, overlaps counted once.

    Lines along the longest axis are cut with the triangles; along a line the winding number is
    the sum of the triangles' signs before, and what has one above 0 is covered.
    """
    vertices = surface.vertices
    axis = int(np.ptp(vertices, axis=0).argmax())
    flat = [(axis + 1) % 3, (axis + 2) % 3]
    low, high = vertices.min(0), vertices.max(0)
    step = (high - low)[flat] / _LINES
    place = (vertices[:, flat] - low[flat]) / step - np.array([0.49371, 0.50793])  # no ties
    corners, depth = place[surface.faces], vertices[:, axis][surface.faces]
    first = np.ceil(corners.min(1)).astype(np.int64)
    count = np.maximum(np.floor(corners.max(1)).astype(np.int64) - first + 1, 0)
    total, covered = count.prod(1), 0.0
    rows = np.flatnonzero(total)
    hits: list[tuple[np.ndarray, ...]] = []
    for part in np.array_split(rows, max(1, int(total.sum() // 2_000_000) + 1)):
        owner = np.repeat(part, total[part])
        number = np.arange(len(owner)) - np.repeat(
            np.cumsum(total[part]) - total[part], total[part]
        )
        u = first[owner, 0] + number // count[owner, 1]
        v = first[owner, 1] + number % count[owner, 1]
        p = np.stack([u, v], axis=1) - corners[owner, 0]
        e, f = corners[owner, 1] - corners[owner, 0], corners[owner, 2] - corners[owner, 0]
        area = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            s = (p[:, 0] * f[:, 1] - p[:, 1] * f[:, 0]) / area
            t = (e[:, 0] * p[:, 1] - e[:, 1] * p[:, 0]) / area
        flat_ones = area == 0.0
        s[flat_ones] = -1.0
        hit = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
        d = depth[owner[hit]]
        x = d[:, 0] + s[hit] * (d[:, 1] - d[:, 0]) + t[hit] * (d[:, 2] - d[:, 0])
        hits.append((u[hit] * (_LINES + 1) + v[hit], x, -np.sign(area[hit])))
    line, x, sign = (np.concatenate(parts) for parts in zip(*hits, strict=True))
    order = np.lexsort((x, line))
    line, x, sign = line[order], x[order], sign[order]
    winding = np.cumsum(sign)
    start = np.flatnonzero(np.diff(line, prepend=-1))
    winding -= np.repeat(winding[start] - sign[start], np.diff(np.append(start, len(line))))
    same = line[1:] == line[:-1]
    covered = ((x[1:] - x[:-1]) * (same & (winding[:-1] > 0.5))).sum()
    return float(covered * step.prod())
