"""Small meshes that the tests of the body and of the full FEM share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from defplan_mj.body.formats import read_file
from defplan_mj.body.model import Body, Material, Medium
from defplan_mj.body.surface import Surface, check_extent, check_surface, check_tetrahedra
from defplan_mj.body.tetmesh import TetMesh
from tests.samples.paths import ASSETS

FISH = ASSETS / "fish.obj"


def bar(cells: tuple[int, int, int], size: tuple[float, float, float]) -> TetMesh:
    """Return a box of cells, each split in six tetrahedra around a diagonal; centred at 0."""
    axes = [np.linspace(-s / 2, s / 2, c + 1) for c, s in zip(cells, size, strict=True)]
    vertices = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    shape = np.array(cells) + 1
    corner = np.stack(np.meshgrid(*(np.arange(c) for c in cells), indexing="ij"), -1).reshape(-1, 3)
    tetrahedra = []
    for first, second in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
        path = [np.zeros(3, int)]
        for axis in (first, second, 3 - first - second):
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        index = [np.ravel_multi_index(tuple((corner + p).T), shape) for p in path]
        if (second - first) % 3 == 2:
            index[1], index[2] = index[2], index[1]
        tetrahedra.append(np.stack(index, axis=1))
    return TetMesh(vertices, np.concatenate(tetrahedra))


def surface_of(mesh: Any) -> Surface:
    """Return a trimesh as a Surface."""
    return Surface(np.array(mesh.vertices, float), np.array(mesh.faces, np.int64))


def pill(subdivisions: int = 2) -> trimesh.Trimesh:
    """Return an ellipsoid, 1 m long, 0.4 m wide, 0.3 m high, about 160 (320) vertices."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    ball.vertices *= [1.0, 0.4, 0.3]
    return ball


def unreduced_body(
    mesh: TetMesh, modes: int = 3, material: Material | None = None, medium: Medium | None = None
) -> Body:
    """Return a body for the full FEM: real mesh, mass and modes, no second reduction."""
    from defplan_mj.body.build import mode_scales
    from defplan_mj.body.elasticity import linear_modes
    from defplan_mj.body.rotation_strain import feature_map
    from defplan_mj.body.tetmesh import boundary, lumped_mass

    material, medium = material or Material(), medium or Medium()
    mass = lumped_mass(mesh.vertices, mesh.tetrahedra, material.density)
    mesh = TetMesh(mesh.vertices - mass @ mesh.vertices / mass.sum(), mesh.tetrahedra)
    squares, shapes = linear_modes(mesh, material, mass, modes)
    scales = mode_scales(feature_map(mesh, shapes))
    faces, _ = boundary(mesh.tetrahedra)
    return Body(
        name="bar",
        material=material,
        medium=medium,
        vertices=mesh.vertices,
        tetrahedra=mesh.tetrahedra,
        faces=faces,
        vertex_mass=mass,
        modes=shapes / scales,
        frequencies=np.sqrt(squares) / (2 * np.pi),
        stiffness=squares / scales**2,
        amplitude=np.ones(modes),
        basis=np.zeros((len(mass), 3, 0)),
        sampled=np.zeros(0, int),
        feature_map=np.zeros((0, 9, modes)),
        feature_weights=np.zeros((0, 0)),
        moments=np.zeros((1, 1, 3, 3)),
        drag_points=np.zeros((0, 3, 1)),
        drag_tangents=np.zeros((2, 0, 3, 1)),
        drag_areas=np.zeros(0),
        surface=np.unique(faces),
    )


def finned(backed: bool = True) -> trimesh.Trimesh:
    """Return an ellipsoid, 1 m long, whose end is drawn out to a tail fin: x ahead, z up.

    Args:
        backed: it has more of a back than of a belly.
    """
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    points = ball.vertices * [1.0, 0.16, 0.3]
    tail = np.clip((0.1 - points[:, 0]) / 0.6, 0.0, 1.0)
    points[:, 2] *= 1 + 1.5 * tail**2
    points[:, 1] *= 1 - 0.85 * tail
    points[:, 2] *= np.where(points[:, 2] > 0, 1.5, 0.6) if backed else 1.0
    return trimesh.Trimesh(points, ball.faces, process=False)


def load_mesh(path: str | Path, length: float | None = None) -> Surface | TetMesh:
    """Read a closed surface, or tetrahedra, as it stands, scale it to a length, m, and check it."""
    path = Path(path)
    raw = read_file(path)
    vertices, cells = raw.vertices, raw.tetrahedra if len(raw.tetrahedra) else raw.triangles
    extent = check_extent(vertices, cells, path)
    if length is not None:
        vertices = vertices * (length / extent.max())
    if cells.shape[1] == 4:
        return check_tetrahedra(vertices, cells, path)
    return check_surface(vertices, cells, path)
