"""A body from a mesh: tetrahedra, m_v = rho V_v, and a displacement basis in which the centre of mass rests.

python docs/examples/body.py [mesh]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from defplan_mj.body.build import build_body
from defplan_mj.body.model import Body
from defplan_mj.body.options import BodyOptions

AXES = (0.5, 0.2, 0.12)  # m, half axes of the ellipsoid that is taken if no mesh is named
OPTIONS = BodyOptions(vertices=200, modes=3, basis=10, samples=10, drag_points=24, length=None)


def ellipsoid(path: Path) -> Path:
    """Write a closed surface mesh."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale(AXES)
    mesh.export(path)
    return path


def build(mesh: Path) -> Body:
    """Return the reduced body of a mesh file."""
    body = build_body(mesh, OPTIONS)
    phi = np.concatenate([body.vertices[..., None], body.basis], -1)  # positions | basis
    centre = np.einsum("v,vik->ik", body.vertex_mass, phi)  # sum_v m_v phi_v = 0
    assert np.abs(centre).max() < 1e-9
    return body


def main(mesh: str | None = None) -> Body:
    """Build a body and print what it weighs."""
    with tempfile.TemporaryDirectory() as folder:
        body = build(Path(mesh) if mesh else ellipsoid(Path(folder) / "ellipsoid.stl"))
    volume = body.mass / body.material.density
    print(f"{len(body.vertices)} vertices, {body.mass:.2f} kg in {1e3 * volume:.2f} l")
    return body


if __name__ == "__main__":
    main(*sys.argv[1:2])
