"""Full turns: no attitude is special for the plugin, the laser or what a planner sees."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.host.navigation import reduced_observation
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import SOLID_GROUP, build_spec, compile_model
from tests.samples import host as samples

WALL = 4.0  # m from the middle of a cubic room


def _quaternion(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def _in_a_room() -> Physics:
    """Return a swimmer between six walls: every beam hits, at distances without jumps."""
    spec = build_spec(samples.fish(), 0.04, space="spatial")
    for axis in range(3):
        for side in (-1, 1):
            place, normal = np.zeros(3), np.zeros(3)
            place[axis], normal[axis] = side * WALL, -side
            inwards, _ = Rotation.align_vectors(normal, [0, 0, 1])
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                pos=place,
                quat=_quaternion(inwards),
                size=[0, 0, 1],
                group=SOLID_GROUP,
            )
    return Physics.from_mjmodel(compile_model(spec))


def _seen(physics: Physics, quaternion: np.ndarray) -> dict[str, np.ndarray]:
    with physics.reset_context():
        state = np.zeros(13 + 3 * physics.n_modes)
        state[:3], state[3:7] = [0.5, -0.3, 0.2], quaternion
        state[7:12], state[12:15] = 0.2, [0.3, -0.4, 0.5]  # bent, and under way
        physics.set_reduced_state(state)
    return reduced_observation(physics, np.array([2.0, -3.0, 1.0]))


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 2, -1)])
def test_what_a_planner_sees_in_space_has_no_jump_in_two_full_turns(axis):
    physics, step = _in_a_room(), 0.02
    axis = np.array(axis) / np.linalg.norm(axis)
    start = Rotation.from_quat([0.5, -0.1, 0.8, 0.3])
    signs, before = set(), None
    for angle in np.arange(0, 4 * np.pi, step):
        quaternion = _quaternion(start * Rotation.from_rotvec(angle * axis))
        signs.add(np.sign(quaternion[0]))
        now = _seen(physics, quaternion)
        assert (now["laser"] < 10).all()
        if before is not None:
            # |x| at most 4 m away turns by 4 m / rad; a wall seen at a slant runs faster
            assert np.abs(now["target"] - before["target"]).max() <= 4.1 * step
            assert np.abs(now["state"] - before["state"]).max() <= 1.1 * step
            assert np.abs(now["laser"] - before["laser"]).max() <= 15 * step
        before = now
    assert signs == {-1, 1}  # the quaternion's sign did change on the way


def test_both_quaternions_of_an_attitude_are_seen_alike():
    physics = _in_a_room()
    for quaternion in samples.attitudes(20):
        one, other = _seen(physics, quaternion), _seen(physics, -quaternion)
        for name, array in one.items():
            assert np.array_equal(array, other[name]), name


def test_turning_world_and_body_alike_changes_nothing_but_the_attitude():
    target, velocity = np.array([2.0, -3.0, 1.0]), np.array([0.3, -0.4, 0.5])
    balls = np.array([(4.0, 1.0, 1.0, 1.0), (-3.0, 2.0, -4.0, 0.7), (1.0, -6.0, 2.0, 2.0)])
    physics, r = samples.physics(3, space="spatial"), samples.fish().n_modes

    def seen(turn: Rotation) -> dict[str, np.ndarray]:
        turned = np.column_stack([turn.apply(balls[:, :3]), balls[:, 3]])
        with physics.reset_context():
            physics.set_scene(samples.spheres(turned, turn.apply(target)))
            state = np.zeros(13 + 3 * r)
            state[3:7] = _quaternion(turn * Rotation.from_rotvec([0.3, 0.5, -0.2]))
            state[7 + r : 10 + r] = turn.apply(velocity)
            physics.set_reduced_state(state)
        return reduced_observation(physics, physics.target())

    plain = seen(Rotation.identity())
    for quaternion in samples.attitudes(20):
        turn = Rotation.from_quat(quaternion, scalar_first=True)
        other = seen(turn)
        assert other["laser"] == pytest.approx(plain["laser"], abs=1e-9)
        assert other["target"] == pytest.approx(plain["target"], abs=1e-9)
        assert other["state"][10:] == pytest.approx(plain["state"][10:], abs=1e-9)
        attitude = turn.as_matrix() @ plain["state"][1:10].reshape(3, 3)
        assert other["state"][1:10] == pytest.approx(attitude.ravel(), abs=1e-9)


def test_a_body_tumbled_through_all_attitudes_keeps_the_kernels_bits():
    body, dynamics = samples.fish(), samples.dynamics()
    model = compile_model(build_spec(body, dynamics.timestep))
    data, generator = mujoco.MjData(model), np.random.default_rng(3)
    axes, signs = [], set()
    for quaternion in samples.attitudes(60, seed=4):
        x = dynamics.rest_state()
        x[3:7] = quaternion
        spin = generator.normal(size=3)
        x[10 + dynamics.nu : 13 + dynamics.nu] = 12 * spin / np.linalg.norm(spin)  # rad/s
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.act[:] = np.split(x, [model.nq, model.nq + model.nv])
        for control in np.sin(np.cumsum(generator.normal(0, 0.4, (40, dynamics.nu)), axis=0)):
            data.ctrl[:] = control
            mujoco.mj_step(model, data)
            x, info = dynamics.step_info(x, body.amplitude * control)
            assert not info.failed
            assert np.array_equal(np.concatenate([data.qpos, data.qvel, data.act]), x)
            axes.append(Rotation.from_quat(x[3:7], scalar_first=True).as_matrix())
            signs.add(np.sign(x[3]))
    assert data.warning.number.sum() == 0 and signs == {-1, 1}
    # every axis of the body has pointed within 30 degrees of every one of 200 directions
    directions = samples.attitudes(200)[:, :3]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reached = np.einsum("nij,di->dnj", np.array(axes), directions).max(1)
    assert reached.min() > np.cos(np.radians(30))
