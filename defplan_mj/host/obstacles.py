"""Put a planning Scene into a compiled model: rewrite target and obstacles, no recompiling."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from defplan_mj.errors import DefplanError
from defplan_mj.host.scene import OBSTACLE_HALF_HEIGHT, PARKED, TARGET
from defplan_mj.planning.scenes import Scene

RGBA = (0.24, 0.42, 0.80, 1.0)
_SHAPES = {"cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER, "sphere": mujoco.mjtGeom.mjGEOM_SPHERE}


def max_obstacles(model: Any) -> int:
    """Return how many obstacles `model` has room for."""
    count = 0
    while mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"obstacle_{count}") >= 0:
        count += 1
    return count


def set_scene(model: mujoco.MjModel, data: mujoco.MjData, scene: Scene) -> None:
    """Place the target and the obstacles of `scene`; park the obstacles it does not use.

    Obstacle i is then at centre_i + velocity_i * data.time, in kinematics, laser, contact and
    pictures alike: the plugin moves it. Everything derived (`geom_xpos`, sensors) follows at the
    next mj_forward.

    Raises:
        DefplanError: more obstacles than the model has room for, or an unknown shape.
    """
    room = max_obstacles(model)
    if len(scene.radii) > room:
        raise DefplanError(
            f"the scene has {len(scene.radii)} obstacles, this model has room for {room}:"
            " take fewer, or build it with a larger max_obstacles"
        )
    if scene.shape not in _SHAPES:
        raise DefplanError(
            f"unknown obstacle shape {scene.shape}: there are {', '.join(sorted(_SHAPES))}"
        )
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, TARGET)
    model.site_pos[site] = scene.target
    model.site_size[site] = scene.goal_radius
    for index in range(room):
        if index < len(scene.radii):
            radius = float(scene.radii[index])
            # heights differ a little: two tops in one plane would flicker where they overlap
            height = OBSTACLE_HALF_HEIGHT + 0.01 * index if scene.shape == "cylinder" else 0.0
            size = [radius, height, 0.0]
            place, velocity = scene.centres[index], scene.velocities[index]
            _set_obstacle(model, data, index, _SHAPES[scene.shape], size, place, velocity, RGBA)
        else:
            _set_obstacle(
                model,
                data,
                index,
                _SHAPES["cylinder"],
                [1.0, OBSTACLE_HALF_HEIGHT, 0.0],
                PARKED,
                np.zeros(3),
                (0.0, 0.0, 0.0, 0.0),
            )


def _set_obstacle(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    index: int,
    shape: mujoco.mjtGeom,
    size: list[float],
    place: Any,
    velocity: Any,
    rgba: tuple[float, float, float, float],
) -> None:
    """Rewrite one mocap body and its only geom, with the bounds that ray casting culls by.

    A geom of alpha 0 is neither drawn nor seen by rays; one of contype 0 is not touched.
    """
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"obstacle_{index}")
    geom = model.body_geomadr[body]
    model.body_pos[body] = place
    model.body_user[body] = velocity
    data.mocap_pos[model.body_mocapid[body]] = np.asarray(place) + np.multiply(velocity, data.time)
    model.geom_type[geom] = shape
    model.geom_size[geom] = size
    model.geom_rgba[geom] = rgba
    model.geom_contype[geom] = model.geom_conaffinity[geom] = int(rgba[3] > 0)
    half = [size[0], size[0], size[1] if shape == mujoco.mjtGeom.mjGEOM_CYLINDER else size[0]]
    bounds = [0.0, 0.0, 0.0, *half]
    sphere = shape == mujoco.mjtGeom.mjGEOM_SPHERE
    model.geom_rbound[geom] = size[0] if sphere else np.hypot(size[0], size[1])
    model.geom_aabb[geom] = bounds
    if model.body_bvhadr[body] >= 0:
        model.bvh_aabb[model.body_bvhadr[body]] = bounds
