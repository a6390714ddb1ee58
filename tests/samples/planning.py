"""A surrogate fish and scenes for the tests of planning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from defplan_mj.base.rotations import level_attitude
from defplan_mj.planning.past import past_of
from defplan_mj.planning.scene import Scene, SceneBatch
from defplan_mj.planning.surrogate import Surrogate, Switched


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


def swimmer(radius: float = 0.55, scatter: float = 0.03) -> Surrogate:
    """Return f_fit of a robot in space that turns in place, four ways, and moves along its own z."""
    turn, slip = 0.35, 0.03
    axes = np.array([[0, 1, 0], [0, -1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 0]], float)
    translations = np.array(
        [[slip, 0, 0], [-slip, 0, 0], [0, slip, 0], [0, -slip, 0], [0, 0, 0.45]], float
    )
    return Surrogate(
        body_hash="b" * 64,
        gait_hash="a" * 64,
        task_names=("front", "back", "left", "right", "forward"),
        rotations=Rotation.from_rotvec(turn * axes).as_matrix(),
        translations=translations,
        cycle_seconds=0.36,
        pairs=1000,
        rotation_mean=turn * np.abs(axes).sum(1),
        rotation_sd=np.full(5, scatter),
        translation_mean=np.linalg.norm(translations, axis=1),
        translation_sd=np.full(5, scatter),
        radius=radius,
    )


def walker(radius: float = 0.88, scatter: float = 0.04) -> Surrogate:
    """Return f_fit of a wide robot that steps to four sides and hardly turns."""
    step, drift = 0.4, -0.03
    ways = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float)
    return Surrogate(
        body_hash="b" * 64,
        gait_hash="a" * 64,
        task_names=("forward", "back", "left", "right"),
        rotations=Rotation.from_rotvec([[0, 0, drift]] * 4).as_matrix(),
        translations=step * ways,
        cycle_seconds=0.92,
        pairs=1000,
        rotation_mean=np.full(4, abs(drift)),
        rotation_sd=np.full(4, scatter),
        translation_mean=np.full(4, step),
        translation_sd=np.full(4, scatter),
        radius=radius,
    )


def spheres(balls=(), target=(10.0, 0.0, 0.0), orientation=(1.0, 0, 0, 0), **kwargs) -> Scene:
    """Return a scene with spheres (x, y, z, radius) and a start attitude."""
    array = np.array(balls, float).reshape(-1, 4)
    return Scene(
        np.array(target, float),
        array[:, :3],
        array[:, 3],
        np.zeros((len(array), 3)),
        "sphere",
        orientation=np.array(orientation, float),
        **kwargs,
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


def in_parts(whole: Surrogate, decisions: int, swing: float = 0.25) -> Surrogate:
    """Return a surrogate whose cycles are made of equal parts, between which the heading swings to and fro.

    Its parts, `decisions` of one gait on end, make that gait's whole cycle, exactly.

    Args:
        swing: how far the heading is off within a cycle, about z, rad.
    """
    past = past_of(whole.gaits, decisions)
    swings = Rotation.from_rotvec(
        np.outer(swing * np.sin(2 * np.pi * np.arange(decisions) / decisions + 0.3), [0, 0, 1])
    ).as_matrix()
    parts = Rotation.from_matrix(whole.rotations)
    turns = Rotation.from_rotvec(parts.as_rotvec() / decisions).as_matrix()
    powers = [np.linalg.matrix_power(turns, i) for i in range(decisions)]
    ways = np.linalg.solve(np.sum(powers, axis=0), whole.translations[..., None])
    out = swings[past.phase][:, None].swapaxes(2, 3)
    back = swings[(past.phase + 1) % decisions][:, None]
    shape = (past.rest + 1, whole.gaits)
    switching = Switched(
        out @ turns[None] @ back,
        (out @ ways[None])[..., 0],
        np.broadcast_to(whole.rotation_sd / decisions, shape).copy(),
        np.broadcast_to(whole.translation_sd / decisions, shape).copy(),
        {},
    )
    return replace(whole, switching=switching, decisions_per_cycle=decisions)
