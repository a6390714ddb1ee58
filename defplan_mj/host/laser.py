"""The 360-degree laser scanner: MuJoCo's ray casting in the horizontal plane through the centre of mass."""

from __future__ import annotations

import functools

import mujoco
import numpy as np

from defplan_mj.host.scene import DECOR_GROUP

_GROUPS = np.array([group != DECOR_GROUP for group in range(mujoco.mjNGROUP)], np.uint8)


def scan(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    origin: np.ndarray,
    yaw: float,
    beams: int,
    laser_range: float,
    bodyexclude: int = -1,
) -> np.ndarray:
    """Return the (beams,) distances to the nearest geom, m; `laser_range` where there is none.

    Beam k points 2 pi k / beams to the left of the heading. Geoms of the decor group, invisible ones
    and those of the body `bodyexclude` are not seen; nor are sites and skins.

    Args:
        origin: (3,) world position, m.
        yaw: heading, rad.
    """
    x, y = unit_circle(beams)
    cos, sin = np.cos(yaw), np.sin(yaw)
    rays = np.zeros((beams, 3))
    rays[:, 0] = cos * x - sin * y
    rays[:, 1] = sin * x + cos * y
    distance = np.empty(beams)
    geom = np.empty(beams, np.int32)
    mujoco.mj_multiRay(
        model,
        data,
        origin,
        rays.ravel(),
        _GROUPS,
        1,
        bodyexclude,
        geom,
        distance,
        None,
        beams,
        laser_range,
    )
    distance[(distance < 0) | (distance > laser_range)] = laser_range
    return distance


@functools.lru_cache
def unit_circle(beams: int) -> tuple[np.ndarray, np.ndarray]:
    """Return cosine and sine of the (beams,) beam angles in the body's frame."""
    angle = 2 * np.pi * np.arange(beams) / beams
    return np.cos(angle), np.sin(angle)
