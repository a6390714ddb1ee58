"""Builds a Body from a mesh file: mesh, modes, rotation-strain coordinates, reduction, drag points."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.convergence import stiffness_correction
from defplan_mj.body.cubature import drag_points
from defplan_mj.body.elasticity import moving_modes
from defplan_mj.body.loading import Filled, fill_file
from defplan_mj.body.model import LIMITS, Body
from defplan_mj.body.options import SHAPES, BodyOptions
from defplan_mj.body.orientation import direction
from defplan_mj.body.reduction import exact_shapes, reach, reduce_shapes
from defplan_mj.body.rotation_strain import RotationStrain, feature_map
from defplan_mj.body.tetmesh import TetMesh, boundary, lumped_mass, quality

_ROTATION, _STRAIN = 1.0, 0.4  # what q = 1 is about: rad of rotation, or strain


def mode_scales(features: np.ndarray) -> np.ndarray:
    """Return (r,) what each mode of a feature map (t, 9, r) is divided by for the unit of q.

    After it the 99% quantile over the tetrahedra is 1 rad of rotation or 0.4 of strain
    (spectral norm), whichever comes first.
    """
    rotation = np.linalg.norm(features[:, :3], axis=1)
    index = np.array([[3, 4, 5], [4, 6, 7], [5, 7, 8]])
    strain = np.linalg.norm(features[:, index].transpose(0, 3, 1, 2), ord=2, axis=(2, 3))
    return np.maximum(
        np.quantile(rotation, 0.99, axis=0) / _ROTATION, np.quantile(strain, 0.99, axis=0) / _STRAIN
    )


def check_options(options: BodyOptions) -> None:
    """Raise a DefplanError if an option cannot be met."""
    ranges = {
        "vertices": (20, 1_000_000),
        "modes": (1, 16),
        "basis": (1, 64),
        "samples": (1, 40),
        "drag_points": (4, LIMITS["drag points"]),
    }
    for name, (least, most) in ranges.items():
        value = getattr(options, name)
        if not least <= value <= most:
            raise DefplanError(f"{name} is {value}: it must lie between {least} and {most}")
    if options.shapes not in SHAPES:
        raise DefplanError(f"shapes is '{options.shapes}': it can be {' or '.join(SHAPES)}")
    if not 0.0 <= options.moved < 1.0:
        raise DefplanError(f"moved is {options.moved}: it must lie between 0 and 1")
    material = options.material
    for axis in (options.up, options.forward):
        if axis is not None:
            direction(axis)
    for name, value in (
        ("drag_error", options.drag_error),
        ("length", 1.0 if options.length is None else options.length),
        ("shape_error", 1.0 if options.shape_error is None else options.shape_error),
        ("amplitude", options.amplitude),
        ("density", material.density),
        ("Young's modulus", material.youngs_modulus),
    ):
        if not 0.0 < value < np.inf:
            raise DefplanError(f"{name} is {value}: it must be positive")
    if not -1.0 < material.poissons_ratio < 0.5:
        raise DefplanError(
            f"Poisson's ratio is {material.poissons_ratio}: it must lie between -1 and 0.5"
        )


def _told(options: BodyOptions) -> dict:
    """Return options as a body's file keeps them: the axes only if they are not the usual ones."""
    stated = asdict(options)
    if (options.up, options.forward) == (BodyOptions.up, BodyOptions.forward):
        del stated["up"], stated["forward"]
    return stated


def build_body(
    mesh_path: str | Path,
    options: BodyOptions | None = None,
    progress: Progress = no_progress,
    name: str | None = None,
) -> Body:
    """Build a body; the same file and options give the same body to the bit, if the lattice does.

    (A surface that the lattice cannot fill is filled by fTetWild, each time a little differently;
    `body.source["mesher"]` says so.)

    Args:
        mesh_path: a surface or cells, in a format of `formats`.
        options: see `BodyOptions`; the defaults if not given.
        name: of the body; the file's stem if not given.

    Raises:
        DefplanError: the mesh cannot be used; the sentence says why and what mends it.
    """
    return build_with_account(mesh_path, options, progress, name, measured=False)[0]


def build_with_account(
    mesh_path: str | Path,
    options: BodyOptions | None = None,
    progress: Progress = no_progress,
    name: str | None = None,
    measured: bool = True,
) -> tuple[Body, Filled]:
    """Build a body as `build_body` does; return it and how its mesh came about.

    Args:
        measured: compare the mesh with the file's surface even if no option asks for it.
    """
    options = options or BodyOptions()
    check_options(options)
    path = Path(mesh_path)
    key = (options, path, name, measured, files.file_hash(path) if path.is_file() else "")
    if key not in _LAST:
        built = _built(path, options, progress, name, measured)
        _LAST.clear()
        _LAST[key] = built
    return _LAST[key]


_LAST: dict[tuple, tuple[Body, Filled]] = {}
"""What was built last: who guesses a task of a mesh runs it next."""


def _built(
    path: Path, options: BodyOptions, progress: Progress, name: str | None, measured: bool
) -> tuple[Body, Filled]:
    # one thread: sums in another order would give other bits, and the hash another gait's body
    with threadpool_limits(limits=1):
        filled = fill_file(path, options, progress, measured)
        return _build(path, options, progress, name or path.stem, filled), filled


def _build(path: Path, options: BodyOptions, progress: Progress, name: str, filled: Filled) -> Body:
    """Do the work of `build_body` on a filled mesh."""
    mesh = filled.mesh
    source: dict = {"mesh": path.name, "options": options.stated(), **filled.source}
    for what in ("repaired", "notes", "warnings"):
        if sentences := getattr(filled, what):
            source[what] = sentences
    shape = quality(mesh.vertices, mesh.tetrahedra)
    source["quality"] = {"min": float(shape.min()), "mean": float(shape.mean())}

    mass = lumped_mass(mesh.vertices, mesh.tetrahedra, options.material.density)
    mesh = TetMesh(mesh.vertices - mass @ mesh.vertices / mass.sum(), mesh.tetrahedra)
    progress("finding the linear modes", 0.2)
    values, modes, place = moving_modes(mesh, options.material, mass, options.modes, options.moved)
    progress("finding how much too stiff the mesh is", 0.25)
    correction = stiffness_correction(mesh, options.material, mass, modes, values, place[-1])
    values = values * correction.young
    source["frequencies"] = {
        "hertz": (np.sqrt(values) / (2.0 * np.pi)).tolist(),
        "converged": correction.converged.tolist(),
        "error": correction.remaining.tolist(),
    }
    scales = mode_scales(feature_map(mesh, modes))
    modes = modes / scales
    amplitude = np.full(options.modes, float(options.amplitude))

    exact = exact_shapes(RotationStrain(mesh, mass, modes), options.material, options.shapes)
    progress(f"reducing the {options.shapes} shapes", 0.35)
    reduction = reduce_shapes(
        exact,
        mass,
        reach(amplitude, options.material, options.shapes),
        options.basis,
        options.samples,
        lambda what, done: progress(what, 0.35 + 0.2 * done),
    )
    shapes = np.concatenate([mesh.vertices[:, :, None], reduction.basis], axis=2)
    faces, _ = boundary(mesh.tetrahedra)
    body = Body(
        name=name,
        material=options.material,
        medium=options.medium,
        vertices=mesh.vertices,
        tetrahedra=mesh.tetrahedra,
        faces=faces,
        vertex_mass=mass,
        modes=modes,
        frequencies=np.sqrt(values) / (2.0 * np.pi),
        stiffness=values / scales**2,
        amplitude=amplitude,
        basis=reduction.basis,
        sampled=reduction.sampled,
        feature_map=reduction.feature_map,
        feature_weights=reduction.feature_weights,
        moments=np.einsum("v,via,vjb->abij", mass, shapes, shapes, optimize=True),
        drag_points=np.zeros((0, 3, options.basis + 1)),
        drag_tangents=np.zeros((2, 0, 3, options.basis + 1)),
        drag_areas=np.zeros(0),
        surface=np.unique(faces),
        mesh_softening=correction.young,
        source=source,
    )
    progress("choosing the drag points", 0.6)
    drag, error = drag_points(body, options.drag_error, options.drag_points)
    source["drag"] = asdict(error)
    progress("body built", 1.0)
    return replace(
        body, drag_points=drag.points, drag_tangents=drag.tangents, drag_areas=drag.areas
    )
