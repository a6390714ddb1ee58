"""Where the lines of a body-centred cubic lattice cross a closed surface, and what lies inside.

Lattice points are integer triples whose three numbers have the same parity, in units of half a
cell. Their edges lie on lines in seven directions: three along the axes (length 2) and four along
the diagonals. A crossing is found by projecting the triangles along the direction onto the plane
of the line numbers. Sides of edges are decided with one formula per undirected edge, so that the
two triangles at an edge never both miss nor both take a line: the parity of crossings is exact
for any watertight surface, whatever lies on a lattice line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

AXES = ((2, 0, 0), (0, 2, 0), (0, 0, 2))
DIAGONALS = ((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))


def _projection(direction: tuple[int, int, int]) -> tuple[np.ndarray, int]:
    """Return the (2, 3) integer map from points to line numbers, and the axis that runs along."""
    if direction in AXES:
        axis = direction.index(2)
        first, second = (axis + 1) % 3, (axis + 2) % 3
        rows = np.zeros((2, 3), dtype=np.int64)
        rows[0, first] = rows[1, second] = 1
        return rows, axis
    _, sy, sz = direction
    return np.array([[-sy, 1, 0], [-sz, 0, 1]]), 0


@dataclass(frozen=True)
class Crossings:
    """Crossings of the lattice lines of one direction with the surface.

    Attributes:
        direction: of the lines, lattice units.
        rows: (2, 3) map from a lattice point to the numbers of its line.
        axis: the coordinate that places a point on its line.
        keys: (c,) sorted: line number times `stride` plus the place on the line.
    """

    direction: tuple[int, int, int]
    rows: np.ndarray
    axis: int
    low: np.ndarray
    high: np.ndarray
    stride: float
    keys: np.ndarray

    def line_keys(self, points: np.ndarray) -> np.ndarray:
        """Return the keys (p,) of where the lines through lattice points (p, 3) start."""
        number = np.clip(points @ self.rows.T, self.low, self.high) - self.low
        width = self.high[1] - self.low[1] + 1
        return (number[:, 0] * width + number[:, 1]) * self.stride

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Say (p,) which lattice points (p, 3) lie inside, by the parity of crossings before."""
        start = self.line_keys(points)
        before = np.searchsorted(self.keys, start + points[:, self.axis] + 0.5 * self.stride)
        return (before - np.searchsorted(self.keys, start)) % 2 == 1

    def first(self, points: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return where (p,), as a fraction, the way from `points` to `ends` first crosses.

        The two differ by plus or minus the direction and lie on different sides. A crossing that
        rounding has put just outside of the way is moved to its nearest end.
        """
        start = self.line_keys(points) + 0.5 * self.stride
        here, there = points[:, self.axis], ends[:, self.axis]
        forward = there > here
        index = np.searchsorted(self.keys, start + here)
        ahead = self.keys[np.clip(index, 0, len(self.keys) - 1)] - start
        behind = self.keys[np.clip(index - 1, 0, len(self.keys) - 1)] - start
        place = np.where(forward, ahead, behind)
        return np.clip((place - here) / (there - here), 0.0, 1.0)


def crossings(
    vertices: np.ndarray, faces: np.ndarray, direction: tuple[int, int, int]
) -> Crossings:
    """Find where the lattice lines of one direction cross a surface given in lattice units.

    Args:
        vertices: (n, 3), lattice units.
        faces: (f, 3) of a watertight surface.
    """
    rows, axis = _projection(direction)
    flat = vertices @ rows.T.astype(float)
    corners = flat[faces]
    low = np.ceil(corners.min(1)).astype(np.int64)
    high = np.floor(corners.max(1)).astype(np.int64)
    size = np.maximum(high - low + 1, 0)
    count = size.prod(1)
    face = np.repeat(np.arange(len(faces)), count)
    rank = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    line = np.stack([rank // size[face, 1], rank % size[face, 1]], axis=1) + low[face]
    real = (line[:, 0] - line[:, 1]) % 2 == 0 if direction in AXES else (line % 2 == 0).all(1)
    face, line = face[real], line[real]

    side = np.empty((len(face), 3))
    for i in range(3):
        a, b = faces[face, (i + 1) % 3], faces[face, (i + 2) % 3]
        first, second = np.minimum(a, b), np.maximum(a, b)
        p, d = flat[first], flat[second] - flat[first]
        area = d[:, 0] * (line[:, 1] - p[:, 1]) - d[:, 1] * (line[:, 0] - p[:, 0])
        side[:, i] = np.where(a < b, 1.0, -1.0) * _sign(area, d)
    hit = np.abs(side.sum(1)) == 3.0
    face, line = face[hit], line[hit]

    a, b, c = (vertices[faces[face, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    along = np.array(direction, dtype=float) / direction[axis]
    base = np.zeros((len(face), 3), dtype=np.int64)
    base[:, [(axis + 1) % 3, (axis + 2) % 3]] = line
    place = np.einsum("ij,ij->i", normal, a - base) / (normal @ along)
    stride = 4.0 * (np.abs(vertices).max() + 4.0)
    lowest = np.floor(flat.min(0)).astype(np.int64) - 1
    highest = np.ceil(flat.max(0)).astype(np.int64) + 1
    empty = Crossings(direction, rows, axis, lowest, highest, stride, np.zeros(0))
    return replace(empty, keys=np.sort(empty.line_keys(base) + 0.5 * stride + place))


def _sign(area: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Return the side (+1 or -1) of a point seen from an edge; a point on the line is moved up.

    A point on the line counts as moved by an infinitesimal (e^2, e): the sign is then that of
    the edge's own direction, the same for both triangles.
    """
    tie = np.where(edge[:, 0] != 0.0, np.sign(edge[:, 0]), -np.sign(edge[:, 1]))
    return np.where(area != 0.0, np.sign(area), tie)
