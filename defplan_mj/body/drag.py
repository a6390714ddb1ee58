"""Drag patches: the surface in a few pieces, each with a point and two tangents that deform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.body.tetmesh import TetMesh, boundary, shape_gradients

_NORMAL_WEIGHT = 0.25  # of a unit normal against a position, in body lengths


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


def drag_patches(mesh: TetMesh, shapes: np.ndarray, count: int, seed: int = 0) -> Patches:
    """Cluster the surface by place and normal.

    Args:
        shapes: (n, 3, k+1) rest positions | basis.
        count: patches wanted; fewer come back if the surface has fewer triangles.
    """
    faces, owner = boundary(mesh.tetrahedra)
    a, b, c = (mesh.vertices[faces[:, i]] for i in range(3))
    vector = 0.5 * np.cross(b - a, c - a)
    area = np.linalg.norm(vector, axis=1)
    length = np.ptp(mesh.vertices, axis=0).max()
    place = np.hstack([(a + b + c) / 3.0, _NORMAL_WEIGHT * length * vector / area[:, None]])
    labels = weighted_clusters(place, area, count, np.random.default_rng(seed))

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
