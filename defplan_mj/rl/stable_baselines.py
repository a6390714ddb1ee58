"""The vector environment as stable-baselines3 wants it (a peer: it is installed beside defplan, not with it)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv


class ManyRobots(VecEnv):
    """n robots of a task whose actions are target shapes, an action held for some steps.

    An episode never ends with the last of them, so a new one has begun when they are over. The reward is the
    mean of the steps.
    """

    def __init__(
        self, name: str, robots: int, seed: int, repeat: int = 1, **task_kwargs: Any
    ) -> None:
        """Make the environment.

        Args:
            name: `defplan/FishSwim-v0` or another with a vector environment of its own.
            robots: n; robot i draws its episodes from `seed` + i.
            repeat: steps that an action is held.
        """
        self.envs = gymnasium.make_vec(name, robots, task_kwargs=task_kwargs)
        self._first, self._repeat = seed, repeat
        box = self.envs.single_action_space
        # of float64, but a policy's numbers are float32
        space = gymnasium.spaces.Box(-1.0, 1.0, box.shape, np.float32)
        super().__init__(robots, self.envs.single_observation_space, space)

    def reset(self) -> np.ndarray:
        """Begin an episode of each robot; observations are (n, size)."""
        return self.envs.reset(seed=self._first)[0]

    def step_async(self, actions: np.ndarray) -> None:
        """Take the next actions (n, r)."""
        self._actions = np.clip(actions, -1.0, 1.0)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Return observations, mean rewards, whether an episode is over, and how it ended."""
        total, infos = np.zeros(self.num_envs), [dict[str, Any]() for _ in range(self.num_envs)]
        for _ in range(self._repeat):
            observations, rewards, lost, late, _ = self.envs.step(self._actions)
            total += rewards
            for i in np.flatnonzero(lost | late):
                infos[i] = {
                    "terminal_observation": observations[i],
                    "TimeLimit.truncated": bool(late[i]),
                }
        over = np.array([bool(info) for info in infos])
        return observations, total / self._repeat, over, infos

    def close(self) -> None:
        """End the threads."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same of each robot."""
        return [getattr(self.envs, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: robots are not apart."""
        raise NotImplementedError

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: robots are not apart."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return that none is."""
        return [False] * self.num_envs


def learn(model: Any, envs: Any, decisions: int, every: int) -> list[tuple[int, float]]:
    """Let a model learn in normalised environments, which are left as it knows them; return its curve."""
    model.set_logger(Logger(None, []))  # else it makes a folder among the temporary files
    curve = Curve(every)
    model.learn(decisions, callback=curve)
    envs.training = False
    return curve.rows


class Curve(BaseCallback):
    """Keeps the mean reward of every so many decisions of all robots; if it is verbose, prints each.

    Attributes:
        rows: (decisions so far, mean reward of a step) of each piece of the training.
    """

    def __init__(self, every: int, verbose: int = 0) -> None:
        super().__init__(verbose)
        self.rows: list[tuple[int, float]] = []
        self._every, self._rewards = every, list[float]()

    def _on_step(self) -> bool:
        rewards: Sequence[float] = self.locals["rewards"]
        original = getattr(self.training_env, "get_original_reward", None)
        self._rewards.append(float(np.mean(rewards if original is None else original())))
        if self.num_timesteps >= self._every * (len(self.rows) + 1):
            self.rows.append((self.num_timesteps, float(np.mean(self._rewards))))
            self._rewards = []
            if self.verbose:
                print(*self.rows[-1], round(time.process_time()), flush=True)
        return True
