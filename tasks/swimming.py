"""The swim task, in the plane and in space."""

from __future__ import annotations

import collections
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dm_control.rl import control

from defplan_mj.base.rotations import matrix
from defplan_mj.base.space import PLANE, SPACE, Space
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import TARGET
from defplan_mj.task import TaskSpec
from defplan_tasks.environments import ShapeTask, shape_environment

_TARGET_DISTANCE = (3.0, 8.0)  # m
TARGET_RADIUS = 0.5  # m
_TILT, _BEND = 0.1, 0.2  # spread of the start: rad, in the plane; share of the amplitude


def swim_environment(
    spec: TaskSpec,
    body: Body,
    time_limit: float = 40.0,
    random: np.random.RandomState | int | None = None,
    environment_kwargs: dict | None = None,
) -> control.Environment:
    """Return the task `Swim`: the action is the target shape, in [-1, 1] of the body's amplitude."""
    dynamics = ReducedDynamics(body, spec.timestep, **spec.stepping)
    return shape_environment(spec, Swim(dynamics, time_limit, random), environment_kwargs)


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


class Swim(ShapeTask):
    """Swim to a target at one body length a second: in the plane upright, in space anyhow."""

    speed = 1.0  # m/s towards the target that earn the full reward

    def __init__(
        self,
        dynamics: ReducedDynamics,
        time_limit: float = 40.0,
        random: np.random.RandomState | int | None = None,
    ) -> None:
        """Take what moves, when an episode ends (s), and the generator or seed of what is drawn."""
        super().__init__(random=random)
        self.dynamics, self.time_limit = dynamics, time_limit

    def draw(
        self, random: np.random.RandomState, place: Space, modes: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw the target's position (3,) and the state (13 + 3r,) that an episode starts from.

        In the plane the target lies on the horizon and the body is nearly level; in space both
        the target's direction and the attitude are random. The shape is slightly bent.
        """
        start, state = STARTS[place.name], np.zeros(13 + 3 * modes)
        direction, distance = start.direction(random), random.uniform(*_TARGET_DISTANCE)
        state[3:7] = start.attitude(random)
        state[7 : 7 + modes] = _BEND * random.uniform(-1, 1, size=modes)
        return distance * direction, state

    def observe(
        self, states: np.ndarray, targets: np.ndarray, place: Space
    ) -> collections.OrderedDict:
        """Return shape, uprightness (in the plane), target and velocities, in the bodies' frames.

        Args:
            states: (n, 13 + 3r).
            targets: (n, 3) positions, m.

        Returns:
            arrays (n, size) by name.
        """
        r = modes_of(states)
        frames, velocities = matrix(states[:, 3:7]), states[:, 7 + r : 13 + 2 * r]
        observation = collections.OrderedDict(shape=states[:, 7 : 7 + r].copy())
        if place.level:
            observation["upright"] = frames[:, 2, 2:]
        observation["target"] = _within(frames, targets - states[:, :3])
        observation["velocity"] = np.concatenate(
            [_within(frames, velocities[:, :3]), velocities[:, 3:]], axis=1
        )
        return observation

    def rewards(self, states: np.ndarray, targets: np.ndarray, place: Space) -> np.ndarray:
        """Return (n,) in [0, 1]: speed towards the target, 1 there; in the plane times uprightness."""
        r = modes_of(states)
        to_target = targets - states[:, :3]
        distance = np.linalg.norm(to_target, axis=1)
        towards = (states[:, 7 + r : 10 + r] * to_target).sum(1) / np.maximum(distance, 1e-12)
        reward = np.where(distance <= TARGET_RADIUS, 1.0, np.clip(towards / self.speed, 0.0, 1.0))
        if place.level:
            reward = reward * (1 + matrix(states[:, 3:7])[:, 2, 2]) / 2
        return reward

    def initialize_episode(self, physics: Physics) -> None:
        """Place robot and target as drawn."""
        target, state = self.draw(self.random, physics.place, physics.n_modes)
        physics.named.model.site_pos[TARGET] = target
        physics.named.model.site_size[TARGET] = TARGET_RADIUS
        physics.set_reduced_state(state)
        super().initialize_episode(physics)

    def get_observation(self, physics: Physics) -> collections.OrderedDict:
        """Return `observe` of the one robot."""
        arrays = self.observe(*_of(physics))
        return collections.OrderedDict((name, array[0]) for name, array in arrays.items())

    def get_reward(self, physics: Physics) -> float:
        """Return `rewards` of the one robot."""
        return float(self.rewards(*_of(physics))[0])


def modes_of(states: np.ndarray) -> int:
    """Return r of states (n, 13 + 3r)."""
    return (states.shape[1] - 13) // 3


def _of(physics: Physics) -> tuple[np.ndarray, np.ndarray, Space]:
    return physics.reduced_state()[None], physics.target()[None], physics.place


def _within(frames: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 3) of the world in body frames (n, 3, 3)."""
    return np.einsum("nij,ni->nj", frames, vectors)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
