"""Finds the pairs of triangles of a surface that cross each other."""

from __future__ import annotations

import numpy as np

_CHUNK = 200_000  # pairs looked at together: bounds the memory


def _near_pairs(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the pairs (p, 2) of boxes (n, 3) that overlap.

    A binary tree of boxes, halved at the median of their longest side, is compared with itself
    level by level; long thin triangles and very different sizes are no trouble to it.
    """
    levels = max(len(low) - 1, 1).bit_length()
    order = np.full((1, 2**levels), -1)
    order[0, : len(low)] = np.arange(len(low))
    centre = np.vstack([0.5 * (low + high), np.full(3, np.inf)])  # row -1 fills up the tree
    low, high = np.vstack([low, np.full(3, np.inf)]), np.vstack([high, np.full(3, -np.inf)])
    for _ in range(levels):
        extent = high[order].max(1) - low[order].min(1)
        key = np.take_along_axis(
            centre[order], np.nan_to_num(extent).argmax(1)[:, None, None], axis=2
        )[..., 0]
        order = np.take_along_axis(order, key.argsort(1, kind="stable"), axis=1)
        order = order.reshape(2 * len(order), -1)
    leaves = order[:, 0]
    boxes = [(low[leaves], high[leaves])]
    for _ in range(levels):
        below, above = boxes[-1]
        pair = below.reshape(-1, 2, 3).min(1), above.reshape(-1, 2, 3).max(1)
        boxes.append(pair)
    a = b = np.zeros(1, np.int64)
    for below, above in reversed(boxes[:-1]):
        same = a == b
        apart = ~same
        first = [2 * a, 2 * a[apart], 2 * a[apart] + 1, 2 * a + 1]
        second = [2 * b, 2 * b[apart] + 1, 2 * b[apart], 2 * b + 1]
        first.append(2 * a[same])
        second.append(2 * a[same] + 1)
        a, b = np.concatenate(first), np.concatenate(second)
        touch = (below[a] <= above[b]).all(1) & (below[b] <= above[a]).all(1)
        a, b = a[touch], b[touch]
    pairs = np.stack([leaves[a], leaves[b]], axis=1)[a != b]
    return np.sort(pairs, axis=1)


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
    least = 1e-14 * np.ptp(vertices, axis=0).max() ** 3
    near = _near_pairs(corners.min(1), corners.max(1))
    crossings = [np.zeros((0, 2), np.int64)]
    for start in range(0, len(near), _CHUNK):
        pairs = near[start : start + _CHUNK]
        first, second = faces[pairs[:, 0]], faces[pairs[:, 1]]
        apart = (first[:, :, None] == second[:, None, :]).sum((1, 2)) < 2
        first, second = first[apart], second[apart]
        cross = _edges_cross(vertices, first, second, least)
        cross |= _edges_cross(vertices, second, first, least)
        crossings.append(pairs[apart][cross])
    joined = np.concatenate(crossings)
    return joined[np.lexsort(joined.T[::-1])]
