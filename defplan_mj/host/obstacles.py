"""Put a planning Scene into a compiled model: rewrite target and obstacles, no recompiling."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.host.looks import DRAWN_HALF_HEIGHT, LOOKS, OBSTACLE_RGBA
from defplan_mj.host.scene import PARKED, SOLID_HALF_HEIGHT, TARGET
from defplan_mj.planning.scene import Scene


def max_obstacles(model: Any) -> int:
    """Return how many obstacles `model` has room for."""
    count = 0
    while mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"obstacle_{count}") >= 0:
        count += 1
    return count


def set_scene(model: mujoco.MjModel, data: mujoco.MjData, scene: Scene) -> None:
    """Place the target and the obstacles of `scene`; park the obstacles it does not use.

    Upright cylinders are in effect endless for contact and laser; they are drawn shorter.

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
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, TARGET)
    model.site_pos[site] = scene.target
    model.site_size[site] = scene.goal_radius
    look = LOOKS[scene.space]
    for index in range(room):
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"obstacle_{index}")
        used = index < len(scene.radii)
        place = scene.centres[index] if used else np.array(PARKED)
        velocity = scene.velocities[index] if used else np.zeros(3)
        radius = float(scene.radii[index]) if used else 1.0
        model.body_pos[body], model.body_user[body] = place, velocity
        data.mocap_pos[model.body_mocapid[body]] = place + velocity * data.time
        solid = model.body_geomadr[body]
        model.geom_contype[solid] = model.geom_conaffinity[solid] = int(used)
        # heights differ a little: two tops in one plane would flicker where they overlap
        drawn_height = DRAWN_HALF_HEIGHT + 0.01 * index
        for geom, height in ((solid, SOLID_HALF_HEIGHT), (solid + 1, drawn_height)):
            _set_geom(model, geom, look.obstacle, radius, height)
            model.geom_rgba[geom] = OBSTACLE_RGBA if used else 0  # rays do not see alpha 0
        model.geom_pos[solid + 1] = [0.0, 0.0, look.drawn_height]
        # the body's tree of bounding boxes holds its only solid geom
        model.bvh_aabb[model.body_bvhadr[body]] = model.geom_aabb[solid]


def _set_geom(
    model: mujoco.MjModel, geom: int, shape: mujoco.mjtGeom, radius: float, height: float
) -> None:
    """Rewrite type, size and the bounds that ray casting culls by."""
    sphere = shape == mujoco.mjtGeom.mjGEOM_SPHERE
    model.geom_type[geom] = shape
    model.geom_size[geom] = [radius, 0.0 if sphere else height, 0.0]
    model.geom_rbound[geom] = radius if sphere else np.hypot(radius, height)
    model.geom_aabb[geom] = [0.0, 0.0, 0.0, radius, radius, radius if sphere else height]
