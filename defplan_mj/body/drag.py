"""Drag on points of a surface: where they are, how they ride on the body, and the force they take.

The force on a point with area vector a that moves at v is, as in the kernel (docs/kernel.md),

    f = -(rho C_d / 2) |v.a| (v.a) a / |a|^2 - (rho C_f / 2) |a| sqrt(|v|^2 + 1e-4) v.

With one point a triangle it is the whole surface's, which the few points of a body stand for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.body.mirror import nearest_places, signs
from defplan_mj.body.model import Medium
from defplan_mj.body.tetmesh import TetMesh, boundary, shape_gradients

_SPEED2 = 1e-4  # m^2/s^2, smooths the friction at rest: kernel/drag.h
_AT_ONCE = 16  # moments worked on together: what fits in the cache


@dataclass(frozen=True)
class DragPoints:
    """Points that take drag: see `Body.drag_points`, `drag_tangents` and `drag_areas`."""

    points: np.ndarray
    tangents: np.ndarray
    areas: np.ndarray

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.areas)

    def chosen(self, which: np.ndarray, weights: np.ndarray) -> DragPoints:
        """Return the points `which` (m,), their areas times `weights` (m,)."""
        return DragPoints(self.points[which], self.tangents[:, which], self.areas[which] * weights)


@dataclass(frozen=True)
class Moments:
    """What a body does at m moments, in its own frame.

    Attributes:
        zeta: (m, k+1) the shape: 1, then z.
        zeta_dot: (m, k+1) its change, 1/s; column 0 is zero.
        slopes: (m, k, r) dz/dq.
        velocity: (m, 3) of the centre of mass, m/s.
        spin: (m, 3) angular velocity, rad/s.
        attitude: (m, 3, 3) rotations from the body's frame to one that does not turn.
    """

    zeta: np.ndarray
    zeta_dot: np.ndarray
    slopes: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    attitude: np.ndarray

    def __len__(self) -> int:
        """Return how many moments there are."""
        return len(self.zeta)


class SurfaceFields:
    """The surface triangles of a body as drag points, and their mirror images.

    Args:
        mesh: the body at rest.
        shapes: (n, 3, k+1) rest positions | basis.
    """

    def __init__(self, mesh: TetMesh, shapes: np.ndarray) -> None:
        self.vertices, self.shapes = mesh.vertices, shapes
        self.faces, owner = boundary(mesh.tetrahedra)
        a, b, c = (mesh.vertices[self.faces[:, i]] for i in range(3))
        vector = 0.5 * np.cross(b - a, c - a)
        self.centres = (a + b + c) / 3.0
        self.areas = np.linalg.norm(vector, axis=1)
        self.normals = vector / self.areas[:, None]
        first = np.cross(self.normals, np.eye(3)[np.abs(self.normals).argmin(1)])
        first /= np.linalg.norm(first, axis=1)[:, None]
        self.tangents = np.stack([first, np.cross(self.normals, first)])
        gradients = shape_gradients(mesh.vertices, mesh.tetrahedra)[owner]
        self._gradients = np.einsum("eaj,eaik->eijk", gradients, shapes[mesh.tetrahedra[owner]])

    def triangles(self) -> DragPoints:
        """Return one point a triangle: the whole surface."""
        everywhere = np.arange(len(self.faces))
        points = self.shapes[self.faces].mean(1)
        return DragPoints(points, self._images(everywhere, self.tangents), self.areas)

    def alike(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return labels (f,) of triangles in at most `count` groups that are near and face one way."""
        length = np.ptp(self.centres, axis=0).max()
        place = np.hstack([self.centres, 0.2 * length * self.normals])
        return weighted_clusters(place, self.areas, count, rng)

    def clusters(self, labels: np.ndarray) -> DragPoints:
        """Return one point for each group of triangles, labels (f,)."""
        whole = self.triangles()
        total = np.bincount(labels, self.areas)
        share = np.zeros((len(total), len(labels)))
        share[labels, np.arange(len(labels))] = self.areas / total[labels]
        normal = share @ self.normals
        size = np.linalg.norm(normal, axis=1)
        normal /= size[:, None]
        first = np.cross(normal, np.eye(3)[np.abs(normal).argmin(1)])
        first /= np.linalg.norm(first, axis=1)[:, None]
        gradients = np.einsum("ce,eijk->cijk", share, self._gradients, optimize=True)
        tangents = np.einsum(
            "cijk,tcj->tcik", gradients, np.stack([first, np.cross(normal, first)])
        )
        return DragPoints(np.einsum("ce,eik->cik", share, whole.points), tangents, size * total)

    def mirrored(self, which: np.ndarray, axes: tuple[int, ...]) -> list[DragPoints]:
        """Return the points of triangles `which` (m,), and their images in the mirrors at `axes`.

        The first item is the triangles themselves. An image is the place of the surface nearest to the
        mirrored centre, with the mirrored normal and area: at rest the items are mirror images
        though the triangles are not.
        """
        whole = self.triangles()
        items = [whole.chosen(which, np.ones(len(which)))]
        for diagonal in signs(axes)[1:]:
            places = nearest_places(self.vertices, self.faces, self.centres[which] * diagonal)
            corners = self.shapes[self.faces[places.triangles]]
            points = np.einsum("mc,mcik->mik", places.weights, corners)
            pair = self.tangents[:, which] * diagonal
            if diagonal.prod() < 0.0:  # a reflection turns the cross product round
                pair = pair[::-1]
            images = self._images(places.triangles, pair)
            items.append(DragPoints(points, images, self.areas[which]))
        return items

    def _images(self, triangles: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Return the fields (2, m, 3, k+1) of rest tangents (2, m, 3), as their tetrahedra map them."""
        return np.einsum("eijk,tej->teik", self._gradients[triangles], pair)


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


def forces(points: DragPoints, medium: Medium, moments: Moments) -> np.ndarray:
    """Return the generalised force (m, p, 6 + r) of each point at each moment.

    Force (N) and torque about the centre of mass (N m) in the body's frame, then the work on each
    modal coordinate (J). In a medium of density 0 it is that at 1 kg/m^3.
    """
    density = medium.density or 1.0
    normal = 0.5 * density * medium.drag_normal
    skin = 0.5 * density * medium.drag_tangential
    p, k, r = len(points), points.points.shape[2] - 1, moments.slopes.shape[2]
    field = np.ascontiguousarray(points.points.transpose(1, 0, 2)).reshape(3 * p, k + 1)
    first, second = (
        np.ascontiguousarray(tangent.transpose(1, 0, 2)).reshape(3 * p, k + 1)
        for tangent in points.tangents
    )
    result = np.empty((len(moments), p, 6 + r))
    for start in range(0, len(moments), _AT_ONCE):
        now = slice(start, start + _AT_ONCE)
        shape, change = moments.zeta[now].T, moments.zeta_dot[now].T
        m = shape.shape[1]
        place = (field @ shape).reshape(3, p, m)
        speed = (field @ change).reshape(3, p, m)
        speed += moments.velocity[now].T[:, None] + _cross(moments.spin[now].T[:, None], place)
        area = _cross((first @ shape).reshape(3, p, m), (second @ shape).reshape(3, p, m))
        area *= points.areas[:, None]
        square, along = (area**2).sum(0), (speed * area).sum(0)
        force = -(normal * np.abs(along) * along / np.maximum(square, 1e-300)) * area
        force -= skin * np.sqrt(square) * np.sqrt((speed**2).sum(0) + _SPEED2) * speed
        slopes = moments.slopes[now].transpose(1, 2, 0).reshape(k, r * m)
        arms = (field[:, 1:] @ slopes).reshape(3, p, r, m)
        result[now, :, :3] = force.transpose(2, 1, 0)
        result[now, :, 3:6] = _cross(place, force).transpose(2, 1, 0)
        result[now, :, 6:] = (arms * force[:, :, None]).sum(0).transpose(2, 0, 1)
    return result


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products of vectors (3, ...)."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    return np.stack(np.broadcast_arrays(x, y, a[0] * b[1] - a[1] * b[0]))
