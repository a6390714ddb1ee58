"""Corotational linear elasticity: polar decomposition, stress and exact second derivative, in bulk.

Arrays run over the tetrahedra along their last axis, (3, 3, t), so that numpy's loops are long. With
F = R S, a density psi(S) has the stress R (N - [w]), N = dpsi/dS, [w] the cross matrix of
w = G^-1 axial(N S), G = tr(S) I - S: R turns with F by G^-1 axial(R^T dF), and psi notices if N and S have
other axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_LEAST_SPIN = 0.05  # keeps G invertible where a tetrahedron is turned inside out or flat
_ROUNDS = 15  # of the polar iteration; what needs more is left to the singular values
_CHUNK = 1024  # tetrahedra at once: what fits in the cache
PAIRS = tuple((a, b) for a in range(4) for b in range(a + 1))
"""Corners (a, b) of the blocks of an element's second derivative, a >= b."""


@dataclass(frozen=True)
class Polar:
    """Polar decompositions F = R S.

    Attributes:
        rotation: (3, 3, t) R, det 1.
        stretch: (3, 3, t) S, symmetric.
        spin: (3, 3, t) G^-1, its eigenvalues at most 20.
    """

    rotation: np.ndarray
    stretch: np.ndarray
    spin: np.ndarray

    def strain_rate(self, change: np.ndarray) -> np.ndarray:
        """Return dS (3, 3, t) for dF = `change`."""
        turned = _transposed(self.rotation, change)
        spin = np.einsum("ijt,jt->it", self.spin, axial(turned))
        return turned - product(cross_matrix(spin), self.stretch)


def polar(f: np.ndarray) -> Polar:
    """Decompose F (3, 3, t); where det F < 0 one singular value is taken as negative."""
    rotation = f.copy()
    change = np.full(f.shape[-1], np.inf)
    with np.errstate(all="ignore"):  # flat tetrahedra are done below
        for _ in range(_ROUNDS):  # Newton's method for R^T R = 1 (Higham 1986)
            cofactor = _cofactor(rotation)
            det = (rotation[0] * cofactor[0]).sum(0)
            new = 0.5 * (rotation + cofactor / det)
            change = np.abs(new - rotation).max((0, 1))
            rotation = new
            if not np.nanmax(change) > 1e-9:  # squared by the next round
                break
        stretch = _transposed(rotation, f)
        stretch = 0.5 * (stretch + stretch.transpose(1, 0, 2))
        trace = np.trace(stretch)
        g = trace * np.eye(3)[:, :, None] - stretch
        cofactor = _cofactor(g)
        spin = cofactor / (g[0] * cofactor[0]).sum(0)
        least = g - _LEAST_SPIN * np.eye(3)[:, :, None]
        minor = _cofactor(least)
        fine = (change <= 1e-9) & (det > 0.0) & (least[0, 0] > 0.0) & (minor[2, 2] > 0.0)
        fine &= (least[0] * minor[0]).sum(0) > 0.0  # Sylvester: all eigenvalues of G are above it
        fine &= (f[0] * _cofactor(f)[0]).sum(0) > 0.0
    if not fine.all():
        bad = np.flatnonzero(~fine)
        rotation[:, :, bad], stretch[:, :, bad], spin[:, :, bad] = _by_singular_values(f[:, :, bad])
    return Polar(rotation, stretch, spin)


def _by_singular_values(f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    u, s, vt = np.linalg.svd(f.transpose(2, 0, 1))
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= sign[:, None]
    s[:, 2] *= sign
    turning = np.maximum(s.sum(1, keepdims=True) - s, _LEAST_SPIN)
    parts = u @ vt, (vt.transpose(0, 2, 1) * s[:, None]) @ vt
    spin = (vt.transpose(0, 2, 1) / turning[:, None]) @ vt
    rotation, stretch, spin = (p.transpose(1, 2, 0) for p in (*parts, spin))
    return rotation, stretch, spin


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products (3, 3, t) of matrices (3, 3, t)."""
    return np.einsum("ijt,jkt->ikt", a, b)


def _transposed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return A^T B."""
    return np.einsum("jit,jkt->ikt", a, b)


def _around(r: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return R A R^T."""
    return np.einsum("ijt,kjt->ikt", product(r, a), r)


def _cofactor(a: np.ndarray) -> np.ndarray:
    return np.stack([_cross(a[1], a[2]), _cross(a[2], a[0]), _cross(a[0], a[1])])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products of vectors (3, ..., t)."""
    parts = ((1, 2), (2, 0), (0, 1))
    return np.stack([a[i] * b[j] - a[j] * b[i] for i, j in parts])


def axial(y: np.ndarray) -> np.ndarray:
    """Return the axial vector (3, t) of Y - Y^T (3, 3, t)."""
    return np.stack([y[2, 1] - y[1, 2], y[0, 2] - y[2, 0], y[1, 0] - y[0, 1]])


def cross_matrix(w: np.ndarray) -> np.ndarray:
    """Return the matrices [w] (3, 3, t) with [w] v = w x v, of w (3, t)."""
    matrix = np.zeros((3, *w.shape))
    matrix[2, 1], matrix[1, 2] = w[0], -w[0]
    matrix[0, 2], matrix[2, 0] = w[1], -w[1]
    matrix[1, 0], matrix[0, 1] = w[2], -w[2]
    return matrix


def density(strain: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """Return mu |E|^2 + lambda/2 tr(E)^2 (t,) of E (3, 3, t), J/m^3."""
    return mu * (strain**2).sum((0, 1)) + 0.5 * lam * np.trace(strain) ** 2


def isotropic(strain: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """Return 2 mu E + lambda tr(E) I of E (3, 3, t), Pa."""
    return 2.0 * mu * strain + lam * np.trace(strain) * np.eye(3)[:, :, None]


def _torque(parts: Polar, normal: np.ndarray) -> np.ndarray:
    return np.einsum("ijt,jt->it", parts.spin, axial(product(normal, parts.stretch)))


def stress(parts: Polar, normal: np.ndarray) -> np.ndarray:
    """Return dpsi/dF (3, 3, t) from N = dpsi/dS (3, 3, t)."""
    return product(parts.rotation, normal - cross_matrix(_torque(parts, normal)))


def second_derivative(
    parts: Polar,
    normal: np.ndarray,
    gradients: np.ndarray,
    mu: np.ndarray,
    lam: np.ndarray,
    definite: bool = False,
) -> np.ndarray:
    """Return the blocks (3, 3, 10, t) of each element's second derivative by its corners, `PAIRS`, N/m.

    With g_a the gradient of corner a turned into the world, all else turned, too, and y the moves,
    R turns by A sum_a g_a x y_a, A = G^-1, and

        H_ab = 2 mu g_a.g_b I + lambda g_a g_b^T + K_ab + K_ba^T,
        K_ab = -[g_a] (A [c_b] + A Q A [g_b]) / 2,   c_a = 2 g_a x w + (2 N - 4 mu S) g_a,
        Q = sym(N S) - (N:S) I - sym([w] S) + 2 mu (tr(S^2) I - S^2).

    Args:
        normal: (3, 3, t) N times the volume, J.
        gradients: (4, 3, t) of the shape functions, 1/m.
        mu, lam: (t,) Lame parameters times the volume, J.
        definite: leave out what the stress contributes: positive semidefinite.
    """
    tets = normal.shape[-1]
    out = np.empty((3, 3, len(PAIRS), tets))
    for start in range(0, tets, _CHUNK):
        c = slice(start, start + _CHUNK)
        part = Polar(parts.rotation[..., c], parts.stretch[..., c], parts.spin[..., c])
        _chunk(out[..., c], part, normal[..., c], gradients[..., c], mu[c], lam[c], definite)
    return out


def _chunk(
    out: np.ndarray,
    parts: Polar,
    normal: np.ndarray,
    gradients: np.ndarray,
    mu: np.ndarray,
    lam: np.ndarray,
    definite: bool,
) -> None:
    one = np.eye(3)[:, :, None]
    s = _around(parts.rotation, parts.stretch)
    spin = _around(parts.rotation, parts.spin)
    square = product(s, s)
    q = 2.0 * mu * (np.trace(square) * one - square)
    couple = -4.0 * mu * s
    g = np.einsum("ijt,ajt->iat", parts.rotation, gradients[1:])
    turned = np.zeros_like(g)
    if not definite:
        torque = np.einsum("ijt,jt->it", parts.rotation, _torque(parts, normal))
        n = _around(parts.rotation, normal)
        both = product(n - cross_matrix(torque), s)
        q += 0.5 * (both + both.transpose(1, 0, 2)) - (n * s).sum((0, 1)) * one
        couple = couple + 2.0 * n
        turned = 2.0 * _cross(g, np.broadcast_to(torque[:, None], g.shape))
    c = turned + np.einsum("ijt,jat->iat", couple, g)
    inner = product(product(spin, q), spin)
    # rows k of A [c_b] are A_k x c_b
    half = 0.5 * (
        _cross(spin.transpose(1, 0, 2)[:, :, None], c[:, None])
        + _cross(inner.transpose(1, 0, 2)[:, :, None], g[:, None])
    )  # (column, row k, b, t)
    k = np.empty((3, 3, 3, 3, g.shape[-1]))  # row, column, a, b
    for i, j, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        # row i of -[g_a] U is g_m U_j - g_j U_m
        k[i] = g[m][:, None] * half[:, j, None] - g[j][:, None] * half[:, m, None]
    dots = np.einsum(
        "iat,ibt->abt", gradients[1:].transpose(1, 0, 2), gradients[1:].transpose(1, 0, 2)
    )
    dots *= 2.0 * mu
    block = k + k.transpose(1, 0, 3, 2, 4)
    block += (lam * g)[:, None, :, None] * g[None, :, None, :]
    for i in range(3):
        block[i, i] += dots
    for place, (a, b) in enumerate(PAIRS):
        if b:
            out[:, :, place] = block[:, :, a - 1, b - 1]
        elif a:  # the four corners' forces have no sum
            np.sum(block[:, :, a - 1], axis=2, out=out[:, :, place])
            out[:, :, place] *= -1.0
        else:
            np.sum(block, axis=(2, 3), out=out[:, :, place])
