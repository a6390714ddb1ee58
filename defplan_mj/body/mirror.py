"""Mirror planes of a body, and where a place of its surface is seen in them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from defplan_mj.body.tetmesh import boundary, lumped_mass, volumes

_TOLERANCE = 5e-3  # rms distance of the mirrored surface from the surface, in body lengths
_NEAR = 12  # triangles, by their centres, among which the nearest place is looked for
AXES = (
    1,
    0,
)  # planes y = 0 and x = 0; z is up, and nothing that lives under gravity is alike there


@dataclass(frozen=True)
class Places:
    """Places of a surface.

    Attributes:
        triangles: (m,) which triangle each lies on.
        weights: (m, 3) barycentric coordinates in it.
        distances: (m,) how far each is from the point that was asked for, m.
    """

    triangles: np.ndarray
    weights: np.ndarray
    distances: np.ndarray


def nearest_places(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> Places:
    """Return the places of a triangulated surface nearest to points (m, 3).

    Only the triangles with the nearest centres are tried: right for triangles of about one size.
    """
    corners = vertices[faces]
    count = min(_NEAR, len(faces))
    _, near = cKDTree(corners.mean(1)).query(points, count)
    near = near.reshape(len(points), count)
    weights = _barycentric(corners[near], points[:, None])
    places = np.einsum("mcj,mcji->mci", weights, corners[near])
    distance = np.linalg.norm(places - points[:, None], axis=2)
    # of neighbours that share the place the same one whatever the rounding
    best = np.argmin(np.round(distance / (1e-9 * np.ptp(vertices, axis=0).max())), axis=1)
    rows = np.arange(len(points))
    return Places(near[rows, best], weights[rows, best], distance[rows, best])


def _barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the weights (..., 3) of the places on triangles (..., 3, 3) nearest to points (..., 3)."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    first, second = b - a, c - a
    g11, g12, g22 = (
        (u * v).sum(-1) for u, v in ((first, first), (first, second), (second, second))
    )
    r1, r2 = ((points - a) * first).sum(-1), ((points - a) * second).sum(-1)
    determinant = g11 * g22 - g12**2
    s, t = (g22 * r1 - g12 * r2) / determinant, (g11 * r2 - g12 * r1) / determinant
    inside = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    best = np.stack([1.0 - s - t, s, t], axis=-1)
    least = np.where(inside, 0.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, edge = corners[..., i, :], corners[..., j, :] - corners[..., i, :]
        along = np.clip(((points - start) * edge).sum(-1) / (edge * edge).sum(-1), 0.0, 1.0)
        square = ((start + along[..., None] * edge - points) ** 2).sum(-1)
        weights = np.zeros(best.shape)
        weights[..., i], weights[..., j] = 1.0 - along, along
        closer = ~inside & (square < least)
        best = np.where(closer[..., None], weights, best)
        least = np.where(closer, square, least)
    return best


def mirror_axes(vertices: np.ndarray, tetrahedra: np.ndarray) -> tuple[int, ...]:
    """Return the axes (1 for y, 0 for x) whose mirror leaves the body what it is.

    The surface has to lie on its mirror image up to half a percent of the length, in the mean, which
    is what a mesh's corners differ by; the centre of mass has to be on the plane.
    """
    faces, _ = boundary(tetrahedra)
    points = vertices[np.unique(faces)]
    length = np.ptp(vertices, axis=0).max()
    mass = lumped_mass(vertices, tetrahedra, 1.0)
    centre = mass @ vertices / volumes(vertices, tetrahedra).sum()
    axes = []
    for axis in AXES:
        there = nearest_places(vertices, faces, points * signs((axis,))[-1]).distances
        off = max(float(np.sqrt((there**2).mean())), float(abs(centre[axis])))
        if off < _TOLERANCE * length:
            axes.append(axis)
    return tuple(axes)


def signs(axes: tuple[int, ...]) -> np.ndarray:
    """Return the diagonals (2^n, 3) of all products of the mirrors at `axes`, the identity first."""
    rows = []
    for chosen in itertools.product((False, True), repeat=len(axes)):
        row = np.ones(3)
        row[[axis for axis, on in zip(axes, chosen, strict=True) if on]] = -1.0
        rows.append(row)
    return np.array(rows)
