"""Which way a mesh looks: its mirror planes, what it stands on, its longest axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from defplan_mj.body.orientation import frame_of
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, boundary, volumes

_SOLE = 0.04  # of the height: what is as low as this is stood on
_CLEAR = 1.1  # by how much a measure has to exceed another to tell something
_LEVEL = 0.02  # of the length: a centre of mass this near the middle says nothing
_MIRRORED = 0.005  # rms distance of the mirrored surface beyond that of chance, in body lengths
_ALIKE = 0.03  # likewise of what moves its legs, or was sculpted: nearly its own mirror image
_SAMPLES = 8000  # points of the surface that are mirrored
_FOOT = 0.06  # of the height: what is as low as this, in pieces, is feet
_APART = 0.04  # of the length: points farther apart than this are of two feet
_CRUMB = 0.02  # of the points of all feet: less is no foot
_LEGS = range(4, 13)  # feet of what stands on legs
_STEADY = 0.15  # tangent of the angle by which it can be tilted then
_TIPPING = 0.08  # likewise: what can be tilted by less does not stand
_AWKWARD = 0.5  # how much standing upside down counts: files seldom are
_OVERHANG = 1.5  # by how much more of its surface a head has beyond the feet than a tail


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


@dataclass(frozen=True)
class _Stance:
    """How a body stands with some axis up.

    Attributes:
        up: the axis, with its sign.
        firm: tangent of the angle by which it can be tilted before it falls; negative: it falls.
        feet: pieces of the surface that it stands on.
        sole: (m, 3) points of these.
    """

    up: str
    firm: float
    feet: int
    sole: np.ndarray

    @property
    def legs(self) -> bool:
        """Whether it stands on legs, steadily."""
        return self.feet in _LEGS and self.firm > _STEADY

    @property
    def worth(self) -> float:
        """How likely it is meant to stand so: on legs rather than on one side, and not upside down."""
        on = 2.0 if self.legs else 1.2 if self.feet > 1 else 1.0
        return self.firm * on * (_AWKWARD if self.up.startswith("-") else 1.0)


def look(
    mesh: Surface | TetMesh,
    medium: str = "water",
    up: str | None = None,
    forward: str | None = None,
) -> View:
    """Return which axes of a mesh are up and ahead, as given, or else as follows.

    Left and right are alike: if it is its own image across one of the three planes through the file's axes,
    or nearly so across one much more than across the others, up and ahead lie in that. Up is then the axis
    with which it stands on four legs or more, or on the ground, if it has none, most firmly; in water the
    shorter of the two. A long body that is alike across two planes swims along both, flat sideways. If none
    of this tells, up is z. Ahead is the longest of what is left: of what stands on legs to the side where
    more of it is beyond its feet, a head and no tail; of others towards the centre of mass, tails are thin.

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
    unlike = np.array([_asymmetry(points, faces, centre, a) for a in range(3)]) / length
    mirrors = tuple(int(a) for a in np.flatnonzero(unlike < _MIRRORED))
    given = {name[-1] for name in (up, forward) if name}
    free = [axis for axis in range(3) if "xyz"[axis] not in given]
    side = _side(mirrors, unlike)
    if side in free and len(free) > 1:
        free.remove(side)
        nearly = "" if mirrors else "nearly "
        why.append(f"left and right are {nearly}alike across {'xyz'[side]}")
    drawn = np.concatenate([points, _drawn(points, faces, 2)])
    if up is None:
        stances = [
            _stance(drawn, centre, sign + "xyz"[axis]) for axis in free for sign in ("", "-")
        ]
        best = max(stances, key=lambda stance: stance.worth)
        others = [s.worth for s in stances if s.up[-1] != best.up[-1]]
        one = side is not None and side not in free
        if best.legs:
            up = best.up
            why.append(f"it stands on {best.feet} feet")
        elif (
            medium == "ground"
            and (one or not mirrors)
            and best.worth > max(_TIPPING, *(_CLEAR * other for other in others))
        ):
            up = best.up
            down = up[1:] if up.startswith("-") else f"-{up}"
            why.append(f"it stands firmest on {down}")
        else:
            up = "xyz"[_up_without_legs(extent, mirrors, free, one, medium, why)]
        free = [axis for axis in free if "xyz"[axis] != up[-1]]
    if forward is None:
        axis = max(free, key=lambda axis: extent[axis])
        why.append(f"it is longest along {'xyz'[axis]}" if extent[axis] >= length else "")
        sign, because = _head(drawn, centre, axis, length, _stance(drawn, centre, up))
        forward = sign + "xyz"[axis]
        why.append(because)
    return View(up, forward, mirrors, ", ".join(filter(None, why)))


def _side(mirrors: tuple[int, ...], unlike: np.ndarray) -> int | None:
    """Return the axis from left to right: the one across which it is its own image, or nearly; None: not one."""
    if mirrors:
        return mirrors[0] if len(mirrors) == 1 else None
    least, next_ = np.sort(unlike)[:2]
    return int(unlike.argmin()) if least < min(_ALIKE, next_ / 2) else None


def _up_without_legs(
    extent: np.ndarray,
    mirrors: tuple[int, ...],
    free: list[int],
    one: bool,
    medium: str,
    why: list[str],
) -> int:
    """Return the axis that is up of what stands on nothing firmly, or swims; why is added to.

    Args:
        one: left and right are known.
    """
    short, long = (f(free, key=lambda a: extent[a]) for f in (min, max))
    if one and len(free) == 2:
        if extent[long] > _CLEAR * extent[short]:
            return short
    elif len(mirrors) == 2 and medium == "water" and long not in mirrors:
        across = [a for a in free if a != long]
        if len(across) == 2 and extent[long] > 2 * extent[across].max():
            tall = max(across, key=lambda a: extent[a])
            if extent[tall] > _CLEAR * extent[across].min():
                why.append("it is flat sideways")
                return tall
    return max(free)


def _stance(drawn: np.ndarray, centre: np.ndarray, up: str) -> _Stance:
    """Return how a body stands on what is lowest with an axis up.

    Args:
        drawn: (m, 3) points of its surface.
    """
    axis, sign = "xyz".index(up[-1]), -1.0 if up.startswith("-") else 1.0
    height = sign * drawn[:, axis]
    height = height - height.min()
    others = [other for other in range(3) if other != axis]
    sole = drawn[height < _SOLE * height.max()][:, others] - centre[others]
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    # from the centre to the hull's sides
    reach = (sole @ np.array([np.cos(angle), np.sin(angle)])).max(0)
    middle = sign * centre[axis] - (sign * drawn[:, axis]).min()
    low = drawn[height < _FOOT * height.max()]
    near = _APART * np.ptp(drawn, axis=0).max()
    pairs = cKDTree(low).query_pairs(near, output_type="ndarray")
    links = sp.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(low), len(low)))
    sizes = np.bincount(connected_components(links, directed=False)[1])
    feet = int((sizes > max(3, _CRUMB * len(low))).sum())
    return _Stance(up, float(reach.min() / middle), feet, low)


def _head(
    drawn: np.ndarray, centre: np.ndarray, axis: int, length: float, stance: _Stance
) -> tuple[str, str]:
    """Return the sign of the axis along which the head is, and why."""
    along = drawn[:, axis]
    if stance.legs:
        beyond = (
            (along > stance.sole[:, axis].max()).sum(),
            (along < stance.sole[:, axis].min()).sum(),
        )
        if max(beyond) > _OVERHANG * min(beyond):
            return "" if beyond[0] > beyond[1] else "-", "its head is beyond its feet"
    off = centre[axis] - (along.min() + along.max()) / 2
    because = "heavier in front" if abs(off) > _LEVEL * length else ""
    return "-" if off < -_LEVEL * length else "", because


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


def _asymmetry(vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, axis: int) -> float:
    """Return how far a surface is from its mirror image across the plane through its centre, m.

    Points drawn on it are mirrored; the root mean square distance to others drawn on it counts that is
    beyond that of the points themselves.
    """
    here, there = _drawn(vertices, faces, 0), _drawn(vertices, faces, 1)
    image = here.copy()
    image[:, axis] = 2 * centre[axis] - image[:, axis]
    tree = cKDTree(there)
    chance, nearest = tree.query(here)[0], tree.query(image)[0]
    return float(np.sqrt((nearest**2).mean()) - np.sqrt((chance**2).mean()))


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
