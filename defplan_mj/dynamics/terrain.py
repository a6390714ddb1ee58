"""What a walker stands on: a plane, static geoms, a heightfield, with friction; packed for the kernel."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body

STANDARD_GRAVITY = 9.81
MOST_GEOMS, MOST_HEIGHTS = 10_000, 10_000_000
HEADER, PER_GEOM = 16, 16  # kernel/terrain.c
TYPES = {"plane": 0, "sphere": 2, "capsule": 3, "ellipsoid": 4, "cylinder": 5, "box": 6}  # mjtGeom
SIZES = {"plane": 0, "sphere": 1, "capsule": 2, "ellipsoid": 3, "cylinder": 2, "box": 3}


@dataclass(frozen=True)
class TerrainGeom:
    """A static solid, as in MuJoCo.

    Attributes:
        shape: 'plane', 'sphere', 'capsule', 'ellipsoid', 'cylinder' or 'box'.
        size: MuJoCo's sizes, m: radii and half lengths (a plane has none and no end).
        position: (3,) m.
        quaternion: (4,) w x y z.
    """

    shape: str
    size: tuple[float, ...] = ()
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Heightfield:
    """Heights on a grid with a cubic spline through them; level beyond its rim, without a slope there.

    Attributes:
        heights: (rows, columns) m, rows along y and columns along x, from the least x and y on.
        half_size: half extents along x and y, m.
        position: (3,) centre, and where height 0 is, m.
    """

    heights: np.ndarray
    half_size: tuple[float, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


GROUND = (TerrainGeom("plane"),)


@dataclass(frozen=True)
class Terrain:
    """Static surroundings with contact (docs/kernel.md).

    A surface point whose distance s is less than the thickness d takes the normal force
    f = k (d - s)^2 (1 - b ds/dt), and friction mu f v / sqrt(|v|^2 + e^2) at a tangential velocity v.

    Attributes:
        geoms: solids; the default is the ground z = 0.
        heightfield: or None.
        friction: mu.
        slip_speed: e, m/s; how fast a point creeps under half the friction's limit is e / sqrt(3).
        thickness: d, m; None: 1% of the body's length.
        stiffness: k, N/m^2; None: one point carries the body's weight at distance 0, so that a body
            at rest on several points stays outside.
        damping: b, s/m: what an impact loses, whatever the time step.
    """

    geoms: tuple[TerrainGeom, ...] = GROUND
    heightfield: Heightfield | None = None
    friction: float = 0.8
    slip_speed: float = 0.01
    thickness: float | None = None
    stiffness: float | None = None
    damping: float = 5.0


def terrain_json(terrain: Terrain) -> dict[str, Any]:
    """Return a terrain as plain data, its numbers to the bit."""
    data = asdict(terrain)
    if terrain.heightfield is not None:
        data["heightfield"]["heights"] = np.asarray(terrain.heightfield.heights).tolist()
    return data


def terrain_of(data: dict[str, Any]) -> Terrain:
    """Return the terrain of `terrain_json`, also after a way through a JSON file."""
    geoms = (TerrainGeom(**{k: _tuple(v) for k, v in geom.items()}) for geom in data["geoms"])
    field = data["heightfield"]
    if field is not None:
        heights = np.array(field["heights"], float)
        field = Heightfield(heights, _tuple(field["half_size"]), _tuple(field["position"]))
    return Terrain(**{**data, "geoms": tuple(geoms), "heightfield": field})


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


@dataclass(frozen=True)
class ContactLaw:
    """The numbers of a terrain's contact for a body; see `Terrain` for the force.

    Attributes:
        friction: mu.
        stiffness: k, N/m^2.
        thickness: d, m.
        slip_speed: e, m/s.
        damping: b, s/m.
    """

    friction: float
    stiffness: float
    thickness: float
    slip_speed: float
    damping: float


def contact_law(terrain: Terrain, body: Body) -> ContactLaw:
    """Return the contact of `body` with `terrain`, with what the terrain leaves to the body filled in.

    Raises:
        DefplanError: a number of it cannot be.
    """
    thickness = 0.01 * body.length if terrain.thickness is None else terrain.thickness
    if not 0.0 < thickness < np.inf:
        raise DefplanError(f"the terrain's thickness is {thickness}: it must be positive")
    weight = body.mass * (abs(body.medium.gravity) or STANDARD_GRAVITY)
    stiffness = weight / thickness**2 if terrain.stiffness is None else terrain.stiffness
    for name, value in (("stiffness", stiffness), ("slip_speed", terrain.slip_speed)):
        if not 0.0 < value < np.inf:
            raise DefplanError(f"the terrain's {name} is {value}: it must be positive")
    for name, value in (("friction", terrain.friction), ("damping", terrain.damping)):
        if not 0.0 <= value < np.inf:
            raise DefplanError(f"the terrain's {name} is {value}: it must not be negative")
    return ContactLaw(terrain.friction, stiffness, thickness, terrain.slip_speed, terrain.damping)


def pack_terrain(terrain: Terrain, body: Body) -> np.ndarray:
    """Return the kernel's array for contact of `body` with `terrain` (kernel/terrain.c).

    Raises:
        DefplanError: something about the terrain cannot be.
    """
    law = contact_law(terrain, body)
    if len(terrain.geoms) > MOST_GEOMS:
        raise DefplanError(
            f"the terrain has {len(terrain.geoms)} geoms: at most {MOST_GEOMS} can be"
        )
    if not terrain.geoms and terrain.heightfield is None:
        raise DefplanError("the terrain has neither geoms nor a heightfield: leave it out")
    header = np.zeros(HEADER)
    header[1:6] = law.friction, law.stiffness, law.thickness, law.slip_speed, len(terrain.geoms)
    header[14] = law.damping
    parts = [header, *(_pack_geom(geom) for geom in terrain.geoms)]
    field = terrain.heightfield
    if field is not None:
        heights = np.asarray(field.heights, float)
        if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all():
            raise DefplanError("a heightfield's heights must be numbers on a grid of 2 x 2 or more")
        if heights.size > MOST_HEIGHTS:
            raise DefplanError(
                f"a heightfield has {heights.size} heights: at most {MOST_HEIGHTS} can be"
            )
        if len(field.half_size) != 2 or not all(0.0 < s < np.inf for s in field.half_size):
            raise DefplanError(
                f"a heightfield's half_size is {field.half_size}: it must be positive"
            )
        _numbers("heightfield's position", field.position, 3)
        header[6:8] = heights.shape
        header[8:11] = field.position
        header[11:13] = field.half_size
        coefficients = ndimage.spline_filter(heights, order=3, mode="mirror")
        header[13] = coefficients.max()  # no spline is above its largest coefficient
        parts.append(coefficients.ravel())
    packed = np.concatenate(parts)
    packed[0] = packed.size
    return packed


def _pack_geom(geom: TerrainGeom) -> np.ndarray:
    if geom.shape not in TYPES:
        known = ", ".join(TYPES)
        raise DefplanError(f"the terrain has a geom of shape '{geom.shape}': it can be {known}")
    count = SIZES[geom.shape]
    if len(geom.size) < count or not all(0.0 < s < np.inf for s in geom.size[:count]):
        raise DefplanError(
            f"a {geom.shape} of the terrain has size {geom.size}: {count} positive numbers are wanted"
        )
    _numbers(f"{geom.shape}'s position", geom.position, 3)
    _numbers(f"{geom.shape}'s quaternion", geom.quaternion, 4)
    if not any(geom.quaternion):
        raise DefplanError("a geom of the terrain has a quaternion of zeros")
    turned = rotations.matrix(np.array(geom.quaternion))
    size = np.zeros(3)
    size[:count] = geom.size[:count]
    return np.concatenate([[TYPES[geom.shape]], size, geom.position, turned.ravel()])


def _numbers(what: str, values: tuple[float, ...], count: int) -> None:
    """Raise a DefplanError unless `values` are `count` finite numbers."""
    if len(values) != count or not np.isfinite(np.asarray(values, float)).all():
        raise DefplanError(f"the terrain's {what} is {values}: {count} finite numbers are wanted")
