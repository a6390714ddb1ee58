"""Rotations by SciPy, of unit quaternions in MuJoCo's order w x y z; the one place that knows the order.

A rotation of a body takes vectors of the body frame into the world.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def rotation(quaternion: np.ndarray) -> Rotation:
    """Return SciPy's rotations of quaternions (4,) or (n, 4), w x y z, of any length but 0."""
    return Rotation.from_quat(quaternion, scalar_first=True)


def of_matrix(matrix: np.ndarray) -> Rotation:
    """Return SciPy's rotations of matrices (3, 3) or (n, 3, 3)."""
    return Rotation.from_matrix(matrix)


def upright(yaw: np.ndarray) -> Rotation:
    """Return SciPy's rotations about the vertical by headings (n,), rad."""
    return Rotation.from_euler("z", np.asarray(yaw)[:, None])


def wxyz(turned: Rotation, positive: bool = False) -> np.ndarray:
    """Return the unit quaternions (4,) or (n, 4) of SciPy's rotations.

    Args:
        positive: take w >= 0; else the sign that SciPy has carried along.
    """
    return turned.as_quat(canonical=positive, scalar_first=True)


def matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4), of any length but 0."""
    q = np.asarray(quaternion, float)
    if not q.size:
        return np.zeros((*q.shape[:-1], 3, 3))
    return rotation(q.reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3)


def quaternion(matrix: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (4,), w >= 0, of a rotation matrix (3, 3)."""
    return wxyz(of_matrix(matrix), positive=True)


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (4,) of the turn q followed by p; its sign is the product's."""
    return wxyz(rotation(p) * rotation(q))


def heading(matrix: np.ndarray) -> np.ndarray:
    """Return the heading (...,), rad, of rotation matrices (..., d, d): where the x axis points."""
    return np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])


def quaternion_heading(quaternion: np.ndarray) -> np.ndarray:
    """Return the heading (...,), rad, of unit quaternions (..., 4), without their matrices."""
    w, a, b, c = np.moveaxis(np.asarray(quaternion), -1, 0)
    return np.arctan2(2 * (a * b + w * c), 1 - 2 * (b * b + c * c))


def level_attitude(yaw: float | np.ndarray) -> np.ndarray:
    """Return the unit quaternions (..., 4) of upright bodies with headings `yaw` (...,), rad."""
    half, zero = np.asarray(yaw, float) / 2, np.zeros(np.shape(yaw))
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def level_matrix(yaw: float | np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) about the vertical by headings `yaw` (...,), rad."""
    out = np.zeros((*np.shape(yaw), 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(yaw)
    out[..., 1, 0] = np.sin(yaw)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = 1.0
    return out


def angle(matrix: np.ndarray) -> np.ndarray:
    """Return the angles (n,), rad, 0 to pi, of rotation matrices (n, 2, 2) or (n, 3, 3)."""
    if matrix.shape[-1] == 2:
        return np.abs(heading(matrix))
    return of_matrix(matrix).magnitude()


def kabsch(covariance: np.ndarray) -> np.ndarray:
    """Return the rotations (..., 3, 3) that fit best, from covariances (..., 3, 3) sum m y' y^T.

    R y comes closest to y' in the mean square weighted with m (Kabsch 1976).
    """
    u, _, vt = np.linalg.svd(covariance)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt
