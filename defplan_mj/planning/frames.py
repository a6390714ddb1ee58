"""Frames and directions in the plane (d = 2) and in space (d = 3): attitudes, small turns, random draws.

A frame is a (d, d) matrix whose columns are its axes in the world: `frame @ v` takes a vector from the
frame into the world. In the plane it is the yaw frame, in space the body frame.
"""

from __future__ import annotations

import numpy as np

from defplan_mj.base import rotations

SPACING = 0.65
"""Smallest angle between Poisson-disk directions, as a share of that of a hexagonal packing."""
_DARTS = 30  # for each direction and smallest angle


def frames_of(matrices: np.ndarray, dimension: int) -> np.ndarray:
    """Return the frames (..., d, d) of bodies with rotation matrices (..., 3, 3).

    In the plane only the heading of the body's forward axis counts.
    """
    matrices = np.asarray(matrices, float)
    return matrices if dimension == 3 else turns(rotations.heading(matrices)[..., None])


def attitude_frames(orientations: np.ndarray, dimension: int) -> np.ndarray:
    """Return the frames (n, d, d) of attitudes (n, 4), unit quaternions w x y z."""
    return frames_of(rotations.matrix(orientations), dimension)


def angles(dimension: int) -> int:
    """Return how many numbers say a turn: 1 in the plane, 3 (a rotation vector) in space."""
    return dimension * (dimension - 1) // 2


def turns(vectors: np.ndarray) -> np.ndarray:
    """Return the rotations (..., d, d) by angles (..., 1) or rotation vectors (..., 3), rad."""
    if vectors.shape[-1] == 1:
        cosine, sine = np.cos(vectors[..., 0]), np.sin(vectors[..., 0])
        return np.stack([cosine, -sine, sine, cosine], axis=-1).reshape(*cosine.shape, 2, 2)
    angle2 = np.einsum("...i,...i->...", vectors, vectors)[..., None, None]
    angle = np.sqrt(angle2)
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    # Rodrigues; sinc is smooth at 0. Not SciPy's, as `base.rotations`: that rounds otherwise, and a training of
    # the same seed, whose noise is turned by this, would no longer give the same policy to the bit.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    identity = np.eye(3, dtype=vectors.dtype)
    out = identity + first * cross + second * (cross @ cross)
    return out.astype(vectors.dtype, copy=False)


def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (d, d) that takes the direction of `start` (d,) to that of `end`.

    Opposite directions, between which no rotation is the smallest, give the identity; so do zeros.
    """
    start, end = (v / max(float(np.linalg.norm(v)), 1e-12) for v in (start, end))
    bend = np.outer(end, start) - np.outer(start, end)
    return np.eye(len(start)) + bend + bend @ bend / max(1 + float(start @ end), 1e-9)


def renewed(frames: np.ndarray) -> np.ndarray:
    """Return nearly orthonormal frames (n, d, d) as their nearest orthonormal ones, to second order.

    One Newton step of the polar decomposition. Done at every turn, it keeps rounding from adding up.
    """
    gram = frames.swapaxes(-1, -2) @ frames
    identity = np.eye(frames.shape[-1], dtype=frames.dtype)
    return frames @ (frames.dtype.type(1.5) * identity - frames.dtype.type(0.5) * gram)


def random_directions(generator: np.random.Generator, n: int, dimension: int) -> np.ndarray:
    """Return n unit vectors (n, d), evenly distributed over the circle or the sphere."""
    if dimension == 2:
        bearing = generator.uniform(0, 2 * np.pi, n)
        return np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    vectors = generator.standard_normal((n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def random_attitudes(generator: np.random.Generator, n: int, dimension: int) -> np.ndarray:
    """Return n attitudes (n, 4): level with any heading in the plane, any rotation in space."""
    if dimension == 2:
        return rotations.level_attitude(generator.uniform(-np.pi, np.pi, n))
    quaternions = generator.standard_normal((n, 4))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def spread_directions(n: int, dimension: int, generator: np.random.Generator) -> np.ndarray:
    """Return n unit vectors (n, d) spread over the circle or the sphere.

    Around the circle they are even, beginning ahead. Over the sphere they are a Poisson-disk sample,
    as in the paper: darts are thrown at random and stay if they keep an angle from those before. It is
    `SPACING` times that of a hexagonal packing of n points, lowered by 5% whenever there is no room.
    """
    if dimension == 2:
        bearing = 2 * np.pi * np.arange(n) / n
        return np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    # In a hexagonal packing of the plane a point has the area sqrt(3)/2 spacing^2.
    spacing = SPACING * np.sqrt(8 * np.pi / (np.sqrt(3) * n))
    while True:
        kept = np.empty((0, 3))
        for dart in random_directions(generator, _DARTS * n, 3):
            if np.all(kept @ dart <= np.cos(min(spacing, np.pi))):
                kept = np.vstack([kept, dart])
                if len(kept) == n:
                    return kept
        spacing *= 0.95
