"""Which way a mesh looks: its mirror planes, what it stands on, its longest axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from defplan_mj.body.orientation import frame_of
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, boundary, volumes

_SOLE = 0.04  # of the height: what is as low as this is stood on
_CLEAR = 1.1  # by how much a measure has to exceed another to tell something
_LEVEL = 0.02  # of the length: a centre of mass this near the middle says nothing
_MIRRORED = 0.005  # rms distance of the mirrored surface beyond that of chance, in body lengths
_SAMPLES = 8000  # points of the surface that are mirrored


@dataclass(frozen=True)
class View:
    """Which way a mesh looks.

    Attributes:
        up, forward: axes of the file.
        mirrors: indices of the file's axes across which it is its own mirror image.
        why: how that was found, as a clause.
    """

    up: str
    forward: str
    mirrors: tuple[int, ...]
    why: str


def look(
    mesh: Surface | TetMesh,
    medium: str = "water",
    up: str | None = None,
    forward: str | None = None,
) -> View:
    """Return which axes of a mesh are up and ahead, as given, or else as follows.

    Left and right are alike: if it is its own image across one of the three planes through the file's axes,
    up and ahead lie in that. On the ground, up is then the axis along which it stands most firmly; in water
    the shorter of the two. A long body that is alike across two planes swims along both, flat sideways.
    If none of this tells, up is z. Ahead is the longest of what is left, towards the centre of mass: tails
    are thin.

    Args:
        mesh: in the file's axes.
        medium: 'water' or 'ground'.
        up, forward: what the user, or the file's format, says of them.

    Raises:
        DefplanError: there is no such axis, or both are along one.
    """
    if up is not None and forward is not None:
        frame_of(up, forward)
    points, faces, centre = _solid(mesh)
    extent, why = np.ptp(points, axis=0), []
    length = extent.max()
    mirrors = tuple(a for a in range(3) if _is_mirror(points, faces, centre, a, length))
    given = {name[-1] for name in (up, forward) if name}
    free = [axis for axis in range(3) if "xyz"[axis] not in given]
    alike = [axis for axis in mirrors if axis in free]
    if len(mirrors) == 1 and alike and len(free) > 1:
        free.remove(alike[0])
        why.append(f"left and right are alike across {'xyz'[alike[0]]}")
    if up is None:
        axis = max(free)
        short, long = (f(free, key=lambda a: extent[a]) for f in (min, max))
        if len(mirrors) == 1 and len(free) == 2 and medium == "ground":
            firm = {a: _firmness(points, faces, centre, a) for a in free}
            if max(firm.values()) > _CLEAR * max(min(firm.values()), 0.0):
                axis = max(free, key=lambda a: firm[a])
                why.append(f"it stands firmest on -{'xyz'[axis]}")
        elif len(mirrors) == 1 and len(free) == 2 and extent[long] > _CLEAR * extent[short]:
            axis = short
        elif len(mirrors) == 2 and medium == "water" and long not in mirrors:
            across = [a for a in free if a != long]
            if len(across) == 2 and extent[long] > 2 * extent[across].max():
                tall = max(across, key=lambda a: extent[a])
                if extent[tall] > _CLEAR * extent[across].min():
                    axis = tall
                    why.append("it is flat sideways")
        free.remove(axis)
        up = "xyz"[axis]
    if forward is None:
        axis = max(free, key=lambda axis: extent[axis])
        off = centre[axis] - (points[:, axis].min() + points[:, axis].max()) / 2
        forward = ("-" if off < -_LEVEL * length else "") + "xyz"[axis]
        why.append(f"it is longest along {forward[-1]}" if extent[axis] >= length else "")
        why.append("heavier in front" if abs(off) > _LEVEL * length else "")
    return View(up, forward, mirrors, ", ".join(filter(None, why)))


def _firmness(points: np.ndarray, faces: np.ndarray, centre: np.ndarray, axis: int) -> float:
    """Return the tangent of the angle by which a body can be tilted before it falls; negative: it falls.

    It stands on what is lowest along an axis; the centre of mass is above that, or not.
    """
    drawn = np.concatenate([points, _drawn(points, faces, 2)])
    height = drawn[:, axis] - drawn[:, axis].min()
    others = [other for other in range(3) if other != axis]
    sole = drawn[height < _SOLE * height.max()][:, others] - centre[others]
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    # from the centre to the hull's sides
    reach = (sole @ np.array([np.cos(angle), np.sin(angle)])).max(0)
    return float(reach.min() / (centre[axis] - drawn[:, axis].min()))


def _solid(mesh: Surface | TetMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices and triangles of the surface, and the centre of volume (3,)."""
    if isinstance(mesh, TetMesh):
        size = volumes(mesh.vertices, mesh.tetrahedra)
        middle = mesh.vertices[mesh.tetrahedra].mean(1)
        faces, _ = boundary(mesh.tetrahedra)
        return mesh.vertices[np.unique(faces)], _renumbered(faces), size @ middle / size.sum()
    corners = mesh.vertices[mesh.faces]
    size = np.einsum("ij,ij->i", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6
    return mesh.vertices, mesh.faces, size @ (corners.sum(1) / 4) / size.sum()


def _renumbered(faces: np.ndarray) -> np.ndarray:
    return np.unique(faces, return_inverse=True)[1].reshape(-1, 3)


def _is_mirror(
    vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, axis: int, length: float
) -> bool:
    """Return whether a surface is its own mirror image across the plane through its centre.

    Points drawn on it are mirrored; they have to lie about as near to others drawn on it as these do.
    """
    here, there = _drawn(vertices, faces, 0), _drawn(vertices, faces, 1)
    image = here.copy()
    image[:, axis] = 2 * centre[axis] - image[:, axis]
    tree = cKDTree(there)
    chance, found = tree.query(here)[0], tree.query(image)[0]
    return bool(np.sqrt((found**2).mean()) < np.sqrt((chance**2).mean()) + _MIRRORED * length)


def _drawn(vertices: np.ndarray, faces: np.ndarray, seed: int) -> np.ndarray:
    """Return points (n, 3) drawn evenly on a surface."""
    random = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = random.choice(len(faces), _SAMPLES, p=area / area.sum())
    first, second = random.random((2, _SAMPLES, 1))
    over = first + second > 1
    first, second = np.where(over, 1 - first, first), np.where(over, 1 - second, second)
    return a[chosen] + first * (b - a)[chosen] + second * (c - a)[chosen]
