"""Contact queries: signed distances between the deformed surface and MuJoCo's primitive geoms."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import mujoco
import numpy as np

from defplan_mj.kernel.library import Geom, kernel

PRIMITIVES = frozenset(
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
)


@dataclass(frozen=True)
class Nearest:
    """Where the surface and the geoms come closest.

    Attributes:
        distance: signed, m; negative inside. The cutoff if nothing is nearer.
        geom: id of the geom, -1 if none is within the cutoff.
        point: index of the surface point, -1 if none.
    """

    distance: float
    geom: int
    point: int


def collidable(model: mujoco.MjModel, robot: int) -> np.ndarray:
    """Return the ids (g,) of the geoms that the body `robot` can touch: primitives with a contact bit."""
    others = model.body_rootid[model.geom_bodyid] != robot
    touchable = (model.geom_contype | model.geom_conaffinity) != 0
    return np.flatnonzero(others & touchable & np.isin(model.geom_type, list(PRIMITIVES)))


def nearest(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    blob: np.ndarray,
    qpos: np.ndarray,
    robot: int,
    cutoff: float = 1.0,
) -> Nearest:
    """Return the closest pair of surface point and geom, at the places `mj_kinematics` left.

    The sensor 'clearance' holds the distance alone, at no cost; this says where.

    Args:
        blob: the kernel's body.
        qpos: (7 + r,) of the robot.
        cutoff: m.
    """
    ids = collidable(model, robot)
    geoms = (Geom * max(len(ids), 1))()
    for place, geom in enumerate(ids):
        geoms[place] = Geom(
            int(model.geom_type[geom]),
            tuple(model.geom_size[geom]),
            tuple(data.geom_xpos[geom]),
            tuple(data.geom_xmat[geom]),
        )
    geom, point = ctypes.c_int(), ctypes.c_int()
    distance = kernel().dp_clearance(
        blob,
        np.ascontiguousarray(qpos),
        len(ids),
        geoms,
        cutoff,
        ctypes.byref(geom),
        ctypes.byref(point),
    )
    return Nearest(distance, int(ids[geom.value]) if geom.value >= 0 else -1, point.value)
