"""The navigation task: gait cycles to the bit, Eq. 2's reward, and how episodes end."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from scipy.spatial.transform import Rotation

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.rotations import level_attitude
from defplan_mj.host.navigation import Navigate, navigation_environment
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.scenes import novel_scenes
from defplan_mj.task import Navigation
from tests.samples import host as samples

NAVIGATION = Navigation()
SPATIAL = Navigation(space="spatial")


def _sampler(generator: np.random.RandomState) -> Scene:
    return novel_scenes(NAVIGATION, 1, int(generator.randint(2**31)))[0]


def _environment(scene: Scene | None = None, navigation: Navigation = NAVIGATION, **kwargs):
    return navigation_environment(
        samples.fish(), samples.gait(), navigation, _sampler, scene=scene, **kwargs
    )


def test_a_cycle_equals_the_rollout_of_its_gait_to_the_bit():
    environment = _environment(samples.scene([]))
    environment.reset()
    dynamics, table = samples.dynamics(), samples.gait().table()
    x = environment.physics.reduced_state()
    for index in (0, 1, 2, 2, 0, 1):
        environment.step(index)
        x = dynamics.rollout(x, table[index])[-1]
        assert np.array_equal(environment.physics.reduced_state(), x)
    assert environment.physics.solver()["failed"] == 0


def test_cycles_equal_mujocos_rollout_to_the_bit():
    environment = _environment(samples.scene([(6.0, 1.0, 1.0)]))
    environment.reset()
    model = environment.physics.model.ptr
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = environment.physics.get_state(full)
    gaits = [0, 2, 1, 0]
    controls = np.concatenate([samples.gait().table()[index] for index in gaits])
    batch = np.tile(controls, (3, 1, 1))
    data = [mujoco.MjData(model), mujoco.MjData(model)]
    states, _ = rollout.rollout(model, data, np.tile(start, (3, 1)), batch)
    for cycle, index in enumerate(gaits):
        environment.step(index)
        now = environment.physics.get_state(full)
        assert np.array_equal(states[:, 11 * (cycle + 1) - 1], np.tile(now, (3, 1)))


@pytest.mark.parametrize("space", ["planar", "spatial"])
def test_reward_is_equation_2(space):
    target = np.array([3.0, 4.0, 2.0])
    make = samples.scene if space == "planar" else samples.spheres
    environment = _environment(make([], target=tuple(target)), Navigation(space=space))
    environment.reset()
    before = environment.physics.com()
    step = environment.step(1)
    after = environment.physics.com()
    axes = slice(2) if space == "planar" else slice(3)
    expected = np.sum((before - target)[axes] ** 2) - np.sum((after - target)[axes] ** 2)
    assert step.reward == pytest.approx(expected, abs=1e-12)
    assert step.discount == 1.0 and environment.task.outcome == "running"
    distance = np.linalg.norm((after - target)[axes])
    assert environment.task.distance(environment.physics) == pytest.approx(distance, abs=1e-12)


def test_collision_ends_the_cycle_where_it_happens():
    environment = _environment(samples.scene([(0.0, 0.9, 0.5)], velocities=[(0.0, -1.0, 0.0)]))
    environment.reset()
    clearances = []
    environment.task.step_hook = lambda physics, shape: clearances.append(physics.clearance())
    step = environment.step(0)
    assert step.last() and step.discount == 0.0
    assert environment.task.outcome == "collision"
    assert step.reward < -990
    assert 0 < len(clearances) < 11
    assert clearances[-1] < 0 < clearances[-2]
    assert environment.task.closest == clearances[-1] < 0
    assert environment.step(0).first()  # dm_control's contract: the next step begins anew


def test_a_thin_obstacle_passed_within_a_cycle_is_hit():
    # it crosses the fish between two gait cycles' ends and is far away at both
    environment = _environment(samples.scene([(0.0, 2.0, 0.1)], velocities=[(0.0, -10.0, 0.0)]))
    environment.reset()
    assert environment.physics.clearance() == 1.0
    assert environment.step(0).last() and environment.task.outcome == "collision"


def test_success_ends_the_cycle_where_it_happens():
    environment = _environment(samples.scene([], target=(1.2, 0.0, 0.0), goal_radius=1.0))
    environment.reset()
    steps = []
    environment.task.step_hook = lambda physics, shape: steps.append(physics.com())
    for _ in range(30):
        step = environment.step(0)
        if step.last():
            break
    assert step.last() and step.discount == 0.0 and environment.task.outcome == "success"
    target = environment.task.scene.target
    distances = np.linalg.norm((np.array(steps) - target)[:, :2], axis=1)  # in the plane
    assert distances[-1] <= 1.0 < distances[-2]


def test_timeout_after_the_scenes_cycles():
    environment = _environment(samples.scene([], max_cycles=3))
    environment.reset()
    steps = [environment.step(index) for index in (0, 1, 2)]
    assert [step.last() for step in steps] == [False, False, True]
    assert environment.task.outcome == "timeout" and steps[-1].discount == 1.0


def test_timeout_at_the_time_limit():
    environment = _environment(samples.scene([]), time_limit=2 * 11 * 0.04)
    environment.reset()
    assert not environment.step(0).last()
    assert environment.step(0).last() and environment.task.outcome == "timeout"


def test_hook_sees_every_physics_step_with_its_target_shape():
    environment = _environment(samples.scene([]))
    environment.reset()
    seen = []
    environment.task.step_hook = lambda physics, shape: seen.append(
        (physics.time(), shape.copy(), physics.target_shape(), physics.reduced_state())
    )
    environment.step(2)
    table = samples.gait().table()[2]
    start = samples.dynamics().rest_state()
    states = samples.dynamics().rollout(start, table)
    assert [time for time, *_ in seen] == pytest.approx(0.04 * np.arange(1, 12))
    assert np.array_equal([shape for _, shape, _, _ in seen], table)
    assert np.array_equal([shape for _, _, shape, _ in seen], table)
    assert np.array_equal([state for *_, state in seen], states[1:])


def test_setting_the_scene_takes_effect_at_the_next_reset():
    environment = _environment()
    environment.reset()
    first, model = environment.task.scene, environment.physics.model.ptr
    wanted = samples.scene([(5.0, 0.0, 1.0)], yaw=1.0)
    environment.task.scene = wanted
    assert environment.task.scene is first
    step = environment.reset()
    assert environment.task.scene is wanted
    assert environment.physics.model.ptr is model  # not recompiled
    assert environment.physics.yaw() == pytest.approx(1.0)
    beam = step.observation["laser"][round(64 * (1 - 1.0 / (2 * np.pi)))]
    assert beam == pytest.approx(4.0, abs=0.1)


def test_sampled_episodes_are_the_same_for_the_same_seed():
    environments = [_environment(random=7), _environment(random=7), _environment(random=8)]
    episodes = []
    for environment in environments:
        seen = []
        for _ in range(3):
            step = environment.reset()
            seen.append(np.concatenate(list(step.observation.values())))
            for index in (0, 1, 0):
                step = environment.step(index)
                seen.append(np.append(np.concatenate(list(step.observation.values())), step.reward))
        episodes.append(seen)
    same, other = (
        zip(episodes[0], episodes[1], strict=True),
        zip(episodes[0], episodes[2], strict=True),
    )
    assert all(np.array_equal(a, b) for a, b in same)
    assert not any(np.array_equal(a, b) for a, b in other)


def test_observation_is_the_same_wherever_the_episode_is_turned_to():
    def turn(angle: float) -> Scene:
        cos, sin = np.cos(angle), np.sin(angle)
        rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        scene = samples.scene([(3.0, 1.0, 0.5), (-2.0, 4.0, 1.0)], target=(6.0, -3.0, 0.2))
        turned = {"target": rotation @ scene.target, "centres": scene.centres @ rotation.T}
        return dataclasses.replace(scene, orientation=level_attitude(angle), **turned)

    observations = []
    for angle in (0.0, 0.7, 3.1):
        environment = _environment(turn(angle))
        environment.reset()
        for index in (1, 0, 2):
            step = environment.step(index)
        observations.append(step.observation)
    for name in ("state", "target", "laser"):
        for other in observations[1:]:
            assert other[name] == pytest.approx(observations[0][name], abs=1e-5), name


@pytest.mark.parametrize("quaternion", samples.attitudes(5))
def test_spatial_episodes_start_at_any_attitude_and_keep_the_kernels_bits(quaternion):
    scene = samples.spheres([(4.0, 1.0, -2.0, 2.0)], orientation=quaternion)
    environment = _environment(scene, SPATIAL)
    observation = environment.reset().observation
    dynamics, table = samples.dynamics(), samples.gait().table()
    x = dynamics.rest_state()
    x[3:7] = scene.orientation
    rotation = Rotation.from_quat(scene.orientation, scalar_first=True)
    assert observation["target"] == pytest.approx(rotation.inv().apply(scene.target), abs=1e-9)
    assert observation["laser"].min() < 10
    for index in (0, 1, 2, 0):
        environment.step(index)
        x = dynamics.rollout(x, table[index])[-1]
        assert np.array_equal(environment.physics.reduced_state(), x)


def test_spheres_are_hit_and_missed_in_space():
    above = (0.0, 0.0, 0.9, 0.5)  # over the fish; as a cylinder it would stand in its way
    for ball, outcome in ((above, "running"), ((0.0, 0.0, 0.5, 0.5), "collision")):
        environment = _environment(samples.spheres([ball]), SPATIAL)
        environment.reset()
        environment.step(0)
        assert environment.task.outcome == outcome


def test_a_target_overhead_is_reached_in_space_only_by_height():
    for target, outcome in (((0.0, 0.0, 1.5), "running"), ((0.0, 0.0, 0.9), "success")):
        environment = _environment(samples.spheres([], target=target), SPATIAL)
        environment.reset()
        environment.step(0)
        assert environment.task.outcome == outcome


@pytest.mark.parametrize(
    ("scene", "space", "sentence"),
    [
        (samples.spheres([]), "planar", "planar task cannot use a scene of spheres: hand in a"),
        (samples.scene([]), "spatial", "of cylinders: hand in a scene of spheres, or set nav"),
    ],
)
def test_a_scene_of_another_space_is_refused(scene, space, sentence):
    with pytest.raises(DefplanError, match=sentence):
        _environment(scene, Navigation(space=space)).reset()


def test_spatial_state_is_what_its_docstring_says():
    environment = _environment(samples.spheres([], orientation=(0.3, -0.5, 0.7, 0.2)), SPATIAL)
    environment.reset()
    environment.step(1)
    physics, r = environment.physics, samples.fish().n_modes
    state = environment.task.get_observation(physics)["state"]
    assert state.shape == (16 + 2 * r,)
    x = physics.reduced_state()
    rotation = Rotation.from_quat(x[3:7], scalar_first=True)
    assert state[0] == x[2] and np.array_equal(state[10 : 10 + r], x[7 : 7 + r])
    assert state[1:10] == pytest.approx(rotation.as_matrix().ravel(), abs=1e-12)
    velocity = rotation.apply(state[10 + r : 13 + r])
    assert velocity == pytest.approx(x[7 + r : 10 + r], abs=1e-12)
    assert np.array_equal(state[13 + r :], x[10 + r : 13 + 2 * r])


def test_state_is_what_its_docstring_says():
    environment = _environment(samples.scene([], yaw=0.9))
    environment.reset()
    environment.step(1)
    physics, r = environment.physics, samples.fish().n_modes
    state = environment.task.get_observation(physics)["state"]
    assert state.shape == (11 + 2 * r,)
    x = physics.reduced_state()
    assert state[0] == x[2] and np.array_equal(state[5 : 5 + r], x[7 : 7 + r])
    heading = np.array([np.cos(physics.yaw() / 2), 0, 0, np.sin(physics.yaw() / 2)])
    whole = np.empty(4)
    mujoco.mju_mulQuat(whole, heading, state[1:5])
    assert whole == pytest.approx(x[3:7] * np.sign(x[3] * whole[0]), abs=1e-12)
    velocity = physics.yaw_frame() @ state[5 + r : 8 + r]
    assert velocity == pytest.approx(x[7 + r : 10 + r], abs=1e-12)


def test_unknown_gait_is_refused():
    environment = _environment(samples.scene([]))
    environment.reset()
    with pytest.raises(DefplanError, match=r"no gait 3: the actions are 0 to 2 \(forward, left"):
        environment.step(3)


@pytest.mark.parametrize("action", [1.5, 1.0, np.nan, None, "forward", [0, 0], -1])
def test_an_action_that_is_no_whole_number_is_refused(action):
    environment = _environment(samples.scene([]))
    environment.reset()
    with pytest.raises(DefplanError, match=r"there is no gait .*: the actions are 0 to 2"):
        environment.step(action)


def test_gait_of_another_body_is_refused():
    other = dataclasses.replace(samples.gait(), body_hash="0" * 64)
    with pytest.raises(DefplanError, match="the gait belongs to another body"):
        navigation_environment(samples.fish(), other, NAVIGATION, _sampler)


def test_gait_beyond_the_bodys_amplitude_is_refused():
    wide = dataclasses.replace(samples.gait(), amplitude=2 * samples.fish().amplitude)
    wide = dataclasses.replace(wide, alpha=5 * wide.alpha)
    with pytest.raises(DefplanError, match="larger target shapes"):
        navigation_environment(samples.fish(), wide, NAVIGATION, _sampler)


def test_task_before_a_reset_says_so():
    task = Navigate(samples.gait(), _sampler, samples.dynamics().rest_state())
    with pytest.raises(DefplanError, match="reset the environment first"):
        task.get_reward(samples.physics())
