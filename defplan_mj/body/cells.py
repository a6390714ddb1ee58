"""Splits cells and faces of all kinds into tetrahedra and triangles that fit each other."""

from __future__ import annotations

import re

import numpy as np

from defplan_mj.base.segments import segment_distance

# Faces of the linear cells, outward, by local corner.
FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "tetra": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    "hexahedron": (
        (0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
    ),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}  # fmt: skip
CORNERS = {"tetra": 4, "hexahedron": 8, "wedge": 6, "pyramid": 5, "triangle": 3, "quad": 4}
# The edges whose middles are the further nodes of second-order cells, in meshio's order.
_EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hexahedron": (
        (0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7),
    ),
    "wedge": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    "pyramid": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
}  # fmt: skip
_MIRRORED = {
    "hexahedron": (0, 3, 2, 1, 4, 7, 6, 5),
    "wedge": (0, 2, 1, 3, 5, 4),
    "pyramid": (0, 3, 2, 1, 4),
}
_CHOOSY = 60  # corners of a polygon up to which all ears are compared
_TRI6 = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))
_TET10 = (
    (0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3),
    (4, 8, 6, 7), (4, 5, 6, 8), (6, 9, 7, 8), (6, 5, 9, 8),
)  # fmt: skip


def linear_kind(kind: str) -> str | None:
    """Return the linear kind of a meshio cell type, such as tetra of tetra10; None of others."""
    name = kind.lower().removeprefix("vtk_lagrange_")
    name = {"tetrahedron": "tetra", "quadrilateral": "quad"}.get(name, name)
    match = re.fullmatch(r"(tetra|hexahedron|wedge|pyramid|triangle|quad)\d*", name)
    return match[1] if match else None


def straighten(
    vertices: np.ndarray, kind: str, cells: np.ndarray, least: float
) -> tuple[np.ndarray, float]:
    """Return linear cells for cells of any order, and how far (m) curved edges are then off.

    Curved triangles and tetrahedra of second order (off by more than `least`) are split at the
    middles of their edges.
    """
    corners, edges = CORNERS[kind], _EDGES[kind]
    if cells.shape[1] < corners + len(edges):
        return cells[:, :corners], 0.0
    ends, order = np.array(edges), _order(kind, cells.shape[1])
    if order > 2:
        # their nodes stand in an order of each format's own: any edge of the cell will do
        nodes = vertices[cells[:, corners : corners + len(edges) * (order - 1)]]
        start, end = vertices[cells[:, ends[:, 0]]], vertices[cells[:, ends[:, 1]]]
        return cells[:, :corners], _off_edges(nodes, start, end)
    middle = 0.5 * (vertices[cells[:, ends[:, 0]]] + vertices[cells[:, ends[:, 1]]])
    nodes = vertices[cells[:, corners : corners + len(edges)]]
    off = float(np.linalg.norm(nodes - middle, axis=-1).max(initial=0.0))
    if off > least and cells.shape[1] in (6, 10) and kind in ("triangle", "tetra"):
        parts = _TRI6 if kind == "triangle" else _TET10
        return np.concatenate([cells[:, part] for part in parts]), 0.0
    return cells[:, :corners], off


def _order(kind: str, nodes: int) -> int:
    """Return the order of cells with so many nodes, with or without those inside; 2 if it is unknown."""
    corners, edges = CORNERS[kind], len(_EDGES[kind])
    for k in range(3, 11):
        full = {
            "triangle": (k + 1) * (k + 2) // 2, "quad": (k + 1) ** 2, "hexahedron": (k + 1) ** 3,
            "tetra": (k + 1) * (k + 2) * (k + 3) // 6, "wedge": (k + 1) ** 2 * (k + 2) // 2,
            "pyramid": (k + 1) * (k + 2) * (2 * k + 3) // 6,
        }[kind]  # fmt: skip
        if nodes in (full, corners + edges * (k - 1)):
            return k
    return 2


def _off_edges(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Return how far, m, the worst of points (c, p, 3) is from the nearest of its cell's edges (c, e, 3)."""
    least = np.full(points.shape[:2], np.inf)
    for e in range(start.shape[1]):  # one by one: all at once would be e times the memory
        least = np.minimum(least, segment_distance(points, start[:, None, e], end[:, None, e]))
    return float(least.max(initial=0.0))


def split_polygons(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Return the triangles of polygons (p, n), convex or not, that lie about in a plane."""
    n = polygons.shape[1]
    if n == 3 or len(polygons) == 0:
        return polygons[:, :3].reshape(-1, 3)
    place = vertices[polygons]
    ahead, behind = np.roll(place, -1, axis=1), np.roll(place, 1, axis=1)
    normal = np.cross(place, ahead).sum(1)
    turn = np.einsum("pni,pi->pn", np.cross(place - behind, ahead - place), normal)
    convex = (turn >= 0.0).all(1)
    fan = polygons[convex]
    # a quadrilateral is split from its first corner, others likewise
    triangles = [np.stack([fan[:, 0], fan[:, i], fan[:, i + 1]], 1) for i in range(1, n - 1)]
    hollow = np.flatnonzero(~convex)
    if len(hollow):
        clipped = [_clip_ears(place[i], polygons[i], normal[i]) for i in hollow]
        triangles.append(np.concatenate(clipped))
    return np.concatenate(triangles)


def _clip_ears(place: np.ndarray, polygon: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return triangles (n - 2, 3) of one polygon, the best-shaped ear first (of many corners: any)."""
    size = float(np.linalg.norm(normal))
    unit = normal / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    u = np.cross(unit, np.eye(3)[np.abs(unit).argmin()])
    u /= np.linalg.norm(u)
    flat = [(float(p @ u), float(p @ np.cross(unit, u))) for p in place]
    left, triangles = list(range(len(polygon))), []
    choosy = len(left) <= _CHOOSY

    def area(a: int, b: int, c: int) -> float:
        (xa, ya), (xb, yb), (xc, yc) = flat[a], flat[b], flat[c]
        return (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)

    def side(a: int, b: int) -> float:
        return (flat[a][0] - flat[b][0]) ** 2 + (flat[a][1] - flat[b][1]) ** 2

    while len(left) > 3:
        best = (-np.inf, 0)
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            own = area(a, b, c)
            if own <= 0.0 or any(
                area(a, b, p) >= 0.0 and area(b, c, p) >= 0.0 and area(c, a, p) >= 0.0
                for p in left
                if p not in (a, b, c)
            ):
                continue
            best = max(best, (own / max(side(a, b), side(b, c), side(c, a)), k))
            if not choosy:
                break
        k = best[1]
        triangles.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    return polygon[np.array([*triangles, left])]


def split_cells(
    vertices: np.ndarray, cells: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and tetrahedra (t, 4) of linear cells; some get a vertex in their middle.

    A quadrilateral face is cut from its corner with the smallest number, or as the triangles of
    tetrahedra on its other side have it. Without such a neighbour a cell is a cone from its
    smallest corner (Dompierre et al. 1999), otherwise one from its middle.
    """
    tetrahedra = [cells.get("tetra", np.zeros((0, 4), np.int64))]
    keys = _triangle_keys(cells, len(vertices) + 1)
    new: list[np.ndarray] = []
    count = len(vertices)
    for kind in ("hexahedron", "wedge", "pyramid"):
        rows = _outward(vertices, kind, cells.get(kind, np.zeros((0, CORNERS[kind]), np.int64)))
        if len(rows) == 0:
            continue
        smallest = rows.argmin(1)
        forced = np.zeros(len(rows), bool)
        second: dict[
            tuple[int, ...], np.ndarray
        ] = {}  # face: whether it is cut between its second and fourth corner
        for face in FACES[kind]:
            if len(face) == 4:
                corners = rows[:, face]
                by_rule = corners.argmin(1) % 2 == 1
                has = [
                    _has_key(keys, corners[:, part], len(vertices) + 1)
                    for part in ((0, 1, 2), (0, 2, 3), (1, 2, 3), (0, 1, 3))
                ]
                first_there, second_there = has[0] | has[1], has[2] | has[3]
                cut = np.where(first_there, False, np.where(second_there, True, by_rule))
                forced |= cut != by_rule
                second[face] = cut
        for apex in range(CORNERS[kind]):
            own = (smallest == apex) & ~forced
            for face in FACES[kind]:
                if apex in face or not own.any():
                    continue
                for a, b, c in _halves(rows[own][:, face], second.get(face, own)[own]):
                    tetrahedra.append(np.stack([rows[own][:, apex], a, b, c], 1))
        if forced.any():
            own = rows[forced]
            middle = count + np.arange(len(own))
            count += len(own)
            new.append(vertices[own].mean(1))
            for face in FACES[kind]:
                for a, b, c in _halves(own[:, face], second.get(face, forced)[forced]):
                    tetrahedra.append(np.stack([middle, a, b, c], 1))
    return np.vstack([vertices, *new]), np.concatenate(tetrahedra)


def _outward(vertices: np.ndarray, kind: str, rows: np.ndarray) -> np.ndarray:
    """Return the cells with those turned whose corners run the other way (their volume is negative)."""
    centre, six = vertices[rows].mean(1), np.zeros(len(rows))
    for face in FACES[kind]:
        place = vertices[rows[:, face]] - centre[:, None]
        for i in range(1, len(face) - 1):
            six += np.einsum("ci,ci->c", np.cross(place[:, 0], place[:, i]), place[:, i + 1])
    return np.where((six < 0.0)[:, None], rows[:, _MIRRORED[kind]], rows)


def _halves(corners: np.ndarray, second: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """Return the triangles of faces (n, 3 or 4), all n in each, cut as `second` (n,) says."""
    if corners.shape[1] == 3:
        return [tuple(corners.T)]
    a, b, c, d = corners.T
    return [
        (np.where(second, b, a), np.where(second, c, b), np.where(second, d, c)),
        (np.where(second, b, a), np.where(second, d, c), np.where(second, a, d)),
    ]


def _triangle_keys(cells: dict[str, np.ndarray], base: int) -> np.ndarray:
    """Return sorted numbers of the triangular faces of all cells that have quadrilaterals beside them."""
    if not any(len(cells.get(k, ())) for k in ("hexahedron", "wedge", "pyramid")):
        return np.zeros(0, np.int64)
    faces = [
        rows[:, face]
        for kind, rows in cells.items()
        for face in FACES[kind]
        if len(face) == 3 and len(rows)
    ]
    return np.unique(_key(np.concatenate(faces), base)) if faces else np.zeros(0, np.int64)


def _key(triangles: np.ndarray, base: int) -> np.ndarray:
    low, middle, high = np.sort(triangles, axis=1).T
    return (low * base + middle) * base + high


def _has_key(keys: np.ndarray, triangles: np.ndarray, base: int) -> np.ndarray:
    if len(keys) == 0:
        return np.zeros(len(triangles), bool)
    key = _key(triangles, base)
    at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    return keys[at] == key
