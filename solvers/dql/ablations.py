"""What planner `dql` owes to each part of its recipe: trainings with one thing changed.

    python -m defplan_solvers.dql.ablations quadruped-swim RUN/surrogate.npz [--transitions N] [--seeds N]

prints the table of docs/planning.md, a row as soon as it is there.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from defplan_mj import registry
from defplan_mj.base.progress import no_progress
from defplan_mj.planning.observation import Senses
from defplan_mj.planning.outcome import SUCCESS, TIMEOUT
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import k2_scenes, novel_scenes
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.surrogate_env import SurrogateEnv, run_all
from defplan_mj.task import Navigation
from defplan_solvers.dql.training import Recipe, train

CHANGES: dict[str, dict] = {
    "the recipe": {},
    "no progress in the reward": {"reward": "goal"},
    "raw Eq. 2": {"reward": "eq2"},
    "training targets only": {"k2_only": True},
    "1-step returns": {"n_steps": 1},
    "8-step returns": {"n_steps": 8},
    "discount 0.9": {"discount": 0.9},
    "discount 0.99": {"discount": 0.99},
}
NOVEL = 400


def ablate(
    surrogate: Surrogate, navigation: Navigation, seed: int, recipe: Recipe
) -> dict[str, float]:
    """Train by `recipe`, run the chosen network on the surrogate (its cycles scatter), no shield.

    Returns:
        Shares 'k2', 'novel' (successes) and 'novel_timeouts' of the K2 and `NOVEL` novel scenes,
        and 'cpu_seconds' of the training.
    """
    started = time.process_time()
    network, _, _ = train(surrogate, navigation, seed, recipe, float("inf"), no_progress)
    seconds = time.process_time() - started
    senses = Senses(surrogate, navigation)
    # The unseen scenes of `seed` itself are in the training curves: these are others.
    novel = SceneBatch.of(novel_scenes(navigation, NOVEL, seed + 500))
    runs = [
        run_all(
            SurrogateEnv(
                surrogate, navigation, batch, None, np.random.default_rng(seed), recipe.noise
            ),
            lambda sight, _: network(senses(*sight)).argmax(1),
        )
        for batch in (SceneBatch.of(k2_scenes(navigation, seed)), novel)
    ]
    return {
        "k2": runs[0].rate(SUCCESS),
        "novel": runs[1].rate(SUCCESS),
        "novel_timeouts": runs[1].rate(TIMEOUT),
        "cpu_seconds": seconds,
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description="What planner dql owes to each part of its recipe."
    )
    parser.add_argument("task", help="for its navigation problem")
    parser.add_argument("surrogate", help="surrogate.npz of a run")
    parser.add_argument("--transitions", type=int, default=60_000)
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    navigation = registry.get_task(options.task).navigation
    surrogate = Surrogate.load(options.surrogate)
    budget = Recipe(transitions=options.transitions, buffer=options.transitions, checkpoints=4)
    print(
        "| changed | seed | training targets | unseen scenes | unseen scenes, time-outs | CPU, s |\n"
        + "| --- " * 6
        + "|"
    )
    for name, change in CHANGES.items():
        for seed in range(options.seeds):
            row = ablate(surrogate, navigation, seed, replace(budget, **change))
            shares = " | ".join(f"{row[key]:.3f}" for key in ("k2", "novel", "novel_timeouts"))
            print(f"| {name} | {seed} | {shares} | {row['cpu_seconds']:.0f} |", flush=True)


if __name__ == "__main__":
    main()
