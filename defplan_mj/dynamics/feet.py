"""Feet: points of a body that take given forces, as contact-invariant optimisation wants them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.kernel.pack import pack_field

HEADER, MAX_FEET = 8, 16  # kernel/parts.c, kernel/kernel.h


@dataclass(frozen=True)
class Feet:
    """Feet of a body, each the mean of some of its vertices; a force on it is shared evenly.

    Attributes:
        vertices: for each foot the indices of its vertices in the body's tetrahedral mesh.
    """

    vertices: tuple[np.ndarray, ...]

    def __len__(self) -> int:
        return len(self.vertices)


def lowest_feet(body: Body, height: float = 0.05) -> Feet:
    """Return the feet a body at rest stands on: connected parts of its surface near its lowest point.

    Args:
        height: of the slice that is looked at, in units of the body's height.
    """
    surface = body.vertices[body.surface, 2]
    low = surface.min() + height * np.ptp(surface)
    lowest = body.surface[surface <= low]
    inside = np.isin(body.faces, lowest)
    edges = [
        face[[a, b]]
        for a, b in ((0, 1), (1, 2), (2, 0))
        for face in body.faces[inside[:, a] & inside[:, b]]
    ]
    label = {int(v): int(v) for v in lowest}
    changed = True
    while changed:
        changed = False
        for a, b in edges:
            least = min(label[int(a)], label[int(b)])
            for v in (int(a), int(b)):
                if label[v] != least:
                    label[v], changed = least, True
    groups = [
        np.array([v for v in label if label[v] == name]) for name in sorted(set(label.values()))
    ]
    centres = np.array([body.vertices[group].mean(0) for group in groups])
    # front to back, left to right: an order that does not depend on the mesh
    order = np.lexsort((-centres[:, 1].round(6), -centres[:, 0].round(6)))
    return Feet(tuple(np.sort(groups[i]) for i in order))


def pack_feet(feet: Feet, body: Body) -> np.ndarray:
    """Return the kernel's array for forces on `feet` of `body`.

    Raises:
        DefplanError: there are none or too many, or one has no vertices of the body.
    """
    if not 1 <= len(feet) <= MAX_FEET:
        raise DefplanError(f"there are {len(feet)} feet: the kernel takes 1 to {MAX_FEET}")
    rows = []
    for foot in feet.vertices:
        index = np.asarray(foot, int)
        if not index.size or index.min() < 0 or index.max() >= len(body.vertices):
            raise DefplanError(f"a foot has vertices {index.tolist()}, which are not the body's")
        shapes = np.concatenate([body.vertices[index][:, :, None], body.basis[index]], axis=2)
        rows.append(shapes.mean(0))
    header = np.zeros(HEADER)
    packed = np.concatenate([header, pack_field(np.array(rows)).ravel()])
    packed[:2] = packed.size, len(feet)
    return packed
