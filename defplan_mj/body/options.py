"""How a mesh becomes a body: what a task, or the command line, says of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from defplan_mj.body.model import Material, Medium

SHAPES = ("rotation-strain", "elastic")
"""How a shape is reconstructed: see `RotationStrain` and `ElasticShapes`."""
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
        up, forward: axes of the file, such as "y" or "-z" (None: as the format says, or a guess).
        strict: refuse a mesh that would have to be mended.
        shape_error: largest distance between the mesh and the file's surface, of the length; with it the
            extents and the volume are held within 3%, too, if need be with more vertices (None:
            the lattice's mesh is taken as it comes).
        amplitude: largest |q_i| the reduction is sampled at and gaits may ask for.
        material, medium: see their classes.
        shapes: what the reduction comes near to: 'rotation-strain' (the paper's) or 'elastic', the shapes
            where the full FEM rests, which take longer to build.
        moved: share of the mass that a mode has to move; slower ones that move less, of an ear or a horn,
            are passed over (0: none is).
    """

    vertices: int = 2000
    modes: int = 5
    basis: int = 24
    samples: int = 16
    drag_error: float = 0.03
    drag_points: int = 256
    length: float | None = None
    amplitude: float = 1.5
    material: Material = Material()
    medium: Medium = Medium()
    up: str | None = None
    forward: str | None = None
    strict: bool = False
    shape_error: float | None = None
    shapes: str = SHAPES[0]
    moved: float = 0.0

    def stated(self) -> dict[str, Any]:
        """Return the options as data; the later ones only where they differ from their defaults.

        A body's hash is of its options, too: those of before keep theirs.
        """
        later = {
            "up": None,
            "forward": None,
            "strict": False,
            "shape_error": None,
            "shapes": SHAPES[0],
            "moved": 0.0,
        }
        return {
            name: value
            for name, value in asdict(self).items()
            if name not in later or value != later[name]
        }
