"""What a mesh file holds before anybody looks whether it is sound."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from defplan_mj.body import cells as split


@dataclass
class RawMesh:
    """What a file holds.

    Attributes:
        vertices: (n, 3), m if the file's unit is known.
        triangles, tetrahedra: (f, 3), (t, 4); tetrahedra count if there are any.
        notes: sentences on what was read in another way than it stands there.
        up, forward: axes that the format lays down ("y"), or None.
    """

    vertices: np.ndarray
    triangles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    tetrahedra: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.int64))
    notes: list[str] = field(default_factory=list)
    up: str | None = None
    forward: str | None = None


def of_polygons(vertices: np.ndarray, flat: np.ndarray, sizes: np.ndarray) -> RawMesh:
    """Return a mesh of faces with any number of corners.

    Args:
        vertices: (n, 3).
        flat: the corners of all faces one after the other; an index that is not there is kept, for the
            caller to refuse.
        sizes: (f,) how many corners each face has.
    """
    if len(flat) and (flat.min() < 0 or flat.max() >= len(vertices)):
        return RawMesh(vertices, np.array([[0, 0, len(vertices)]]))
    start = np.cumsum(sizes) - sizes
    triangles = [np.zeros((0, 3), np.int64)]
    for size in np.unique(sizes[sizes >= 3]):
        rows = flat[start[sizes == size][:, None] + np.arange(size)]
        triangles.append(split.split_polygons(vertices, rows))
    short = int((sizes < 3).sum())
    notes = [f"{short} faces with fewer than three corners are not used"] if short else []
    return RawMesh(vertices, np.concatenate(triangles), notes=notes)
