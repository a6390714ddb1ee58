"""Where robots navigate, as data: the plane and space. Who needs to know asks these, not their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


def heading_frame(rotation: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation by the heading of a body's rotation (3, 3), about the vertical."""
    yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def own_frame(rotation: np.ndarray) -> np.ndarray:
    """Return a body's rotation (3, 3) as it is."""
    return rotation


@dataclass(frozen=True)
class Space:
    """Where a robot navigates.

    Attributes:
        name: in tasks, logs and files.
        dimension: d, of positions and directions: the first d coordinates count.
        frame: rotation of a body (3, 3) -> rotation (3, 3) of the frame that its planning turns with.
        obstacle: the shape of obstacles.
        sensor: what a robot has if its task names no other, see `planning.sensors`.
    """

    name: str
    dimension: int
    frame: Callable[[np.ndarray], np.ndarray]
    obstacle: str
    sensor: str

    @property
    def level(self) -> bool:
        """Whether robots are meant to stay upright, at their height: up and down do not count."""
        return self.dimension == 2


PLANE = Space("planar", 2, heading_frame, obstacle="cylinder", sensor="planar-laser")
SPACE = Space("spatial", 3, own_frame, obstacle="sphere", sensor="spherical-laser")

SPACES = {space.name: space for space in (PLANE, SPACE)}
"""By name."""
OF_DIMENSION = {space.dimension: space for space in SPACES.values()}
OF_OBSTACLE = {space.obstacle: space for space in SPACES.values()}
