"""How a mesh becomes a body: what a task, or the command line, says of it."""

from __future__ import annotations

from dataclasses import dataclass

from defplan_mj.body.model import Material, Medium

AXES = ("x", "-x", "y", "-y", "z", "-z")
"""Of a mesh file."""


@dataclass(frozen=True)
class BodyOptions:
    """How a mesh becomes a Body.

    Attributes:
        vertices: wanted number of tetrahedral mesh vertices (met within 2).
        modes: r, modal coordinates.
        basis: k, size of the displacement basis.
        samples: number of sampled tetrahedra of the second reduction.
        drag_error: bound of the relative error of the drag's generalised force on held-out motions;
            as many drag points are taken as it asks for.
        drag_points: at most.
        length: longest extent, m (None: as the mesh file says).
        up, forward: which axes of the mesh file are the body's z and x: 'x', '-x', 'y', '-y', 'z', '-z'.
        amplitude: largest |q_i| the reduction is sampled at and gaits may ask for.
        material, medium: see their classes.
    """

    vertices: int = 2000
    modes: int = 5
    basis: int = 24
    samples: int = 16
    drag_error: float = 0.03
    drag_points: int = 256
    length: float | None = 1.0
    amplitude: float = 1.5
    material: Material = Material()
    medium: Medium = Medium()
    up: str = "z"
    forward: str = "x"
