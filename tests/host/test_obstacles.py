"""Scenes that are written into a compiled model leave it as if it had been compiled with them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.host.looks import DRAWN_HALF_HEIGHT, DRAWN_HEIGHT
from defplan_mj.host.obstacles import max_obstacles
from defplan_mj.host.scene import SOLID_HALF_HEIGHT
from defplan_mj.planning.scene import Scene
from tests.samples import host as samples


def _compiled(scene: Scene) -> mujoco.MjModel:
    """Return a model that MuJoCo compiled with the obstacles of a scene."""
    spec = mujoco.MjSpec()
    for index, (centre, radius) in enumerate(zip(scene.centres, scene.radii, strict=True)):
        body = spec.worldbody.add_body(name=f"obstacle_{index}", mocap=True, pos=centre)
        for solid in (True, False):
            height = SOLID_HALF_HEIGHT if solid else DRAWN_HALF_HEIGHT + 0.01 * index
            sphere = scene.shape == "sphere"
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE if sphere else mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[radius, 0 if sphere else height, 0],
                pos=[0, 0, 0 if solid or sphere else DRAWN_HEIGHT],
                contype=int(solid),
                conaffinity=int(solid),
                mass=int(solid),
            )
    return spec.compile()


@pytest.mark.parametrize("shape", ["cylinder", "sphere"])
def test_rewritten_obstacles_equal_compiled_ones(shape):
    circles = [(4.0, 1.0, 1.0), (-3.0, 2.0, 0.7), (1.0, -6.0, 2.0)]
    scene = samples.scene(circles, shape=shape)
    physics = samples.physics()
    other = "sphere" if shape == "cylinder" else "cylinder"
    for first in (samples.scene([(1.0, 1.0, 0.2)] * 4, shape=other), scene):
        with physics.reset_context():
            physics.set_scene(first)
    model, expected = physics.model, _compiled(scene)
    for index in range(3):
        body, twin = physics.model.name2id(f"obstacle_{index}", "body"), index + 1
        assert np.array_equal(model.body_pos[body], expected.body_pos[twin])
        assert np.array_equal(model.body_ipos[body], expected.body_ipos[twin])
        for k in range(2):
            geom, twin_geom = model.body_geomadr[body] + k, expected.body_geomadr[twin] + k
            for name in ("geom_type", "geom_pos", "geom_size", "geom_rbound", "geom_aabb"):
                here, there = getattr(model, name)[geom], getattr(expected, name)[twin_geom]
                assert here == pytest.approx(there, abs=1e-12), name
        assert model.body_bvhnum[body] == expected.body_bvhnum[twin] == 1
        box, twin_box = model.body_bvhadr[body], expected.body_bvhadr[twin]
        assert model.bvh_aabb[box] == pytest.approx(expected.bvh_aabb[twin_box], abs=1e-12)


def test_cylinders_reach_as_far_as_a_swimmer_drifts():
    physics = samples.physics()
    for height in (-12.0, 0.0, 12.0):
        with physics.reset_context():
            physics.set_scene(samples.scene([(2.0, 0.0, 1.0), (0.0, 0.8, 0.5)]))
            physics.data.qpos[2] = height
        assert physics.laser()[0] == pytest.approx(1.0)
        assert physics.clearance() == pytest.approx(0.3 - 0.08, abs=0.03)


def test_target_is_placed_and_sized():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene([], target=(3.0, 4.0, 0.5), goal_radius=1.25))
    assert np.array_equal(physics.named.data.site_xpos["target"], [3.0, 4.0, 0.5])
    assert physics.named.model.site_size["target", 0] == 1.25


def test_scene_survives_resets():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene([(3.0, 0.0, 1.0)], velocities=[(0.0, 1.0, 0.0)]))
    physics.step(10)
    assert physics.named.data.xpos["obstacle_0", 1] == pytest.approx(0.4)
    physics.reset()
    assert np.array_equal(physics.named.data.xpos["obstacle_0"], [3.0, 0.0, 0.0])


def test_too_many_obstacles_are_refused():
    physics = samples.physics(2)
    assert max_obstacles(physics.model.ptr) == 2
    with pytest.raises(DefplanError, match="has 3 obstacles, this model has room for 2"):
        physics.set_scene(samples.scene([(5.0, 0.0, 1.0)] * 3))


def test_unknown_shape_is_refused():
    with pytest.raises(DefplanError, match="unknown obstacle shape cone"):
        samples.physics().set_scene(samples.scene([], shape="cone"))
