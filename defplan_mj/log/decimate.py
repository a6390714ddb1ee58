"""A coarser surface for drawing: some of the vertices, chosen once, so that it deforms with the body."""

from __future__ import annotations

import numpy as np


def decimate(points: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Pick vertices of a triangle surface so that about `most` faces are left (never more).

    Vertices are clustered in a cubic grid whose cell is found by bisection; each cluster is
    represented by the vertex nearest to its mean, so the kept vertices are vertices of the body.

    Args:
        points: (n, 3) rest positions.
        faces: (f, 3) indices into them.
        most: largest number of faces to keep.

    Returns:
        (m,) indices of the kept points, and (g, 3) faces as indices into those m.
    """
    used = np.unique(faces)
    if len(faces) <= most:
        return used, np.searchsorted(used, faces)
    low, high = 0.0, float(np.ptp(points, axis=0).max())
    best = _cluster(points, faces, used, high)
    for _ in range(20):
        cell = (low + high) / 2
        trial = _cluster(points, faces, used, cell)
        if len(trial[1]) > most:
            low = cell
        else:
            high, best = cell, trial
    return best


def _cluster(
    points: np.ndarray, faces: np.ndarray, used: np.ndarray, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """Merge the used vertices that share a grid cell; drop faces that lose a corner or come twice."""
    grid = np.floor((points[used] - points[used].min(0)) / cell).astype(np.int64)
    label = np.unique(grid, axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(label)
    mean = np.column_stack([np.bincount(label, points[used, i]) / count for i in range(3)])
    distance = np.linalg.norm(points[used] - mean[label], axis=1)
    order = np.lexsort((distance, label))
    kept = used[order[np.r_[True, np.diff(label[order]) > 0]]]

    corner = label[np.searchsorted(used, faces)]
    corner = corner[(np.diff(np.sort(corner, axis=1), axis=1) > 0).all(1)]
    if len(corner):
        corner = corner[np.unique(np.sort(corner, axis=1), axis=0, return_index=True)[1]]
    still = np.unique(corner)  # clusters that some face still uses
    return kept[still], np.searchsorted(still, corner)
