"""A surrogate fish and scenes for the tests of planning."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.scenes import Scene, SceneBatch, level_attitude
from defplan_mj.planning.surrogate import Surrogate


def surrogate(
    motions=((0.65, 0.0, 0.0), (0.42, 0.1, 0.6), (0.42, -0.1, -0.6)),
    radius: float = 0.5,
    scatter: float = 0.03,
) -> Surrogate:
    """Return f_fit with forward, left (m) and yaw (rad) of each of three gaits."""
    motion = np.array(motions, float)
    cosine, sine = np.cos(motion[:, 2]), np.sin(motion[:, 2])
    rotations = np.zeros((3, 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = cosine
    rotations[:, 1, 0], rotations[:, 0, 1] = sine, -sine
    rotations[:, 2, 2] = 1
    return Surrogate(
        body_hash="b" * 64,
        gait_hash="a" * 64,
        task_names=("forward", "left", "right"),
        rotations=rotations,
        translations=np.column_stack([motion[:, :2], np.zeros(3)]),
        cycle_seconds=0.44,
        pairs=1000,
        rotation_mean=np.abs(motion[:, 2]),
        rotation_sd=np.full(3, scatter),
        translation_mean=np.hypot(motion[:, 0], motion[:, 1]),
        translation_sd=np.full(3, scatter),
        radius=radius,
    )


def scene(circles=(), target=(10.0, 0.0), velocities=None, yaw=0.0, **kwargs) -> Scene:
    """Return a scene with cylinders (x, y, radius) and a start heading, rad."""
    array = np.array(circles, float).reshape(-1, 3)
    centres = np.column_stack([array[:, :2], np.zeros(len(array))])
    moving = np.zeros_like(centres)
    if velocities is not None:
        moving[:, :2] = velocities
    return Scene(
        np.array([*target, 0.0]),
        centres,
        array[:, 2],
        moving,
        orientation=level_attitude(yaw),
        **kwargs,
    )


def batch(*scenes: Scene) -> SceneBatch:
    return SceneBatch.of(list(scenes))
