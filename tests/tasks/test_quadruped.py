"""The 4-legged body's domain file: its TaskSpec, swimming in space, its looks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj import suite
from defplan_mj.host.skin import texture_of
from defplan_tasks import quadruped
from tests.samples import host as samples


def _swim(**kwargs):
    return suite.load(
        "quadruped", "swim", task_kwargs={"random": 0, "body": samples.quadruped(), **kwargs}
    )


def test_turns_tilt_the_own_axis_to_the_side_they_are_called_after():
    sides = {"front": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1), "forward": (0, 0)}
    for task in quadruped.SWIM.gait_tasks:
        axis = Rotation.from_rotvec(task.turn).apply(quadruped.SWIM.axis)
        side = np.array(sides[task.name])
        assert axis[:2] == pytest.approx(np.linalg.norm(axis[:2]) * side, abs=1e-12)
        assert np.any(axis[:2]) == np.any(side)
        assert bool(np.any(task.move)) == (task.name == "forward")


def test_episodes_start_at_any_attitude_with_targets_all_around():
    environment = _swim()
    ups, targets = [], []
    for _ in range(400):
        environment.reset()
        ups.append(environment.physics.orientation())
        targets.append(environment.physics.target())
    for directions in (np.array(ups)[:, :, 2], np.array(ups)[:, :, 0], np.array(targets)):
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        # of an even spread: no mean, a third of the second moment along each axis (4 sigma)
        assert np.abs(unit.mean(0)).max() < 4 * np.sqrt(1 / 3 / 400)
        assert np.cov(unit.T) == pytest.approx(np.eye(3) / 3, abs=4 * np.sqrt(4 / 45 / 400))
    distance = np.linalg.norm(targets, axis=1)
    assert 3 <= distance.min() < 3.2 and 7.8 < distance.max() <= 8


@pytest.mark.parametrize("quaternion", samples.attitudes(6))
def test_reward_is_speed_towards_the_target_at_any_attitude(quaternion):
    environment = _swim()
    environment.reset()
    physics, task = environment.physics, environment.task
    direction = Rotation.from_quat(quaternion).apply([0.0, 0.6, 0.8])
    rewards = []
    for speed in (-1.0, 0.0, 0.5, 1.0, 2.0):
        with physics.reset_context():
            physics.named.model.site_pos["target"] = 6 * direction
            physics.data.qpos[3:7] = quaternion
            physics.data.qvel[:3] = speed * direction
        rewards.append(task.get_reward(physics))
    assert rewards == pytest.approx([0, 0, 0.5, 1, 1])
    with physics.reset_context():
        physics.named.model.site_pos["target"] = 0.4 * direction
    assert task.get_reward(physics) == 1.0


def test_observation_is_in_the_bodys_frame():
    environment = _swim()
    environment.reset()
    physics = environment.physics
    assert set(environment.observation_spec()) == {"shape", "target", "velocity"}
    for quaternion in samples.attitudes(6):
        with physics.reset_context():
            physics.named.model.site_pos["target"] = [3.0, 1.0, -2.0]
            physics.data.qpos[3:7] = quaternion
            physics.data.qvel[:3] = [0.1, -0.2, 0.3]
        observation = environment.task.get_observation(physics)
        turn = Rotation.from_quat(quaternion, scalar_first=True)
        assert turn.apply(observation["target"]) == pytest.approx([3, 1, -2], abs=1e-12)
        assert turn.apply(observation["velocity"][:3]) == pytest.approx([0.1, -0.2, 0.3], abs=1e-12)


def test_skin_is_painted_alike_on_all_sides():
    picture = texture_of("quadruped-swim")
    assert picture is not None and picture.dtype == np.uint8
    assert np.array_equal(picture, picture[:, ::-1])  # left and right
    crown, leg, foot = (picture[round(share * 383), 192].astype(int) for share in (0.02, 0.72, 1))
    assert leg.sum() < crown.sum() - 150 and leg.sum() < foot.sum() - 150
