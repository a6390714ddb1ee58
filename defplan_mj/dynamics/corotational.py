"""Corotational linear elasticity around a given strain: energy, stress and exact second derivative.

psi(F) = mu |S - T|^2 + lambda/2 tr(S - T)^2 with F = R S the polar decomposition and T a given
symmetric matrix (the identity for plain corotational elasticity).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_LEAST_SPIN = 0.05  # keeps tr(S) I - S invertible where a tetrahedron is turned inside out


def polar(f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split F = R S: rotations R (t, 3, 3), det 1, and symmetric S (t, 3, 3)."""
    rotation, s, vt = _signed_svd(f)
    return rotation, np.einsum("eji,ej,ejk->eik", vt, s, vt)


def _signed_svd(f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return R, the signed singular values (t, 3) and the axes' transpose, S = vt^T s vt."""
    u, s, vt = np.linalg.svd(f)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= sign[:, None]
    s[:, 2] *= sign
    return u @ vt, s, vt


def axial(y: np.ndarray) -> np.ndarray:
    """Return the axial vector (..., 3) of Y - Y^T (..., 3, 3)."""
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.stack([y[..., i, j] - y[..., j, i] for i, j in pairs], axis=-1)


def cross_matrix(w: np.ndarray) -> np.ndarray:
    """Return the matrices [w] (..., 3, 3) with [w] v = w x v, of w (..., 3)."""
    matrix = np.zeros((*w.shape, 3))
    matrix[..., 2, 1], matrix[..., 1, 2] = w[..., 0], -w[..., 0]
    matrix[..., 0, 2], matrix[..., 2, 0] = w[..., 1], -w[..., 1]
    matrix[..., 1, 0], matrix[..., 0, 1] = w[..., 2], -w[..., 2]
    return matrix


def density(strain: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """Return mu |E|^2 + lambda/2 tr(E)^2 (t,) of E (t, 3, 3), J/m^3."""
    return mu * (strain**2).sum((1, 2)) + 0.5 * lam * np.trace(strain, axis1=1, axis2=2) ** 2


def _isotropic(e: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """Return 2 mu E + lambda tr(E) I, of E (..., 3, 3)."""
    trace = np.trace(e, axis1=-2, axis2=-1)[..., None, None]
    return 2.0 * mu * e + lam * trace * np.eye(3)


@dataclass(frozen=True)
class Response:
    """What a material answers to F.

    Attributes:
        energy: (t,) J/m^3.
        stress: (t, 3, 3) dpsi/dF, Pa.
        rotation: (t, 3, 3) R.
    """

    energy: np.ndarray
    stress: np.ndarray
    rotation: np.ndarray
    _s: np.ndarray
    _spin: np.ndarray
    _normal: np.ndarray
    _local: np.ndarray
    _torque: np.ndarray
    _lame: tuple[float, float]

    def tangent(self, definite: bool = False) -> np.ndarray:
        """Return R^T d(stress) (t, 9, 9) per R^T dF, both row-major.

        Args:
            definite: replace each by its positive semidefinite part.
        """
        mu, lam = self._lame
        y = np.eye(9).reshape(1, 9, 3, 3)
        s, spin = self._s[:, None], self._spin[:, None]
        turn = cross_matrix((spin @ axial(y)[..., None])[..., 0])
        ds = y - turn @ s
        dn = _isotropic(ds, mu, lam)
        moment = dn @ s + self._normal[:, None] @ ds
        trace = np.trace(ds, axis1=-2, axis2=-1)[..., None]
        torque = self._torque[:, None]
        change = axial(moment) - trace * torque + (ds @ torque[..., None])[..., 0]
        dtorque = (spin @ change[..., None])[..., 0]
        d = turn @ self._local[:, None] + dn - cross_matrix(dtorque)
        d = d.reshape(len(d), 9, 9)
        d = 0.5 * (d + d.transpose(0, 2, 1))
        if definite:
            values, axes = np.linalg.eigh(d)
            d = (axes * np.maximum(values, 0.0)[:, None, :]) @ axes.transpose(0, 2, 1)
        return d


def respond(f: np.ndarray, centre: np.ndarray, mu: float, lam: float) -> Response:
    """Evaluate the material.

    Args:
        f: (t, 3, 3) deformation gradients.
        centre: (t, 3, 3) the symmetric T.
        mu, lam: Lame parameters, Pa.
    """
    rotation, values, vt = _signed_svd(f)
    s = np.einsum("eji,ej,ejk->eik", vt, values, vt)
    normal = _isotropic(s - centre, mu, lam)
    # R turns with F by a = G^-1 axial(R^T dF), G = tr(S) I - S, and S - T notices if T has other axes
    turning = np.maximum(values.sum(1, keepdims=True) - values, _LEAST_SPIN)
    spin = np.einsum("eji,ej,ejk->eik", vt, 1.0 / turning, vt)
    torque = (spin @ axial(normal @ s)[..., None])[..., 0]
    local = normal - cross_matrix(torque)
    energy = density(s - centre, mu, lam)
    return Response(energy, rotation @ local, rotation, s, spin, normal, local, torque, (mu, lam))
