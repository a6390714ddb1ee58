"""Learn to swim: PPO of stable-baselines3 on 32 fish at once, which the kernel steps; its learning curve.

python docs/examples/train.py [FOLDER]     writes train.csv and train.png there (default: beside this file)
"""

from __future__ import annotations

import csv
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
from matplotlib.figure import Figure
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import defplan_mj  # noqa: F401  registers the ids

ROBOTS, SECONDS, REPEAT = 32, 10.0, 4  # at once; s of an episode; steps that an action is held
DECISIONS, ROLLOUT, SEED = 262_144, 128, 0


class ManyFish(VecEnv):
    """The vector environment as stable-baselines3 wants it; an action is held for some steps.

    An episode never ends with the last of them, so a new one has begun when they are over.
    """

    def __init__(self) -> None:
        kwargs = {"time_limit": SECONDS}
        self.envs = gymnasium.make_vec("defplan/FishSwim-v0", ROBOTS, task_kwargs=kwargs)
        box = self.envs.single_action_space  # of float64, but a policy's numbers are float32
        space = gymnasium.spaces.Box(-1.0, 1.0, box.shape, np.float32)
        super().__init__(ROBOTS, self.envs.single_observation_space, space)

    def reset(self) -> np.ndarray:
        return self.envs.reset(seed=SEED)[0]

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = np.clip(actions, -1.0, 1.0)

    def step_wait(self):
        total, infos = np.zeros(ROBOTS), [{} for _ in range(ROBOTS)]
        for _ in range(REPEAT):
            observations, rewards, lost, late, _ = self.envs.step(self.actions)
            total += rewards
            for i in np.flatnonzero(lost | late):
                infos[i] = {"terminal_observation": observations[i], "TimeLimit.truncated": late[i]}
        over = np.array([bool(info) for info in infos])
        return observations, total / REPEAT, over, infos

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, name, indices=None):
        return [getattr(self.envs, name)] * ROBOTS

    def set_attr(self, name, value, indices=None):
        raise NotImplementedError

    def env_method(self, name, *args, indices=None, **kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper, indices=None):
        return [False] * ROBOTS


class Curve(BaseCallback):
    """Keeps the mean reward of each rollout."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[tuple[int, float]] = []
        self.rewards: list[float] = []

    def _on_step(self) -> bool:
        self.rewards.append(float(self.training_env.get_original_reward().mean()))
        return True

    def _on_rollout_end(self) -> None:
        self.rows.append((self.num_timesteps, float(np.mean(self.rewards))))
        print(*self.rows[-1], round(time.process_time()), flush=True)
        self.rewards = []


def train(decisions: int = DECISIONS) -> list[tuple[int, float]]:
    """Return decisions and mean reward of each rollout of the training."""
    torch.set_num_threads(1)
    envs = VecNormalize(ManyFish(), gamma=0.98)
    small = {"n_steps": ROLLOUT, "batch_size": 512, "n_epochs": 8, "gamma": 0.98}
    model = PPO("MlpPolicy", envs, seed=SEED, device="cpu", target_kl=0.03, **small)
    model.set_logger(Logger(None, []))  # else it makes a folder among the temporary files
    curve = Curve()
    model.learn(decisions, callback=curve)
    envs.close()
    return curve.rows


def main(
    folder: Path = Path(__file__).parent, decisions: int = DECISIONS
) -> list[tuple[int, float]]:
    """Train, and write the curve as numbers and as a picture."""
    rows = train(decisions)
    with open(folder / "train.csv", "w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["decisions", "reward"])
        table.writerows([n, f"{reward:.4f}"] for n, reward in rows)
    figure = Figure(figsize=(6, 3), layout="constrained")
    axes = figure.add_subplot(
        xlabel="decisions of 55 ms", ylabel="mean reward of a step", ylim=(0, 1)
    )
    axes.plot(*zip(*rows, strict=True))
    figure.savefig(folder / "train.png", dpi=100)
    return rows


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
