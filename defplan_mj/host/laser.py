"""The laser scanner: MuJoCo's ray casting from the centre of mass, around the horizon or all around."""

from __future__ import annotations

import mujoco
import numpy as np

from defplan_mj.host.ground import TERRAIN_GROUP
from defplan_mj.host.scene import DECOR_GROUP
from defplan_mj.planning.beams import beam_directions
from defplan_mj.task import SPACES

_UNSEEN = (DECOR_GROUP, TERRAIN_GROUP)
_GROUPS = np.array([group not in _UNSEEN for group in range(mujoco.mjNGROUP)], np.uint8)
SPACE_OF = {dimension: space for space, dimension in SPACES.items()}


def scan(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    origin: np.ndarray,
    frame: np.ndarray,
    beams: int,
    laser_range: float,
    bodyexclude: int = -1,
) -> np.ndarray:
    """Return the (beams,) distances to the nearest geom, m; `laser_range` where there is none.

    The beams are those of `planning.beams`: around a circle in a planar frame, over a sphere in a
    spatial one. Geoms of the decor and terrain groups, invisible ones and those of the body `bodyexclude` are not
    seen; nor are sites and skins.

    Args:
        origin: (3,) world position, m.
        frame: (3, d) the axes, as columns in the world, of the frame that the beams turn with;
            d is 2 (ahead, left) or 3 (a whole attitude).
    """
    directions = beam_directions(beams, SPACE_OF[frame.shape[1]])
    rays = np.zeros((beams, 3))
    for axis, along in zip(frame.T, directions.T, strict=True):
        rays += along[:, None] * axis
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
