"""Scores on the suite's navigation, end to end: PPO chooses a gait a cycle, by the reduced dynamics alone.

What the planners of defplan learn from the surrogate in a second takes a peer the dynamics of every cycle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from defplan_mj.planning.outcome import Outcome

TASKS = {"FishNavigate": "fish-swim"}
"""Of the suite, and the task whose gaits are packaged."""
POLICIES = ("random", "ppo")
EPISODES, DECISIONS = 100, 65_536
_AT_ONCE, _GAMMA = 8, 0.99

Choose = Callable[[np.ndarray], int]
"""From an observation (size,) to a gait."""


def arrivals(task: str, choose: Choose, first: int, episodes: int) -> np.ndarray:
    """Return which of the unseen scenes' targets are reached, (episodes,); episode i has the seed `first` + i."""
    env: Any = gymnasium.make(f"defplan/{task}-v0", disable_env_checker=True).unwrapped
    reached = np.zeros(episodes, bool)
    for i in range(episodes):
        observation, _ = env.reset(seed=first + i)
        over = False
        while not over:
            observation, _, lost, late, _ = env.step(choose(observation))
            over = lost or late
        reached[i] = env.suite_environment.task.outcome == Outcome.SUCCESS
    env.close()
    return reached


def unknowing(task: str, seed: int) -> Choose:
    """Return the choice of any gait, all alike."""
    space: Any = gymnasium.make(f"defplan/{task}-v0", disable_env_checker=True).action_space
    rng = np.random.default_rng(seed)
    return lambda observation: int(rng.integers(space.n))


def learned(task: str, decisions: int, seed: int) -> tuple[Choose, list[tuple[int, float]]]:
    """Return what stable-baselines3's PPO has learned, and its curve: decisions, mean reward (Eq. 2) of one."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from defplan_mj.rl.stable_baselines import learn

    torch.set_num_threads(1)
    make = lambda: gymnasium.make(f"defplan/{task}-v0", disable_env_checker=True)  # noqa: E731
    envs = VecNormalize(DummyVecEnv([make] * _AT_ONCE), gamma=_GAMMA)
    envs.seed(seed)
    model = PPO(
        "MlpPolicy", envs, n_steps=256, batch_size=256, gamma=_GAMMA, seed=seed, device="cpu"
    )
    curve = learn(model, envs, decisions, 2048)
    envs.close()

    def choose(observation: np.ndarray) -> int:
        return int(model.predict(envs.normalize_obs(observation), deterministic=True)[0])

    return choose, curve
