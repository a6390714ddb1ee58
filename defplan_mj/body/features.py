"""Features of a shape that are fitted, not those of tetrahedra, so that z(q) = C vec(F(q) - I) follows any shapes.

F_s = exp([w_s]) (I + e_s) with w_s, e_s linear in q. Those of a body's own tetrahedra span the shapes that are
reconstructed from them well; shapes of least elastic energy they do not. So the linear maps themselves are moved,
from some tetrahedra's, to where the least-squares weights C leave least (variable projection, Golub and
Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.optimize as so

from defplan_mj.body.corotational import axial, cross_matrix
from defplan_mj.body.rotation_strain import exponential, strain_matrices

_RIDGE = 1e-7
_FLOOR = 0.02  # of the mean square, added to a shape's own: what its error is weighted with
_ONCE = np.array([0.5, 1.0, 1.0, 0.5, 1.0, 0.5])  # a component off the diagonal stands twice


def fit_weights(features: np.ndarray, targets: np.ndarray, ridge: float = 1e-9) -> np.ndarray:
    """Return C (k, f) with targets (m, k) ~ features (m, f) C^T, by ridge least squares."""
    gram = features.T @ features
    gram += ridge * np.trace(gram) / len(gram) * np.eye(len(gram))
    return np.linalg.solve(gram, features.T @ targets).T


def fitted_features(
    features: np.ndarray, q: np.ndarray, z: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return feature maps (s, 9, r) and weights C (k, 9 s) that give the coordinates of shapes best.

    Args:
        features: (s, 9, r) to begin with.
        q: (m, r) shapes.
        z: (m, k) their coordinates.
        rounds: at most, of a quasi-Newton method.
    """
    square = (z**2).sum(1)
    row = 1.0 / np.sqrt(square + _FLOOR * square.mean())[:, None]
    target = z * row
    size = (target**2).sum()

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        maps = flat.reshape(features.shape)
        values, pull = _evaluated(maps, q)
        weights = fit_weights(values * row, target, _RIDGE)
        off = values * row @ weights.T - target
        # the weights are the best for these maps, so that only the maps' own change counts
        return (off**2).sum() / size, pull(2.0 * row * (off @ weights) / size).ravel()

    solution = so.minimize(
        loss, features.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": rounds}
    )
    maps = solution.x.reshape(features.shape)
    return maps, fit_weights(_evaluated(maps, q)[0] * row, target, _RIDGE)


def _evaluated(
    maps: np.ndarray, q: np.ndarray
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return vec(F - I) (m, 9 s), and the function that takes its gradient to that of the maps (s, 9, r)."""
    values = np.einsum("sfr,mr->msf", maps, q, optimize=True)
    w, stretch = values[..., :3], np.eye(3) + strain_matrices(values[..., 3:])
    turn = exponential(w)
    f = turn @ stretch

    def pull(gradient: np.ndarray) -> np.ndarray:
        g = gradient.reshape(f.shape)
        # dF = [J dw] F + R de
        spin = g @ f.swapaxes(-1, -2)
        torque = np.moveaxis(axial(np.moveaxis(spin, (-2, -1), (0, 1))), 0, -1)
        by_w = np.einsum("msji,msj->msi", _left_jacobian(w), torque)
        by_strain = turn.swapaxes(-1, -2) @ g
        by_strain = by_strain + by_strain.swapaxes(-1, -2)
        packed = by_strain[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] * _ONCE
        return np.einsum("msf,mr->sfr", np.concatenate([by_w, packed], axis=-1), q, optimize=True)

    return (f - np.eye(3)).reshape(len(q), -1), pull


def _left_jacobian(w: np.ndarray) -> np.ndarray:
    """Return J (..., 3, 3) with d exp([w]) = [J dw] exp([w]) of rotation vectors w (..., 3)."""
    square = (w * w).sum(-1)
    small = square < 1e-6
    safe = np.where(small, 1.0, square)
    angle = np.sqrt(safe)
    a = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(angle)) / safe)[..., None, None]
    b = np.where(small, 1.0 / 6.0 - square / 120.0, (angle - np.sin(angle)) / (safe * angle))
    leading = cross_matrix(np.moveaxis(w, -1, 0))
    cross = np.ascontiguousarray(np.moveaxis(leading, (0, 1), (-2, -1)))
    return np.eye(3) + a * cross + b[..., None, None] * (cross @ cross)
