"""Reads surface and tetrahedral meshes, and refuses the bad ones with one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from defplan_mj.body.tetmesh import TetMesh


@dataclass(frozen=True)
class Surface:
    """A closed triangle mesh: vertices (n, 3) in m, outward faces (f, 3)."""

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def volume(self) -> float:
        """Enclosed volume, m^3."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6.0)


def load_mesh(path: str | Path, length: float | None = None) -> Surface | TetMesh:
    """Read a mesh; scale its longest extent to `length` (m) if that is given."""
    mesh = trimesh.load(path, process=False, force="mesh")
    vertices = np.array(mesh.vertices, dtype=float)
    if length is not None:
        vertices *= length / np.ptp(vertices, axis=0).max()
    return Surface(vertices, np.array(mesh.faces, dtype=np.int64))
