"""Finds where pieces of a surface touch, and moves them into each other a little."""

from __future__ import annotations

import numpy as np

from defplan_mj.body.fidelity import asked_points, distances_of
from defplan_mj.body.surface import Surface

_ASKED = 20_000  # points of a piece whose distances are taken
_ALL_ASKED = 160_000  # of all pieces together


def contact(
    vertices: np.ndarray,
    faces: np.ndarray,
    group: np.ndarray,
    outer: np.ndarray,
    touch: float,
    push: float,
) -> tuple[float, float, np.ndarray]:
    """Return the widest gap (m) between groups, how wide (m) the least contact is, and vertices.

    Groups are reached one after the other, those that touch first; their vertices are moved towards what
    was reached before, so that they overlap a little. It ends with the first gap that is too wide.

    Args:
        group: (f,) of each triangle.
        outer: the groups to join.
        touch, push: shares of the length: the widest gap that counts as a touch, and how far to move.
    """
    vertices = vertices.copy()
    size = np.ptp(vertices[np.unique(faces)], axis=0).max()
    count = min(_ASKED, _ALL_ASKED // len(outer))
    corners = {g: np.unique(faces[group == g]) for g in outer}
    reached, left, widest, width = [outer[0]], list(outer[1:]), 0.0, np.inf
    while left:
        there = Surface(vertices, faces[np.isin(group, reached)])
        bound = _box_gaps(
            [vertices[corners[g]] for g in left], [vertices[corners[g]] for g in reached]
        )
        best = (np.inf, 0, 0.0, np.zeros(3))
        for k in np.argsort(bound, kind="stable"):
            if bound[k] >= best[0] or best[0] <= touch * size:
                break
            points = asked_points(Surface(vertices, faces[group == left[k]]), count)
            gap = distances_of(points, there)[0]
            near = points[gap < max(1e-9 * size, gap.min() * 1.5)]
            if gap.min() < best[0]:
                best = (float(gap.min()), int(k), float(np.ptp(near, axis=0).max()), near.mean(0))
        gap_here, k, wide, place = best
        widest, width = max(widest, gap_here), min(width, wide)
        if gap_here > touch * size:
            break
        own = corners[left[k]]
        way = place - vertices[own].mean(0)  # from the piece's middle to where it touches
        vertices[own] += way / max(float(np.linalg.norm(way)), 1e-300) * (gap_here + push * size)
        reached.append(left.pop(k))
    return widest, width, vertices


def _box_gaps(pieces: list[np.ndarray], others: list[np.ndarray]) -> np.ndarray:
    """Return the distance (p,) of each piece's box from the nearest of others': no gap is smaller."""
    low, high = (np.stack([end(p, axis=0) for p in pieces])[:, None] for end in (np.min, np.max))
    floor, top = (np.stack([end(p, axis=0) for p in others]) for end in (np.min, np.max))
    apart = np.maximum(np.maximum(low - top, floor - high), 0.0)
    return np.linalg.norm(apart, axis=-1).min(1)
