"""How good a body's reduction is: against the exact shapes, and the full FEM."""

from __future__ import annotations

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.model import Body
from defplan_mj.body.reduction import exact_shapes_of, reach, sample_shapes, shapes_of
from defplan_mj.body.rotation_strain import shape_coordinates
from defplan_mj.body.tetmesh import volumes

_TIMESTEP, _DURATION = 0.02, 0.2  # of the released shape, s
_SUBSTEPS = 4  # twice as many change the figures by 3% of themselves


def reduced_vertices(body: Body, q: np.ndarray) -> np.ndarray:
    """Return the vertices (m, n, 3) of the shapes q (m, r) in the rest frame, m."""
    q = np.atleast_2d(q)
    z = shape_coordinates(body, q)
    return body.vertices + np.einsum("nik,mk->mni", body.basis, z, optimize=True)


def placed_vertices(body: Body, state: np.ndarray) -> np.ndarray:
    """Return the vertices (n, 3) in the world of a reduced state (kernel.h), m."""
    turned = rotations.matrix(state[3:7])
    return state[:3] + reduced_vertices(body, state[7 : 7 + body.n_modes])[0] @ turned.T


def reconstruction_error(body: Body, samples: int = 200, seed: int = 0) -> dict[str, float]:
    """Compare the second reduction with the exact map over the amplitudes that are used.

    Returns:
        relative_rms: mass-weighted rms error over rms displacement.
        basis_relative_rms: the same with the best coordinates in the basis.
        worst_vertex_m: largest distance of a vertex, m.
        rms_displacement_m: of the shapes, m.
        volume_ratio_min, volume_ratio_max: exact shape's volume over the rest volume.
    """
    exact = exact_shapes_of(body)
    most = reach(body.amplitude, body.material, shapes_of(body))
    q = sample_shapes(samples, most, np.random.default_rng(seed))
    true = exact.displacement(q)
    mass = body.vertex_mass[:, None]
    best = np.einsum("n,nik,mni->mk", body.vertex_mass, body.basis, true, optimize=True)
    projected = np.einsum("nik,mk->mni", body.basis, best, optimize=True)
    error = reduced_vertices(body, q) - body.vertices - true
    square = (true**2 * mass).sum()
    rest = volumes(body.vertices, body.tetrahedra).sum()
    ratio = [volumes(body.vertices + u, body.tetrahedra).sum() / rest for u in true]
    return {
        "relative_rms": float(np.sqrt((error**2 * mass).sum() / square)),
        "basis_relative_rms": float(np.sqrt(((projected - true) ** 2 * mass).sum() / square)),
        "worst_vertex_m": float(np.linalg.norm(error, axis=2).max()),
        "rms_displacement_m": float(np.sqrt(square / (samples * body.mass))),
        "volume_ratio_min": float(min(ratio)),
        "volume_ratio_max": float(max(ratio)),
    }


def released_shape_error(
    body: Body,
    shape: np.ndarray | None = None,
    timestep: float = _TIMESTEP,
    duration: float = _DURATION,
    progress: Progress = no_progress,
) -> dict[str, float]:
    """Let a bent body go, in the reduced dynamics and in the full FEM, and compare.

    The body starts at rest in `shape` (r,) (q_1 = 1 if not given), is pulled to its rest shape as
    under a zero target, and swims a little; all forces act.

    Returns:
        relative: mean over time of the rms distance over that of the rms displacement from rest.
        worst_vertex_m: largest distance of a vertex at any time, m.
    """
    # imported here: the dynamics are built on the body
    from defplan_mj.dynamics.full_fem import FullFem
    from defplan_mj.dynamics.reduced import ReducedDynamics

    if shape is None:
        shape = np.eye(body.n_modes)[0]
    steps = round(duration / timestep)
    # both by the same steps: what is left is the reduction's error
    reduced = ReducedDynamics(body, timestep, substeps=_SUBSTEPS)
    full = FullFem(body, timestep, substeps=_SUBSTEPS)
    state = reduced.rest_state()
    state[7 : 7 + body.n_modes] = shape
    target = np.zeros(body.n_modes)
    truth = full.at(shape, target=target)
    share = body.vertex_mass / body.mass
    errors, sizes, worst = [], [], 0.0
    for i in range(steps + 1):
        distance = placed_vertices(body, state) - truth.now
        errors.append(np.sqrt(share @ (distance**2).sum(1)))
        sizes.append(np.sqrt(share @ ((truth.now - body.vertices) ** 2).sum(1)))
        worst = max(worst, float(np.linalg.norm(distance, axis=1).max()))
        if i < steps:
            progress(f"full FEM, step {i + 1} of {steps}", i / steps)
            truth = full.step(truth, target)
            state = reduced.step(state, target)
    return {"relative": float(np.mean(errors) / np.mean(sizes)), "worst_vertex_m": worst}


def check_body(
    body: Body, progress: Progress = no_progress, samples: int = 200, seed: int = 0
) -> dict[str, dict[str, float]]:
    """Return the errors of a body: see `reconstruction_error` and `released_shape_error`."""
    progress("reconstructing shapes", 0.0)
    reconstruction = reconstruction_error(body, samples, seed)
    released = released_shape_error(body, progress=progress)
    progress("checked", 1.0)
    return {"reconstruction": reconstruction, "full_fem": released}
