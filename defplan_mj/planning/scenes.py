"""Navigation scenes as plain data: a start, a target, obstacles on the way; and their generators."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Scene:
    """One navigation problem, in the world frame (metres, z up); the body starts at the origin.

    Attributes:
        target: (3,) position.
        centres: (m, 3) obstacle centres at time 0.
        radii: (m,) obstacle radii.
        velocities: (m, 3) constant obstacle velocities, m/s.
        shape: 'cylinder' (upright) or 'sphere'.
        yaw: start heading, rad.
        goal_radius: the target is reached when the centre of mass comes this close.
        max_cycles: gait cycles before the episode times out.
    """

    target: np.ndarray
    centres: np.ndarray
    radii: np.ndarray
    velocities: np.ndarray
    shape: str = "cylinder"
    yaw: float = 0.0
    goal_radius: float = 1.0
    max_cycles: int = 200
    meta: dict = field(default_factory=dict)
