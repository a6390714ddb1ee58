"""Drag patches: the surface in a few pieces, each with a point and two tangents that deform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from defplan_mj.body.tetmesh import TetMesh, boundary, shape_gradients

_MIRROR_TOLERANCE = 1e-3  # of the median triangle, in body lengths
# Typical speeds: lengths a second, rad a second, units of q a second; and what a place counts for.
_TRANSLATION, _ROTATION, _MODE, _PLACE = 1.0, 4.0, 10.0, 2.0


@dataclass(frozen=True)
class Patches:
    """See `Body.patch_points`, `patch_tangents` and `patch_areas`."""

    points: np.ndarray
    tangents: np.ndarray
    areas: np.ndarray


def weighted_clusters(
    points: np.ndarray, weights: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Return labels (m,) of points (m, d) by weighted k-means; labels are 0.. without gaps."""
    centres = points[rng.choice(len(points), 1)]
    while len(centres) < min(count, len(points)):
        square = ((points[:, None] - centres[None]) ** 2).sum(-1).min(1) * weights
        centres = np.vstack([centres, points[square.argmax()]])
    labels = np.zeros(len(points), dtype=np.int64)
    for _ in range(60):
        labels = ((points[:, None] - centres[None]) ** 2).sum(-1).argmin(1)
        previous = centres.copy()
        for i in np.unique(labels):
            own = labels == i
            centres[i] = weights[own] @ points[own] / weights[own].sum()
        if np.array_equal(previous, centres):
            break
    return np.unique(labels, return_inverse=True)[1]


def surface_clusters(
    centre: np.ndarray,
    vector: np.ndarray,
    modes: np.ndarray,
    count: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return labels (f,) of triangles in `count` clusters that move alike along their normals.

    Drag depends on the speed along the normal, so triangles belong together if that is the same
    in every translation, rotation and mode, each at a speed typical of swimming.

    A surface that is its own mirror image in the plane y = 0 gets clusters in mirrored pairs, so
    that the drag of a symmetric body is symmetric.

    Args:
        centre: (f, 3) centroids, m.
        vector: (f, 3) area vectors, m^2.
        modes: (f, 3, r) modes at the centroids, m.
    """
    area = np.linalg.norm(vector, axis=1)
    normal = vector / area[:, None]
    length = np.ptp(centre, axis=0).max()
    speeds = [
        _TRANSLATION * length * normal,
        _ROTATION * np.cross(centre, normal),
        _MODE * np.einsum("fir,fi->fr", modes, normal),
        _PLACE * centre,
    ]
    features = np.hstack(speeds)
    place = np.hstack([centre, 0.2 * length * normal])
    mirrored = place * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    distance, _ = cKDTree(place).query(mirrored)
    if count < 2 or np.median(distance) > _MIRROR_TOLERANCE * length:
        return weighted_clusters(features, area, count, rng)
    left = place[:, 1] + place[:, 4] > 0.0  # on the plane the normal decides
    half = weighted_clusters(features[left], area[left], count // 2, rng)
    _, twin = cKDTree(place[left]).query(mirrored[~left])
    labels = np.zeros(len(area), dtype=np.int64)
    labels[left], labels[~left] = 2 * half, 2 * half[twin] + 1
    return np.unique(labels, return_inverse=True)[1]


def drag_patches(
    mesh: TetMesh, shapes: np.ndarray, modes: np.ndarray, count: int, seed: int = 0
) -> Patches:
    """Divide the surface into patches.

    Args:
        shapes: (n, 3, k+1) rest positions | basis.
        modes: (n, 3, r) linear modes, m.
        count: patches wanted; fewer come back if the surface has fewer triangles.
    """
    faces, owner = boundary(mesh.tetrahedra)
    a, b, c = (mesh.vertices[faces[:, i]] for i in range(3))
    vector = 0.5 * np.cross(b - a, c - a)
    area = np.linalg.norm(vector, axis=1)
    place, moves = (a + b + c) / 3.0, modes[faces].mean(1)
    labels = surface_clusters(place, vector, moves, count, np.random.default_rng(seed))

    gradients = shape_gradients(mesh.vertices, mesh.tetrahedra)[owner]
    moved = np.einsum("eaj,eaik->eijk", gradients, shapes[mesh.tetrahedra[owner]])
    centre = shapes[faces].mean(1)
    points, tangents, areas = [], [], []
    for i in range(labels.max() + 1):
        own = labels == i
        share = area[own] / area[own].sum()
        total = vector[own].sum(0)
        size = np.linalg.norm(total)
        normal = total / size
        first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        first /= np.linalg.norm(first)
        pair = np.stack([first, np.cross(normal, first)])
        gradient = np.einsum("e,eijk->ijk", share, moved[own])
        points.append(np.einsum("e,eik->ik", share, centre[own]))
        tangents.append(np.einsum("ijk,tj->tik", gradient, pair))
        areas.append(size)
    return Patches(np.stack(points), np.stack(tangents, axis=1), np.array(areas))
