"""The laser of space: beams evenly over the sphere."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from defplan_mj.base.space import SPACE
from defplan_mj.planning.sensors.laser import Laser


@lru_cache
def directions(beams: int) -> np.ndarray:
    """Return the unit vectors (beams, 3) on a Fibonacci spiral from pole (+z) to pole.

    Each is a golden angle further round than the one before, and has about the same solid angle.
    """
    k = np.arange(beams)
    angle = np.pi * (3 - np.sqrt(5)) * k
    height = 1 - (2 * k + 1) / beams
    across = np.sqrt(1 - height * height)
    over = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    over.flags.writeable = False
    return over


SENSOR = Laser(
    name="spherical-laser",
    summary="distances along beams in all directions",
    spaces=(SPACE.name,),
    directions=directions,
)
