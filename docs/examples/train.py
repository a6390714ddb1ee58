"""Learn to swim: PPO of stable-baselines3 on 32 fish at once, which the kernel steps; its learning curve.

python docs/examples/train.py [FOLDER]     writes train.csv and train.png there (default: beside this file)
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import torch
from matplotlib.figure import Figure
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize

from defplan_mj.rl.stable_baselines import Curve, ManyRobots

ROBOTS, SECONDS, REPEAT = 32, 10.0, 4  # at once; s of an episode; steps that an action is held
DECISIONS, ROLLOUT, SEED = 262_144, 128, 0


def train(decisions: int = DECISIONS) -> list[tuple[int, float]]:
    """Return decisions and mean reward of each rollout of the training."""
    torch.set_num_threads(1)
    fish = ManyRobots("defplan/FishSwim-v0", ROBOTS, SEED, REPEAT, time_limit=SECONDS)
    envs = VecNormalize(fish, gamma=0.98)
    small = {"n_steps": ROLLOUT, "batch_size": 512, "n_epochs": 8, "gamma": 0.98}
    model = PPO("MlpPolicy", envs, seed=SEED, device="cpu", target_kl=0.03, **small)
    model.set_logger(Logger(None, []))  # else it makes a folder among the temporary files
    curve = Curve(ROBOTS * ROLLOUT, verbose=1)
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
