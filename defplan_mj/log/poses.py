"""Poses as position and unit quaternion (w x y z): what logs hold, and what comparisons need of it."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.surrogate import Surrogate


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the (..., 3, 3) rotation matrices of (..., 4) quaternions w x y z (normalised here)."""
    q = np.asarray(quaternion, float)
    w, x, y, z = (q / np.sqrt((q * q).sum(-1, keepdims=True))).T
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return matrix.T


def quaternion(matrix: np.ndarray) -> np.ndarray:
    """Return the (4,) unit quaternion w x y z, w >= 0, of a (3, 3) rotation matrix."""
    m = np.asarray(matrix, float)
    # the largest of the four squares is found first, so that nothing is divided by a small number
    squares = 1 + np.array([1, 1, -1, -1]) * m[0, 0] + np.array([1, -1, 1, -1]) * m[1, 1]
    squares += np.array([1, -1, -1, 1]) * m[2, 2]
    products = {
        0: (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]),
        1: (m[2, 1] - m[1, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]),
        2: (m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 2] + m[2, 1]),
        3: (m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]),
    }
    big = int(np.argmax(squares))
    q = np.insert(np.array(products[big]), big, squares[big])
    q /= np.linalg.norm(q)
    return q if q[0] >= 0 else -q


def yaw(matrix: np.ndarray) -> np.ndarray:
    """Return the heading (rad) of (..., 3, 3) rotations: the direction of the body's x axis."""
    return np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])


def angle(matrix: np.ndarray) -> np.ndarray:
    """Return the angle (rad, 0 to pi) of (..., 3, 3) rotations, exact for small and for half turns."""
    m = np.asarray(matrix)
    twist = np.stack([m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]], -1)
    twist = twist - np.stack([m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]], -1)
    sine, cosine = np.linalg.norm(twist, axis=-1), np.trace(m, axis1=-2, axis2=-1) - 1
    return np.arctan2(sine, cosine)


def predict(surrogate: Surrogate, pose: np.ndarray, gait_index: int) -> np.ndarray:
    """Return the (7,) pose after one cycle of a gait, by the rigid surrogate: (c + R t_j, R R_j)."""
    rotation = rotation_matrix(pose[3:7])
    centre = pose[:3] + rotation @ surrogate.translations[gait_index]
    return np.concatenate([centre, quaternion(rotation @ surrogate.rotations[gait_index])])
