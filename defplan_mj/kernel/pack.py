"""Lay a Body out as the flat array of doubles that the C kernel reads (parts.h: body_view)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import LIMITS, Body
from defplan_mj.body.validate import validate_body
from defplan_mj.kernel.contact_points import contact_points

MAGIC, VERSION, HEADER, PAD = 20181018.0, 2.0, 16, 8


def _pad(array: np.ndarray, axis: int) -> np.ndarray:
    """Fill `axis` with zeros up to a multiple of 8."""
    missing = -array.shape[axis] % PAD
    widths = [(0, missing if i == axis else 0) for i in range(array.ndim)]
    return np.pad(np.asarray(array, float), widths)


def pack_field(points: np.ndarray) -> np.ndarray:
    """Return points (p, 3, k+1) as the kernel has them: (kp, 3, np), basis, coordinate, point."""
    return _pad(_pad(points.transpose(2, 1, 0), 2), 0)


def pack_body(body: Body) -> np.ndarray:
    """Return the kernel's blob of `body`, an array of doubles.

    Raises:
        DefplanError: the body is larger than the kernel's fixed work memory.
    """
    validate_body(body, f"the body {body.name}", whole=False)
    n_samples, _, r = body.feature_map.shape
    sizes = {
        "modes": r,
        "basis": body.n_basis,
        "samples": n_samples,
        "drag points": len(body.drag_areas),
    }
    for name, size in sizes.items():
        if size > LIMITS[name]:
            raise DefplanError(
                f"the body has {size} {name}, the kernel takes at most {LIMITS[name]}"
            )
    # samples innermost: the kernel works on eight at a time
    by_sample = np.zeros((body.n_basis + 1, 9, n_samples))
    by_sample[1:] = body.feature_weights.reshape(-1, n_samples, 9).transpose(0, 2, 1)
    padded = _pad(_pad(by_sample, 2), 0)
    weights = padded.reshape(len(padded), -1)
    trace = np.einsum("aii->a", body.moments[0])
    # zeta^T tr(S) zeta with an orthonormal basis: S_00 + 2 sum_a S_0a z_a + |z|^2; entry 0 completes z_0 = 1.
    orthonormality = np.abs(
        np.einsum("abii->ab", body.moments)[1:, 1:] - np.eye(body.n_basis)
    ).max()
    if orthonormality > 1e-9:
        raise DefplanError(
            f"the displacement basis is not mass-orthonormal (error {orthonormality:.1e})"
        )
    trace[0] = 0.5 * (trace[0] - 1.0)
    surface = np.concatenate(
        [body.vertices[body.surface][:, :, None], body.basis[body.surface]], axis=2
    )
    contacts = contact_points(body)
    sections = [
        _pad(body.stiffness, 0),
        _pad(body.feature_map.transpose(1, 2, 0), 2),
        weights.T,
        weights,
        _pad(_pad(body.moments.transpose(1, 2, 3, 0), 3), 0),  # (b, i, j, a)
        _pad(trace, 0),
        pack_field(body.drag_points),
        pack_field(body.drag_tangents[0]),
        pack_field(body.drag_tangents[1]),
        _pad(body.drag_areas, 0),
        pack_field(surface),
        pack_field(surface[contacts]),
    ]
    header = np.zeros(HEADER)
    radius = np.linalg.norm(body.vertices, axis=1).max()
    header[:11] = (
        MAGIC,
        VERSION,
        HEADER + sum(s.size for s in sections),
        r,
        body.n_basis,
        n_samples,
        len(body.drag_areas),
        len(body.surface),
        body.mass,
        radius,
        len(contacts),
    )
    return np.concatenate([header, *(np.ascontiguousarray(s).ravel() for s in sections)])


INTEGRATORS = {"variational": 0.0, "implicit-euler": 1.0}  # kernel.h: DP_INTEGRATOR
MAX_SUBSTEPS = 64


@dataclass(frozen=True)
class StepOptions:
    """How the kernel takes a control step.

    Attributes:
        timestep: of a control step, s.
        tolerance: bounds the last Newton step that is still followed by no other (m, rad, units of
            q); convergence is quadratic, so the state is then exact to about its square.
        max_newton: iterations of a solve, at most.
        substeps: of the integrator in a control step.
        integrator: one of INTEGRATORS.
    """

    timestep: float
    tolerance: float = 1e-7
    max_newton: int = 60
    substeps: int = 2
    integrator: str = "variational"

    def check(self) -> None:
        """Raise a DefplanError if there is no such integrator, or one of the numbers makes no sense."""
        if self.integrator not in INTEGRATORS:
            known = " or ".join(INTEGRATORS)
            raise DefplanError(f"there is no integrator {self.integrator!r}: take {known}")
        if not 1 <= self.substeps <= MAX_SUBSTEPS or self.substeps != int(self.substeps):
            raise DefplanError(
                f"substeps is {self.substeps}: it must be a whole number between 1 and {MAX_SUBSTEPS}"
            )
        if not 0.0 < self.timestep < 1e6:
            raise DefplanError(f"the time step is {self.timestep} s: it must be positive")
        if not 0.0 < self.tolerance < np.inf:
            raise DefplanError(f"the tolerance is {self.tolerance}: it must be positive")
        if not 1 <= self.max_newton < np.inf or self.max_newton != int(self.max_newton):
            raise DefplanError(
                f"max_newton is {self.max_newton}: it must be a whole number from 1 on"
            )

    @property
    def stepping(self) -> dict[str, Any]:
        """'substeps' and 'integrator', which gaits and logs hold beside the time step."""
        return {"substeps": self.substeps, "integrator": self.integrator}


def pack_options(body: Body, options: StepOptions) -> np.ndarray:
    """Return the kernel's numbers (kernel.h: DP_*) of the options and of the body's surroundings.

    Raises:
        DefplanError: see `StepOptions.check`.
    """
    options.check()
    medium, material = body.medium, body.material
    return np.array(
        [
            options.timestep,
            medium.density,
            medium.drag_normal,
            medium.drag_tangential,
            material.control_stiffness,
            material.damping,
            medium.gravity,
            medium.righting_height,
            options.tolerance,
            float(options.max_newton),
            float(options.substeps),
            INTEGRATORS[options.integrator],
        ]
    )


def unpack_options(packed: np.ndarray) -> StepOptions:
    """Return the options of `pack_options`."""
    tolerance, max_newton, substeps, integrator = packed[8:12]
    names = {number: name for name, number in INTEGRATORS.items()}
    return StepOptions(
        timestep=float(packed[0]),
        tolerance=float(tolerance),
        max_newton=int(max_newton),
        substeps=int(substeps),
        integrator=names[float(integrator)],
    )
