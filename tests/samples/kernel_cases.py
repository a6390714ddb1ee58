"""Bodies and states for the kernel's tests: synthetic bodies of any size, states of any attitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from defplan_mj.body.model import Body, Material, Medium
from defplan_mj.dynamics.reduced import ReducedDynamics

VACUUM = Medium(name="vacuum", density=0.0, righting_height=0.0)
EVERY_FORCE = Medium(drag_tangential=0.3, gravity=-1.3, righting_height=0.05)


def in_medium(body: Body, medium: Medium, material: Material | None = None) -> Body:
    """Return the same body elsewhere."""
    return replace(body, medium=medium, material=material or body.material)


def central_differences(
    function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, eps: float
) -> np.ndarray:
    """Return the Jacobian (..., n) of a function of (n,) numbers."""
    return np.stack(
        [(function(at + eps * e) - function(at - eps * e)) / (2 * eps) for e in np.eye(len(at))], -1
    )


def synthetic_body(
    rng: np.random.Generator, modes: int, basis: int, samples: int, patches: int, medium: Medium
) -> Body:
    """Return a body of 4 basis vertices whose numbers are random but consistent (mass, moments)."""
    n = 4 * basis
    mass = rng.uniform(0.1, 0.3, n)
    points = rng.normal(size=(n, 3)) * [0.5, 0.2, 0.3]
    points -= mass @ points / mass.sum()
    # mass-orthonormal and without motion of the centre of mass
    raw = rng.normal(size=(n, 3, basis))
    raw -= np.einsum("v,vik->ik", mass, raw) / mass.sum()
    weighted = np.sqrt(mass)[:, None, None] * raw
    orthonormal = np.linalg.qr(weighted.reshape(3 * n, basis))[0].reshape(n, 3, basis)
    shapes = np.concatenate(
        [points[:, :, None], orthonormal / np.sqrt(mass)[:, None, None]], axis=2
    )
    tangents = rng.normal(size=(2, patches, 3, basis + 1)) * 0.2
    tangents[0, :, 0, 0], tangents[1, :, 1, 0] = 1.0, 1.0
    nothing = np.zeros((0, 3), int)
    return Body(
        name="synthetic",
        material=Material(),
        medium=medium,
        vertices=points,
        tetrahedra=np.zeros((0, 4), int),
        faces=nothing,
        vertex_mass=mass,
        modes=np.zeros((n, 3, modes)),
        frequencies=np.ones(modes),
        stiffness=rng.uniform(20.0, 60.0, modes),
        amplitude=np.full(modes, 1.5),
        basis=shapes[:, :, 1:],
        sampled=np.arange(samples),
        feature_map=rng.normal(size=(samples, 9, modes)) * 0.5,
        feature_weights=rng.normal(size=(basis, 9 * samples)) * 0.1 / np.sqrt(samples),
        moments=np.einsum("v,via,vjb->abij", mass, shapes, shapes, optimize=True),
        drag_points=rng.normal(size=(patches, 3, basis + 1)) * 0.2,
        drag_tangents=tangents,
        drag_areas=rng.uniform(0.005, 0.02, patches),
        surface=np.arange(0, n, 2),
    )


def block(half: tuple[float, float, float], medium: Medium, mass: float = 10.0) -> Body:
    """Return a rigid block with eight equal masses at its corners: a body whose shape does nothing."""
    body = synthetic_body(np.random.default_rng(0), 1, 2, 1, 0, medium)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    weights = np.full(8, mass / 8)
    basis = body.basis - body.basis.mean(0)
    basis = np.linalg.qr(basis.reshape(24, 2))[0].reshape(8, 3, 2) / np.sqrt(mass / 8)
    shapes = np.concatenate([corners[:, :, None], basis], axis=2)
    return replace(
        body,
        vertices=corners,
        vertex_mass=weights,
        basis=basis,
        feature_weights=np.zeros_like(body.feature_weights),
        moments=np.einsum("v,via,vjb->abij", weights, shapes, shapes),
        surface=np.arange(8),
    )


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    """Return a unit quaternion, uniform over all attitudes."""
    quat = rng.normal(size=4)
    return quat / np.linalg.norm(quat)


def random_state(
    dynamics: ReducedDynamics,
    rng: np.random.Generator,
    spin: float = 1.0,
    speed: float = 1.0,
    vibration: float = 3.0,
) -> np.ndarray:
    """Return a state at any place and attitude; `spin` rad/s, `speed` m/s, `vibration` 1/s.

    Its last target shape is near its shape, as after a motion.
    """
    r, amplitude = dynamics.body.n_modes, dynamics.body.amplitude
    shape = rng.uniform(-amplitude, amplitude)
    return np.concatenate(
        [
            *(3 * rng.normal(size=3), random_quaternion(rng), shape),
            *(
                speed * rng.normal(size=3),
                spin * rng.normal(size=3),
                vibration * rng.normal(size=r),
            ),
            shape + 0.2 * rng.normal(size=r),
        ]
    )


def matrix(quat: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion w x y z."""
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the quaternion product a b."""
    w = a[0] * b[0] - a[1:] @ b[1:]
    return np.concatenate([[w], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


_MIRROR = np.array([1.0, -1.0, 1.0])  # y -> -y
_AXIAL = -_MIRROR  # of rotation vectors


def mirrored_body(body: Body) -> Body:
    """Return the mirror image of a body; the same q is its mirrored shape."""
    # skew vectors are axial; strain 11, 12, 13, 22, 23, 33; F - I row-major
    features = np.concatenate([_AXIAL, [1.0, -1.0, 1.0, 1.0, -1.0, 1.0]])
    gradients = np.tile(np.outer(_MIRROR, _MIRROR).ravel(), len(body.feature_map))
    flip = _MIRROR[:, None]
    return replace(
        body,
        vertices=body.vertices * _MIRROR,
        modes=body.modes * flip,
        basis=body.basis * flip,
        feature_map=body.feature_map * features[:, None],
        feature_weights=body.feature_weights * gradients,
        moments=body.moments * np.outer(_MIRROR, _MIRROR),
        drag_points=body.drag_points * flip,
        drag_tangents=body.drag_tangents[::-1] * flip,  # in the other order: the area is axial
    )


def mirrored_state(x: np.ndarray, r: int) -> np.ndarray:
    """Return the mirror image of a state."""
    out = x.copy()
    out[:3] *= _MIRROR
    out[4:7] *= _AXIAL
    out[7 + r : 10 + r] *= _MIRROR
    out[10 + r : 13 + r] *= _AXIAL
    return out
