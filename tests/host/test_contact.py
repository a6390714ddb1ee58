"""The clearance sensor against MuJoCo's own collision queries, geom type by geom type."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.planning.scene import Scene
from tests.samples import host as samples

GEOMS = {
    "plane": [0, 0, 1],
    "sphere": [0.3, 0, 0],
    "capsule": [0.1, 0.4, 0],
    "ellipsoid": [0.5, 0.25, 0.15],
    "cylinder": [0.25, 0.3, 0],
    "box": [0.3, 0.2, 0.1],
}
RADIUS = 1e-3  # of the spheres that stand for surface points in MuJoCo's query


def _with_geom(kind: str) -> Physics:
    spec = build_spec(samples.fish(), 0.04)
    spec.worldbody.add_geom(
        name="thing",
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
        size=GEOMS[kind],
        pos=[1, 2, 3],  # one compiled into its body's frame could not be moved
        quat=[0.5, 0.5, 0.5, 0.5],
    )
    return Physics.from_mjmodel(compile_model(spec))


def _mujoco_distance(physics: Physics, kind: str) -> float:
    """Return the least distance of MuJoCo's spheres at the surface points from the geom."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(
        name="thing",
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
        size=GEOMS[kind],
        pos=physics.named.data.geom_xpos["thing"],
        quat=physics.named.model.geom_quat["thing"],
    )
    points = physics.surface()
    for point in points:
        ball = spec.worldbody.add_body(pos=point)
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return RADIUS + min(
        mujoco.mj_geomDistance(model, data, 0, 1 + index, 10.0, np.zeros(6))
        for index in range(len(points))
    )


@pytest.mark.parametrize("kind", GEOMS)
def test_clearance_equals_mujocos_distance(kind):
    generator = np.random.default_rng(3)
    physics = _with_geom(kind)
    for gap in (0.15, 0.02, -0.03):  # from clear to touching
        quaternion = generator.normal(size=4)
        physics.named.model.geom_quat["thing"] = quaternion / np.linalg.norm(quaternion)
        direction = generator.normal(size=3)
        direction /= np.linalg.norm(direction)
        samples.place(
            physics,
            generator.normal(size=3),
            generator.normal(size=4),
            q=generator.uniform(-1, 1, physics.n_modes),
        )
        # move the geom along a line until the gap is about right
        near, far = physics.com(), physics.com() + 3 * direction
        for _ in range(30):
            middle = (near + far) / 2
            physics.named.model.geom_pos["thing"] = middle
            physics.forward()
            near, far = (middle, far) if physics.clearance() < gap else (near, middle)
        expected = _mujoco_distance(physics, kind)
        assert physics.clearance() == pytest.approx(expected, abs=2e-6)
        if kind != "plane":
            assert physics.clearance() == pytest.approx(gap, abs=1e-3)


def test_clearance_saturates_when_nothing_is_near():
    physics = samples.physics()
    assert physics.clearance() == 1.0
    with physics.reset_context():
        physics.set_scene(samples.scene([(9.0, 0.0, 1.0)]))
    assert physics.clearance() == 1.0
    assert physics.nearest().geom == -1


def test_nearest_says_where():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene([(9.0, 0.0, 1.0), (0.1, 1.0, 0.5)]))
    nearest = physics.nearest()
    assert physics.model.id2name(nearest.geom, "geom") == "obstacle_1"
    assert nearest.distance == physics.clearance()
    point = physics.surface()[nearest.point]
    assert np.hypot(point[0] - 0.1, point[1] - 1.0) - 0.5 == pytest.approx(nearest.distance)


def test_geoms_without_contact_bits_are_not_touched():
    spec = build_spec(samples.fish(), 0.04)
    spec.worldbody.add_geom(name="ghost", size=[0.2, 0, 0], contype=0, conaffinity=0)
    assert Physics.from_mjmodel(compile_model(spec)).clearance() == 1.0
    spec.geom("ghost").contype = 1
    assert Physics.from_mjmodel(compile_model(spec)).clearance() < -0.1


def test_unused_obstacles_are_not_touched():
    physics = samples.physics()
    inside = samples.scene([(0.0, 0.0, 0.5), (0.2, 0.0, 0.5)])
    nothing = samples.scene([])
    for wanted, touched in ((inside, True), (nothing, False), (inside, True)):
        with physics.reset_context():
            physics.set_scene(wanted)
        assert (physics.clearance() < 0) == touched


def test_moving_obstacle_is_where_its_velocity_takes_it():
    physics, still = samples.physics(), samples.physics()
    velocity = np.array([-0.5, 0.25, 0.0])
    with physics.reset_context():
        physics.set_scene(samples.scene([(1.5, -0.6, 0.3)], velocities=[tuple(velocity)]))
    for _ in range(40):
        physics.step()
        centre = np.array([1.5, -0.6, 0.0]) + velocity * physics.time()
        with still.reset_context():
            still.set_scene(samples.scene([(centre[0], centre[1], 0.3)]))
            still.set_reduced_state(physics.reduced_state())
        assert physics.named.data.xpos["obstacle_0"] == pytest.approx(centre, abs=1e-12)
        assert physics.clearance() == pytest.approx(still.clearance(), abs=1e-12)
    assert physics.clearance() < 0.5


def test_spheres_are_spheres():
    physics = samples.physics()
    ball = Scene(
        np.zeros(3), np.array([[0.0, 0.0, 0.8]]), np.array([0.3]), np.zeros((1, 3)), "sphere"
    )
    with physics.reset_context():
        physics.set_scene(ball)
    expected = np.linalg.norm(physics.surface() - [0, 0, 0.8], axis=1).min() - 0.3
    assert physics.clearance() == pytest.approx(expected, abs=1e-12)


def test_rollout_senses_what_steps_sense():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene([(1.0, -0.5, 0.3)], velocities=[(-0.5, 0.25, 0.0)]))
    model, data = physics.model.ptr, physics.data.ptr
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    for _ in range(10):
        mujoco.mj_step(model, data)
    start = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, start, full)
    controls = np.full((20, physics.n_modes), 0.4)
    _, sensed = rollout.rollout(model, mujoco.MjData(model), start, controls)
    expected = []
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        expected.append(data.sensordata.copy())
    assert np.array_equal(sensed[0], np.array(expected))
    assert np.ptp(sensed) > 0.01
