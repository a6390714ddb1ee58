"""The terrain that a walker stands on, as MuJoCo geoms: drawn, and asked how high the robot is above it."""

from __future__ import annotations

import mujoco
import numpy as np

from defplan_mj.dynamics.terrain import TYPES, Heightfield, Terrain

# A group of its own: the terrain is drawn and measured, but it is no obstacle, so the laser does not
# see it. Contact with it is the kernel's.
TERRAIN_GROUP = 1
_GROUPS = np.array([group == TERRAIN_GROUP for group in range(mujoco.mjNGROUP)], np.uint8)
_BASE = 0.5  # m, of solid ground below a heightfield


def add_terrain(spec: mujoco.MjSpec, terrain: Terrain, material: str) -> None:
    """Add the solids and the heightfield of `terrain`; a heightfield is flat between its points here."""
    for index, geom in enumerate(terrain.geoms):
        size = [*geom.size, 0.0, 0.0, 0.0][:3]
        spec.worldbody.add_geom(
            name=f"terrain_{index}",
            type=mujoco.mjtGeom(TYPES[geom.shape]),
            size=[0, 0, 1] if geom.shape == "plane" else size,
            pos=geom.position,
            quat=geom.quaternion,
            material=material,
            group=TERRAIN_GROUP,
            contype=0,
            conaffinity=0,
        )
    if terrain.heightfield is not None:
        _add_heightfield(spec, terrain.heightfield, material)


def _add_heightfield(spec: mujoco.MjSpec, field: Heightfield, material: str) -> None:
    heights = np.asarray(field.heights, float)
    low, span = heights.min(), max(float(np.ptp(heights)), 1e-6)
    spec.add_hfield(
        name="heights",
        nrow=heights.shape[0],
        ncol=heights.shape[1],
        size=[*field.half_size, span, _BASE],
        userdata=((heights - low) / span).ravel(),
    )
    spec.worldbody.add_geom(
        name="heights",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="heights",
        pos=np.asarray(field.position) + [0.0, 0.0, low],
        material=material,
        group=TERRAIN_GROUP,
        contype=0,
        conaffinity=0,
    )


def height_above(model: mujoco.MjModel, data: mujoco.MjData, point: np.ndarray) -> float:
    """Return how far below `point` (3,) the terrain is, m; -1 if there is none."""
    geom = np.zeros(1, np.int32)
    down = np.array([0.0, 0.0, -1.0])
    return mujoco.mj_ray(model, data, point, down, _GROUPS, 1, -1, geom, None)
