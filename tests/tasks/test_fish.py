"""The fish's domain file: its TaskSpec, the swim reward, its looks."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj import suite
from defplan_tasks import fish
from tests.samples import host as samples


def _swim():
    return suite.load("fish", "swim", task_kwargs={"random": 0, "body": samples.fish()})


def test_reward_is_speed_towards_the_target():
    environment = _swim()
    environment.reset()
    physics, task = environment.physics, environment.task
    rewards = []
    for speed in (-1.0, 0.0, 0.5, 1.0, 2.0):
        with physics.reset_context():
            physics.named.model.site_pos["target"] = [6.0, 0.0, 0.0]
            physics.data.qvel[0] = speed
        rewards.append(task.get_reward(physics))
    assert rewards == pytest.approx([0, 0, 0.5, 1, 1])


def test_reward_is_whole_at_the_target_and_none_upside_down():
    environment = _swim()
    environment.reset()
    physics, task = environment.physics, environment.task
    with physics.reset_context():
        physics.named.model.site_pos["target"] = [0.3, 0.0, 0.0]
    assert task.get_reward(physics) == pytest.approx(1)
    with physics.reset_context():
        physics.data.qpos[3:7] = [0, 1, 0, 0]
    assert task.get_reward(physics) == pytest.approx(0, abs=1e-12)


def test_swimming_by_hand_earns_more_than_drifting():
    environment = _swim()
    table = samples.gait().table()[0] / samples.fish().amplitude
    returns = []
    for actions in (table, 0 * table):
        environment.task.random.seed(1)
        environment.reset()
        total = 0.0
        with environment.physics.reset_context():
            environment.physics.named.model.site_pos["target"] = [20.0, 0.0, 0.0]
        for index in range(320):
            total += environment.step(actions[index % len(actions)]).reward
        returns.append(total)
    assert returns[0] > 5 * max(returns[1], 0.1)


def test_target_is_seen_in_the_bodys_frame():
    environment = _swim()
    environment.reset()
    physics = environment.physics
    with physics.reset_context():
        physics.named.model.site_pos["target"] = [3.0, 0.0, 0.0]
        physics.data.qpos[3:7] = [np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)]  # heading along y
    target = environment.task.get_observation(physics)["target"]
    assert target == pytest.approx([0.0, -3.0, 0.0], abs=1e-12)


def test_episode_ends_at_the_time_limit():
    environment = suite.load(
        "fish", "swim", task_kwargs={"time_limit": 0.4, "body": samples.fish()}
    )
    environment.reset()
    steps = [environment.step(np.zeros(5)) for _ in range(30)]  # of 13.75 ms
    assert [step.last() for step in steps] == [False] * 29 + [True]
    assert steps[-1].discount == 1.0


def test_obstacles_of_navigate_can_be_chosen():
    kwargs = {"random": 0, "body": samples.fish(), "gait": samples.gait()}
    kwargs |= {"obstacles": 4, "obstacle_speed": 0.5}
    environment = suite.load("fish", "navigate", task_kwargs=kwargs)
    environment.reset()
    scene = environment.task.scene
    assert len(scene.radii) == 4
    assert np.linalg.norm(scene.velocities, axis=1) == pytest.approx(0.5)


def test_skin_has_an_eye_a_dark_back_and_a_light_belly():
    picture = fish.skin_texture().astype(int)
    height, width, _ = picture.shape
    eye = picture[round(0.47 * height), round(0.925 * width)]
    back, belly = picture[2, width // 2], picture[-2, width // 2]
    assert eye.sum() < 60 and back.sum() < belly.sum() - 200
