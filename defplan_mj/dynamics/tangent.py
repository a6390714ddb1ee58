"""Tangent coordinates of the state: small changes without the quaternion's constraint, and rigid frames.

A change z (12 + 3r,) is, in this order: of the centre (3, world), a rotation vector in the body frame (3), of
q (r), of the velocity (3, world), of the angular velocity (3, body), of dq/dt (r), of the last target (r).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from defplan_mj.base import rotations

_COLUMNS = np.array([1, 2, 3, 0, 3, 2, 3, 0, 1, 2, 1, 0])  # entries of w x y z
_SIGNS = np.array([-1.0, -1, -1, 1, -1, 1, 1, 1, -1, -1, 1, 1])
_CROSS = np.array([[0.0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0],
                   [0, -1, 0, 1, 0, 0, 0, 0, 0]])  # fmt: skip


def size(nx: int) -> int:
    """Return the number of tangent coordinates of a state of `nx` numbers."""
    return nx - 1


def attitude_tangent(quaternion: np.ndarray) -> np.ndarray:
    """Return (..., 4, 3): columns q (0, e_i), orthonormal; with q itself they span all quaternions."""
    return (quaternion[..., _COLUMNS] * _SIGNS).reshape(*quaternion.shape[:-1], 4, 3)


def difference(x: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return (..., n_z) the change from `origin` to `x` (..., nx).

    Its rotation part is 2 sin(angle / 2) times the axis, in the frame of `origin`: smooth up to half a
    turn, and the rotation vector to second order.
    """
    spin, _ = _turn(x, origin)
    straight = x - origin
    return np.concatenate([straight[..., :3], spin, straight[..., 7:]], axis=-1)


def difference_jacobian(x: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return (..., 3, 3): d difference(x, origin) / d change of x, its rotation block; the rest is 1."""
    spin, cosine = _turn(x, origin)
    return cosine[..., None, None] * np.eye(3) + (0.5 * spin @ _CROSS).reshape(*spin.shape, 3)


def retract(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the state (nx,) after the change `z`; the inverse of `difference`, for |rotation| < 2."""
    half = 0.5 * z[3:6]
    cosine = np.sqrt(max(0.0, 1 - float(half @ half)))
    quaternion = attitude_tangent(x[3:7]) @ half + cosine * x[3:7]
    return np.concatenate([x[:3] + z[:3], quaternion / np.linalg.norm(quaternion), x[7:] + z[6:]])


def step_jacobian(
    x: np.ndarray, x_next: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a step's Jacobians (n_z, n_z), (n_z, r) in tangent coordinates of those of the states."""
    into, out = 0.5 * attitude_tangent(x[3:7]), 2 * attitude_tangent(x_next[3:7]).T
    columns = np.concatenate([a[:, :3], a[:, 3:7] @ into, a[:, 7:]], axis=1)
    return _rows(columns, out), _rows(b, out)


def _rows(matrix: np.ndarray, out: np.ndarray) -> np.ndarray:
    return np.concatenate([matrix[:3], out @ matrix[3:7], matrix[7:]])


def _turn(x: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return 2 sin(angle / 2) axis (..., 3) and cos(angle / 2), not negative, of the turn to x."""
    q = x[..., 3:7]
    vector = (attitude_tangent(origin[..., 3:7]) * q[..., :, None]).sum(-2)
    cosine = (origin[..., 3:7] * q).sum(-1)
    sign = np.where(cosine < 0, -1.0, 1.0)
    return 2 * sign[..., None] * vector, sign * cosine


@dataclass(frozen=True)
class Frame:
    """A place that a body's motion is told from: the dynamics is the same wherever it is put.

    Attributes:
        position: (3,) m.
        quaternion: (4,) w x y z; with gravity, about the vertical only.
    """

    position: np.ndarray
    quaternion: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, level: bool, depth: bool) -> Frame:
        """Return the frame of a state.

        Args:
            level: turned by the heading only; else as the body.
            depth: at the body's height; else at height 0.
        """
        if level:
            quaternion = rotations.level_attitude(rotations.quaternion_heading(x[3:7]))
        else:
            quaternion = x[3:7] / np.linalg.norm(x[3:7])
        return cls(np.array([x[0], x[1], x[2] if depth else 0.0]), quaternion)

    # made once: a feedback asks for them at each step
    @functools.cached_property
    def matrix(self) -> np.ndarray:
        """(3, 3) rotation: columns are the frame's axes in the world."""
        return rotations.matrix(self.quaternion)

    @functools.cached_property
    def _turned(self) -> np.ndarray:
        """(4, 4), orthogonal: what it makes of a quaternion told from this frame is that in the world."""
        return np.column_stack([self.quaternion, attitude_tangent(self.quaternion)])

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Return the state (nx,) as told from this frame."""
        y, matrix = x.copy(), self.matrix
        y[:3], y[3:7] = (x[:3] - self.position) @ matrix, x[3:7] @ self._turned
        y[3:7] /= math.sqrt(y[3:7] @ y[3:7])
        v = slice((len(x) - 13) // 3 + 7, (len(x) - 13) // 3 + 10)
        y[v] = x[v] @ matrix
        return y

    def outside(self, y: np.ndarray) -> np.ndarray:
        """Return the state (nx,) in the world of one told from this frame: undoes `inside`."""
        x, matrix = y.copy(), self.matrix
        x[:3], x[3:7] = self.position + matrix @ y[:3], self._turned @ y[3:7]
        x[3:7] /= math.sqrt(x[3:7] @ x[3:7])
        v = slice((len(x) - 13) // 3 + 7, (len(x) - 13) // 3 + 10)
        x[v] = matrix @ y[v]
        return x

    def then(self, other: Frame) -> Frame:
        """Return `other`, which is told from this frame, in the world."""
        return Frame(
            self.position + self.matrix @ other.position,
            rotations.product(self.quaternion, other.quaternion),
        )
