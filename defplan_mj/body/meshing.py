"""From a closed surface to tetrahedra: isosurface stuffing on a body-centred cubic lattice.

The algorithm is Labelle and Shewchuk's ("Isosurface stuffing", SIGGRAPH 2007) with a uniform
lattice: lattice points too near the surface are moved onto it, then the tetrahedra that the
surface still cuts are replaced by their inner part. Here the crossings are exact intersections
with the triangles (lattice.py), and the lattice may be compressed along one axis, so that parts
thinner than a cell survive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body import lattice
from defplan_mj.body.fitting import fit_boundary, spread_points
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import (
    TetMesh,
    compact,
    face_pieces,
    quality,
    split_longest_edges,
    volumes,
)

# Shares of an edge within which a crossing pulls the lattice point onto the surface
# (Labelle and Shewchuk, table 1: every dihedral angle then stays above 10.7 degrees).
_SNAP_LONG, _SNAP_SHORT = 0.24999, 0.41189
_COMPRESSIONS, _STRONGEST = (0.85, 0.7), 0.5  # of the lattice along one axis; the thinnest one
_FEW = 0.004  # share of the vertices that may come by splitting edges without looking further
_NEAR = 0.3  # relative error of the count from which bisection can start
_FLATNESS = 0.05  # volume error that a loss of mean quality by 1 weighs as much as
_MOST_POINTS = 150  # lattice points tried for each vertex wanted
_MOST_LOST = 0.1  # share of the volume


@dataclass(frozen=True)
class _Lattice:
    """Points of the lattice around a surface, their tetrahedra and edges."""

    points: np.ndarray  # (n, 3) lattice coordinates
    tetrahedra: np.ndarray  # (t, 4)
    edges: tuple[tuple[tuple[int, int, int], np.ndarray], ...]  # direction, (e, 2) point indices


def _lattice(low: np.ndarray, high: np.ndarray) -> _Lattice:
    """Build the lattice that covers the box from low (3,) to high (3,) in lattice units."""
    first = np.floor(low).astype(np.int64) - 3
    shape = np.ceil(high).astype(np.int64) + 4 - first
    grid = np.stack(np.meshgrid(*(np.arange(s) for s in shape), indexing="ij"), -1) + first
    grid = grid.reshape(-1, 3)
    odd = grid % 2
    real = (odd[:, 0] == odd[:, 1]) & (odd[:, 0] == odd[:, 2])
    points = grid[real]
    index = np.full(len(grid), -1)
    index[real] = np.arange(len(points))
    index = index.reshape(shape)

    def at(where: np.ndarray) -> np.ndarray:
        place = where - first
        valid = ((place >= 0) & (place < shape)).all(1)
        return np.where(valid, index[tuple(np.where(valid[:, None], place, 0).T)], -1)

    edges = []
    for direction in (*lattice.AXES, *lattice.DIAGONALS):
        ends = np.stack([np.arange(len(points)), at(points + direction)], axis=1)
        edges.append((direction, ends[ends[:, 1] >= 0]))
    # a tetrahedron joins an edge between two odd points with an edge of the square around it
    cells = points[points[:, 0] % 2 == 1]
    tetrahedra = []
    for axis in range(3):
        step = np.zeros((3, 3), dtype=np.int64)
        step[0, axis] = step[1, (axis + 1) % 3] = step[2, (axis + 2) % 3] = 1
        along, u, v = step
        ring = [cells + along + a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        for i in range(4):
            corners = [cells, cells + 2 * along, ring[i], ring[(i + 1) % 4]]
            tetrahedra.append(np.stack([at(c) for c in corners], axis=1))
    joined = np.concatenate(tetrahedra)
    return _Lattice(points, joined[(joined >= 0).all(1)], tuple(edges))


def stuff(vertices: np.ndarray, faces: np.ndarray, cell: np.ndarray, centre: np.ndarray) -> TetMesh:
    """Fill a closed surface with tetrahedra.

    Args:
        vertices, faces: the surface, watertight.
        cell: (3,) edges of a lattice cell, m.
        centre: (3,) a lattice point, m.
    """
    scale = 0.5 * cell
    surface = (vertices - centre) / scale
    grid = _lattice(surface.min(0), surface.max(0))
    lines = {d: lattice.crossings(surface, faces, d) for d, _ in grid.edges}
    inside = lines[lattice.AXES[0]].inside(grid.points)
    sign = np.where(inside, 1, -1)
    place = grid.points.astype(float)

    cut = []  # edges from an inner to an outer point: (inner, outer, fraction, long)
    for direction, ends in grid.edges:
        crossed = ends[inside[ends[:, 0]] != inside[ends[:, 1]]]
        swap = ~inside[crossed[:, 0]]
        crossed[swap] = crossed[swap][:, ::-1]
        fraction = lines[direction].first(grid.points[crossed[:, 0]], grid.points[crossed[:, 1]])
        long = np.full(len(crossed), direction in lattice.AXES)
        cut.append((crossed[:, 0], crossed[:, 1], fraction, long))
    inner, outer, fraction, long = (np.concatenate(part) for part in zip(*cut, strict=True))
    reach = np.where(long, _SNAP_LONG, _SNAP_SHORT)
    crossing = place[inner] + fraction[:, None] * (place[outer] - place[inner])
    # first the inner, then the outer points: points of one side never share a cut edge
    for own, other, share in ((inner, outer, fraction), (outer, inner, 1.0 - fraction)):
        near = (share < reach) & (sign[own] != 0) & (sign[other] != 0)
        candidates = np.flatnonzero(near)
        distance = share[candidates] * np.where(long[candidates], 2.0, 3.0**0.5)
        order = candidates[np.lexsort((distance, own[candidates]))]
        moved, nearest = np.unique(own[order], return_index=True)
        place[moved] = crossing[order[nearest]]
        sign[moved] = 0

    alive = (sign[inner] > 0) & (sign[outer] < 0)
    count = len(grid.points)
    keys = inner[alive] * count + outer[alive]
    order = np.argsort(keys)
    keys, cut_points = keys[order], crossing[alive][order]

    def cut_point(p: np.ndarray, n: np.ndarray) -> np.ndarray:
        return count + np.searchsorted(keys, p * count + n)

    everything = np.vstack([place, cut_points])
    parts = _stencils(grid, sign, cut_point)
    tetrahedra = np.concatenate(parts)
    size = volumes(everything, tetrahedra)
    flip = size < 0.0
    tetrahedra[flip] = tetrahedra[flip][:, [0, 2, 1, 3]]
    return _largest_piece(compact(everything * scale + centre, tetrahedra))


def _largest_piece(mesh: TetMesh) -> TetMesh:
    """Drop crumbs that hang on by less than a face."""
    if len(mesh.tetrahedra) == 0:
        return mesh
    label, _ = face_pieces(mesh.tetrahedra)
    size = np.bincount(label, volumes(mesh.vertices, mesh.tetrahedra))
    return compact(mesh.vertices, mesh.tetrahedra[label == size.argmax()])


def _stencils(grid: _Lattice, sign: np.ndarray, cut_point) -> list[np.ndarray]:
    """Return the inner parts of the lattice's tetrahedra, as tetrahedra of either orientation.

    Corners are ordered by sign (inner, on the surface, outer) and, within the inner ones, by a
    fixed order of all points. A quadrilateral between two inner points and their two cut points
    is split from the inner point that comes first, so neighbours split it alike.
    """
    tetrahedra = grid.tetrahedra[(sign[grid.tetrahedra] > 0).any(1)]
    order = np.argsort(-sign[tetrahedra] * len(grid.points) + tetrahedra, axis=1, kind="stable")
    tetrahedra = np.take_along_axis(tetrahedra, order, axis=1)
    n_inner = (sign[tetrahedra] > 0).sum(1)
    n_outer = (sign[tetrahedra] < 0).sum(1)

    def case(inner: int, outer: int) -> tuple[np.ndarray, ...]:
        return tuple(tetrahedra[(n_inner == inner) & (n_outer == outer)].T)

    parts = [tetrahedra[n_outer == 0]]
    a, b, c, d = case(1, 1)
    parts.append(np.stack([a, b, c, cut_point(a, d)], 1))
    a, b, c, d = case(1, 2)
    parts.append(np.stack([a, b, cut_point(a, c), cut_point(a, d)], 1))
    a, b, c, d = case(1, 3)
    parts.append(np.stack([a, cut_point(a, b), cut_point(a, c), cut_point(a, d)], 1))
    a, b, c, d = case(2, 1)
    ad, bd = cut_point(a, d), cut_point(b, d)
    parts += [np.stack([a, b, c, bd], 1), np.stack([a, bd, c, ad], 1)]
    a, b, c, d = case(2, 2)
    parts += _prism((a, cut_point(a, c), cut_point(a, d)), (b, cut_point(b, c), cut_point(b, d)))
    a, b, c, d = case(3, 1)
    parts += _prism((a, b, c), (cut_point(a, d), cut_point(b, d), cut_point(c, d)))
    return parts


def _prism(top: tuple[np.ndarray, ...], bottom: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """Split a prism in three; diagonals run from top[0] to bottom[1], bottom[2], top[1] to bottom[2]."""
    a, b, c = top
    d, e, f = bottom
    return [np.stack(t, 1) for t in ((a, d, e, f), (a, b, e, f), (a, b, c, f))]


def fill(surface: Surface, vertices: int, name: str = "the mesh") -> tuple[TetMesh, np.ndarray]:
    """Fill a surface with tetrahedra that have `vertices` vertices.

    Of lattices compressed along one axis or none, the one is taken that keeps most volume without
    flattening the tetrahedra much; its boundary is then fitted to the surface.

    Args:
        name: what messages call the mesh.

    Returns:
        The mesh and the (3,) edges of its lattice cell, m (along the lattice's axes).

    Raises:
        DefplanError: parts of the surface are too thin for so few vertices.
    """
    frame = _frame(surface)
    surface = Surface(surface.vertices @ frame, surface.faces)
    volume = surface.volume
    best: tuple[float, np.ndarray, float] | None = None
    guess = 1.4 * (2.0 * volume / vertices) ** (1.0 / 3.0)
    for shape in _cell_shapes(np.ptp(surface.vertices, axis=0)):
        mesh, cell = _near_count(surface, shape, vertices, guess)
        if mesh is None:
            continue
        lost = abs(volumes(mesh.vertices, mesh.tetrahedra).sum() / volume - 1.0)
        score = lost + _FLATNESS * (1.0 - quality(mesh.vertices, mesh.tetrahedra).mean())
        if best is None or score < best[0]:
            best = score, shape, cell
    if best is None:
        raise DefplanError(f"{name} cannot be filled with {vertices} vertices: ask for more")
    _, shape, guess = best
    mesh, cell = _exact_count(surface, shape, vertices, guess)
    if mesh is None:
        raise DefplanError(f"{name} cannot be filled with {vertices} vertices: ask for some more")
    mesh = fit_boundary(mesh, surface)
    lost = 1.0 - volumes(mesh.vertices, mesh.tetrahedra).sum() / volume
    if lost > _MOST_LOST:
        raise DefplanError(
            f"{name} has parts too thin for {vertices} vertices ({100 * lost:.0f}% of its volume"
            " is lost): ask for more vertices"
        )
    return TetMesh(mesh.vertices @ frame.T, mesh.tetrahedra), cell * shape


def _frame(surface: Surface) -> np.ndarray:
    """Return the axes (3, 3, columns) of the lattice: the body's own, or its principal ones.

    The principal axes are taken for bodies that lie askew: the box around them is then half as
    large or less.
    """
    points, _ = spread_points(surface, 4000)
    axes = np.linalg.svd(points - points.mean(0), full_matrices=False)[2].T
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    own, turned = (np.ptp(surface.vertices @ frame, axis=0).prod() for frame in (np.eye(3), axes))
    return axes if turned < 0.5 * own else np.eye(3)


def _cell_shapes(extent: np.ndarray) -> list[np.ndarray]:
    """Return the cells to try (3,), of volume 1: a cube, and cubes compressed along one axis."""
    shapes = [np.ones(3)]
    for axis in range(3):
        factors = _COMPRESSIONS + ((_STRONGEST,) if axis == extent.argmin() else ())
        shapes += [np.where(np.arange(3) == axis, factor, 1.0) for factor in factors]
    return [shape / shape.prod() ** (1.0 / 3.0) for shape in shapes]


def _attempt(surface: Surface, cell: np.ndarray, shift: np.ndarray) -> TetMesh:
    """Fill the surface with a lattice centred on its box but for a `shift` (3,), in cells."""
    centre = 0.5 * (surface.vertices.min(0) + surface.vertices.max(0))
    return stuff(surface.vertices, surface.faces, cell, centre + shift * cell)


def _near_count(
    surface: Surface, shape: np.ndarray, vertices: int, cell: float
) -> tuple[TetMesh | None, float]:
    """Find a cell that gives about the count, by its power law: mesh (None if none), cell."""
    box = np.ptp(surface.vertices, axis=0).prod()
    nearest: tuple[float, TetMesh | None, float] = (_NEAR, None, cell)
    for _ in range(6):
        if 2.0 * box / cell**3 > _MOST_POINTS * vertices:
            break
        mesh = _attempt(surface, cell * shape, np.zeros(3))
        count = max(len(mesh.vertices), 8)
        if abs(count / vertices - 1.0) < nearest[0]:
            nearest = abs(count / vertices - 1.0), mesh, cell
        if nearest[0] < 0.05:
            break
        cell *= (count / vertices) ** (1.0 / 2.5)
    return nearest[1:]


def _exact_count(
    surface: Surface, shape: np.ndarray, vertices: int, cell: float
) -> tuple[TetMesh | None, float]:
    """Find a mesh with exactly this count: bisection on the cell, with the lattice moved in x.

    The last vertices come by splitting edges. They are few, but on a body that lies along the
    axes, where whole layers of the lattice come and go at once and the count jumps.
    """
    fewer: tuple[TetMesh | None, float] = (None, cell)
    for shift in (0.0, 0.5, 0.25, 0.125, 0.375):
        low, high = 0.85 * cell, 1.2 * cell
        for _ in range(12):
            middle = 0.5 * (low + high)
            mesh = _attempt(surface, middle * shape, np.array([shift, 0.0, 0.0]))
            count = len(mesh.vertices)
            if 0 <= vertices - count <= max(2, _FEW * vertices):
                return split_longest_edges(mesh, vertices - count), middle
            low, high = (middle, high) if count > vertices else (low, middle)
            if count < vertices and (fewer[0] is None or count > len(fewer[0].vertices)):
                fewer = mesh, middle
    if fewer[0] is None:
        return fewer
    return split_longest_edges(fewer[0], vertices - len(fewer[0].vertices)), fewer[1]
