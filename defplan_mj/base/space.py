"""Where robots navigate, as data: the plane and space. Who needs to know asks these, not their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from defplan_mj.base.rotations import heading, level_attitude, level_matrix, quaternion_heading


def heading_frame(rotation: np.ndarray) -> np.ndarray:
    """Return the rotations (..., 3, 3) about the vertical by the headings of rotations (..., 3, 3)."""
    return level_matrix(heading(rotation))


def own_frame(rotation: np.ndarray) -> np.ndarray:
    """Return rotations (..., 3, 3) as they are."""
    return rotation


def heading_attitude(attitude: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) w x y z of the heading of a quaternion (4,)."""
    return level_attitude(quaternion_heading(attitude))


def own_attitude(attitude: np.ndarray) -> np.ndarray:
    """Return a quaternion (4,) w x y z as it is."""
    return attitude


@dataclass(frozen=True)
class Space:
    """Where a robot navigates.

    Attributes:
        name: in tasks, logs and files.
        dimension: d, of positions and directions: the first d coordinates count.
        frame: rotations of bodies (..., 3, 3) -> those of the frames that their planning turns with.
        attitude: the same of a quaternion (4,) w x y z.
        obstacle: the shape of obstacles.
        sensor: what a robot has if its task names no other, see `planning.sensors`.
    """

    name: str
    dimension: int
    frame: Callable[[np.ndarray], np.ndarray]
    attitude: Callable[[np.ndarray], np.ndarray]
    obstacle: str
    sensor: str

    @property
    def level(self) -> bool:
        """Whether robots are meant to stay upright, at their height: up and down do not count."""
        return self.dimension == 2


PLANE = Space(
    "planar", 2, heading_frame, heading_attitude, obstacle="cylinder", sensor="planar-laser"
)
SPACE = Space("spatial", 3, own_frame, own_attitude, obstacle="sphere", sensor="spherical-laser")

SPACES = {space.name: space for space in (PLANE, SPACE)}
"""By name."""
OF_DIMENSION = {space.dimension: space for space in SPACES.values()}
OF_OBSTACLE = {space.obstacle: space for space in SPACES.values()}
