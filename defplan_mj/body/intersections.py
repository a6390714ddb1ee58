"""Finds the pairs of triangles of a surface that cross each other."""

from __future__ import annotations

import numpy as np

_CHUNK = 200_000


def _near_pairs(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the pairs (p, 2) of boxes (n, 3) that overlap, by hashing them into a grid."""
    size = 2.0 * (high - low).max(1).mean()
    first = np.floor((low - low.min(0)) / size).astype(np.int64)
    shape = np.floor((high - low.min(0)) / size).astype(np.int64) - first + 1
    count = shape.prod(1)
    box = np.repeat(np.arange(len(low)), count)
    rank = np.arange(len(box)) - np.repeat(np.cumsum(count) - count, count)
    ny, nz = shape[box, 1], shape[box, 2]
    cell = first[box] + np.stack([rank // (ny * nz), rank // nz % ny, rank % nz], axis=1)
    width = (first + shape).max(0)
    key = (cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    key, box = key[order], box[order]
    pairs = []
    # neighbours in the sorted list, ever farther apart, as long as some share a cell
    for shift in range(1, len(key)):
        same = key[shift:] == key[:-shift]
        if not same.any():
            break
        a, b = box[:-shift][same], box[shift:][same]
        overlap = (low[a] <= high[b]).all(1) & (low[b] <= high[a]).all(1)
        pairs.append(np.stack([a, b], 1)[overlap])
    if not pairs:
        return np.zeros((0, 2), np.int64)
    joined = np.sort(np.concatenate(pairs), axis=1)
    code = np.unique(joined[:, 0] * len(low) + joined[:, 1])
    return np.stack([code // len(low), code % len(low)], axis=1)


def _orientation(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return six times the volume of tetrahedra abcd; each (m, 3)."""
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)


def _edges_cross(
    vertices: np.ndarray, first: np.ndarray, second: np.ndarray, least: float
) -> np.ndarray:
    """Say (m,) whether an edge of triangles `first` (m, 3) pierces triangles `second` (m, 3).

    Edges that share a vertex with the other triangle do not count, nor does an end that just
    touches it; passing through its rim does.
    """
    a, b, c = (vertices[second[:, i]] for i in range(3))
    result = np.zeros(len(first), dtype=bool)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        ends = first[:, [i, j]]
        apart = (ends[:, :, None] != second[:, None, :]).all((1, 2))
        p, q = vertices[ends[:, 0]], vertices[ends[:, 1]]
        below, above = _orientation(a, b, c, p), _orientation(a, b, c, q)
        opposite = (np.abs(below) > least) & (np.abs(above) > least) & (below * above < 0.0)
        sides = np.stack(
            [_orientation(p, q, a, b), _orientation(p, q, b, c), _orientation(p, q, c, a)]
        )
        within = (sides >= 0.0).all(0) | (sides <= 0.0).all(0)
        result |= apart & opposite & within
    return result


def crossing_triangles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the pairs (p, 2) of triangles that cross; triangles with a common edge never do.

    Args:
        vertices: (n, 3).
        faces: (f, 3).
    """
    corners = vertices[faces]
    pairs = _near_pairs(corners.min(1), corners.max(1))
    least = 1e-14 * np.ptp(vertices, axis=0).max() ** 3
    found = []
    for start in range(0, len(pairs), _CHUNK):
        part = pairs[start : start + _CHUNK]
        first, second = faces[part[:, 0]], faces[part[:, 1]]
        common = (first[:, :, None] == second[:, None, :]).sum((1, 2))
        part, first, second = part[common < 2], first[common < 2], second[common < 2]
        cross = _edges_cross(vertices, first, second, least)
        cross |= _edges_cross(vertices, second, first, least)
        found.append(part[cross])
    return np.concatenate(found) if found else np.zeros((0, 2), np.int64)
