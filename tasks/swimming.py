"""The swim task, in the plane and in space."""

from __future__ import annotations

import collections
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import rewards

from defplan_mj.base.space import PLANE, SPACE
from defplan_mj.body.model import Body
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import TARGET
from defplan_mj.task import TaskSpec
from defplan_tasks.environments import shape_environment

_TARGET_DISTANCE = (3.0, 8.0)  # m
_TARGET_RADIUS = 0.5  # m
_TILT, _BEND = 0.1, 0.2  # spread of the start: rad, in the plane; share of the amplitude


def swim_environment(
    spec: TaskSpec,
    body: Body,
    time_limit: float = 40.0,
    random: np.random.RandomState | int | None = None,
    environment_kwargs: dict | None = None,
) -> control.Environment:
    """Return the task `Swim`: the action is the target shape, in [-1, 1] of the body's amplitude."""
    return shape_environment(spec, body, Swim(random=random), time_limit, environment_kwargs)


def _level_direction(random: np.random.RandomState) -> np.ndarray:
    angle = random.uniform(-np.pi, np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def _nearly_level(random: np.random.RandomState) -> np.ndarray:
    """Return a heading and a slight tilt, a unit quaternion w x y z."""
    yaw, tilt = random.uniform(-np.pi, np.pi), random.uniform(-1, 1, size=2)
    return _unit(np.array([np.cos(yaw / 2), *(0.5 * _TILT * tilt), np.sin(yaw / 2)]))


@dataclass(frozen=True)
class Start:
    """How an episode begins in a space: draws of the target's direction and of the body's attitude."""

    direction: Callable[[np.random.RandomState], np.ndarray]
    attitude: Callable[[np.random.RandomState], np.ndarray]


STARTS = {
    PLANE.name: Start(_level_direction, _nearly_level),
    SPACE.name: Start(
        lambda random: _unit(random.normal(size=3)), lambda random: _unit(random.normal(size=4))
    ),
}


class Swim(base.Task):
    """Swim to a target at one body length a second: in the plane upright, in space anyhow."""

    speed = 1.0  # m/s towards the target that earn the full reward

    def initialize_episode(self, physics: Physics) -> None:
        """Draw target, attitude and a slightly bent shape.

        In the plane the target lies on the horizon and the body is nearly level; in space both
        the target's direction and the attitude are random.
        """
        start = STARTS[physics.space]
        direction, distance = start.direction(self.random), self.random.uniform(*_TARGET_DISTANCE)
        physics.named.model.site_pos[TARGET] = distance * direction
        physics.named.model.site_size[TARGET] = _TARGET_RADIUS
        physics.data.qpos[3:7] = start.attitude(self.random)
        r = physics.n_modes
        physics.data.qpos[7 : 7 + r] = _BEND * self.random.uniform(-1, 1, size=r)
        super().initialize_episode(physics)

    def get_observation(self, physics: Physics) -> collections.OrderedDict:
        """Return shape, uprightness (in the plane), target and velocities, all in the body's frame."""
        frame = physics.orientation()
        observation = collections.OrderedDict()
        observation["shape"] = physics.shape()
        if physics.place.level:
            observation["upright"] = np.array([physics.upright()])
        observation["target"] = _to_target(physics) @ frame
        observation["velocity"] = np.concatenate(
            [physics.data.qvel[:3] @ frame, physics.data.qvel[3:6], physics.shape_velocity()]
        )
        return observation

    def get_reward(self, physics: Physics) -> float:
        """Return in [0, 1]: speed towards the target (or being there), in the plane times uprightness."""
        to_target = _to_target(physics)
        distance = np.linalg.norm(to_target)
        if distance <= _TARGET_RADIUS:
            swimming = 1.0
        else:
            speed = physics.data.qvel[:3] @ to_target / distance
            swimming = rewards.tolerance(
                speed,
                bounds=(self.speed, float("inf")),
                margin=self.speed,
                value_at_margin=0,
                sigmoid="linear",
            )
        if physics.place.level:
            swimming *= (1 + physics.upright()) / 2
        return float(swimming)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _to_target(physics: Physics) -> np.ndarray:
    return physics.target() - physics.com()
