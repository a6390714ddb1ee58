"""The laser of the plane: beams evenly around the horizon."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from defplan_mj.base.space import PLANE
from defplan_mj.planning.sensors.laser import Laser


@lru_cache
def directions(beams: int) -> np.ndarray:
    """Return the unit vectors (beams, 2): beam k points 2 pi k / beams to the left of ahead."""
    angle = 2 * np.pi * np.arange(beams) / beams
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    around.flags.writeable = False
    return around


SENSOR = Laser(
    name="planar-laser",
    summary="distances along beams all around the horizon",
    spaces=(PLANE.name,),
    directions=directions,
)
