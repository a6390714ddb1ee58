"""Scores on the suite, of policies that know nothing, of the packaged gaits and of end-to-end learning.

    python -m defplan_mj.studies.scores [FOLDER] [--tasks ...] [--policies ...] [--decisions N]

writes scores.csv (a row a task and policy) and curves.csv (reward over decisions, while PPO and SAC learn) into
FOLDER, and prints the table of docs/suite.md. A score is the mean reward of a step, in [0, 1], over whole episodes
of 40 s that no learning has seen; of navigation it is the share of unseen scenes whose target is reached.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj import registry
from defplan_mj.base.statistics import wilson_interval
from defplan_mj.log.tables import write_table
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.robot import Robot
from defplan_mj.studies import scores_navigate
from defplan_mj.studies.check import packaged_robot

TASKS = {
    "FishSwim": "fish-swim",
    "QuadrupedSwim": "quadruped-swim",
    "QuadrupedWalk": "quadruped-walk",
    "TeeWalk": "tee-walk",
}
"""Of the suite, and the task whose gaits are packaged."""
POLICIES = ("rest", "random", "gaits", "ppo", "sac")
ROBOTS, EPISODE_S, EPISODE_SEED, SEED = 32, 40.0, 10_000, 0
_LEARNING_ROBOTS, _SECONDS, _REPEAT = (
    32,
    10.0,
    4,
)  # while it learns: at once, s of an episode, steps a decision
_DECISIONS = {"ppo": 262_144, "sac": 65_536}
_AHEAD = 4  # cycles that the gaits' choice looks ahead
_PAIRS = 100  # of cycles, for each gait
_GAMMA = 0.98

Act = Callable[[np.ndarray, int], np.ndarray]
"""From observations (n, size) and the step's number to actions (n, r)."""


@dataclass(frozen=True)
class Score:
    """What a policy gets on a task.

    Attributes:
        mean: reward of a step over all episodes, in [0, 1]; of navigation the share that arrives.
        half: of the 95% interval of the mean over the episodes; of a share, of Wilson's.
        decisions, steps: of all robots, in learning.
        seconds: CPU time of learning.
        curve: (decisions, mean reward of a step) while it learned.
    """

    task: str
    policy: str
    mean: float
    half: float
    decisions: int = 0
    steps: int = 0
    seconds: float = 0.0
    curve: list[tuple[int, float]] = field(default_factory=list)


def episodes(task: str, act: Act, robots: int = ROBOTS) -> np.ndarray:
    """Return the mean reward of a step of each of `robots` episodes; one that fails gets nothing from there on."""
    import gymnasium

    envs = gymnasium.make_vec(f"defplan/{task}-v0", robots, task_kwargs={"time_limit": EPISODE_S})
    observations, _ = envs.reset(seed=EPISODE_SEED)
    total, alive, count = np.zeros(robots), np.ones(robots, bool), 0
    while True:
        observations, rewards, lost, late, _ = envs.step(act(observations, count))
        count += 1
        total += np.where(alive, rewards, 0.0)
        alive &= ~lost
        if late.any() or not alive.any():
            break
    envs.close()
    return total / count


def score(task: str, policy: str, decisions: int | None = None, robots: int = ROBOTS) -> Score:
    """Learn if need be, and play.

    Args:
        task: of `TASKS`.
        policy: of `POLICIES`.
        decisions: of all robots in learning; if not given, what docs/suite.md has.
    """
    if task in scores_navigate.TASKS:
        return _navigated(task, policy, decisions)
    learned: dict[str, Any] = {}
    if policy in _DECISIONS:
        act, learned = _timed(
            lambda count: _learned(task, policy, count), decisions or _DECISIONS[policy], _REPEAT
        )
    elif policy == "gaits":
        act = _steered(packaged_robot(registry.get_task(TASKS[task])), robots)
    else:
        act = _unknowing(policy, task)
    rewards = episodes(task, act, robots)
    half = 1.96 * float(rewards.std(ddof=1)) / np.sqrt(len(rewards))
    return Score(task, policy, float(rewards.mean()), float(half), **learned)


def _timed(
    learn: Callable[[int], tuple[Any, list[tuple[int, float]]]], decisions: int, steps: int
) -> tuple[Any, dict[str, Any]]:
    """Return what was learned, and the fields of a `Score` on that; `steps` of a decision."""
    begun = time.process_time()
    policy, curve = learn(decisions)
    seconds = time.process_time() - begun
    return policy, {
        "decisions": decisions,
        "steps": decisions * steps,
        "seconds": seconds,
        "curve": curve,
    }


def _navigated(task: str, policy: str, decisions: int | None) -> Score:
    learned: dict[str, Any] = {}
    if policy == "ppo":
        choose, learned = _timed(
            lambda count: scores_navigate.learned(task, count, SEED),
            decisions or scores_navigate.DECISIONS,
            registry.get_task(scores_navigate.TASKS[task]).steps_per_cycle,
        )
    else:
        choose = scores_navigate.unknowing(task, SEED)
    reached = scores_navigate.arrivals(task, choose, EPISODE_SEED, scores_navigate.EPISODES)
    low, high = wilson_interval(int(reached.sum()), len(reached))
    return Score(task, policy, float(reached.mean()), 0.5 * (high - low), **learned)


def _unknowing(policy: str, task: str) -> Act:
    rng = np.random.default_rng(SEED)
    modes = packaged_robot(registry.get_task(TASKS[task])).body.n_modes

    def act(observations: np.ndarray, step: int) -> np.ndarray:
        shape = (len(observations), modes)
        return np.zeros(shape) if policy == "rest" else rng.uniform(-1.0, 1.0, shape)

    return act


def _steered(robot: Robot, robots: int) -> Act:
    """Play the packaged gaits: at each cycle the first of those few that lead nearest to the target."""
    gait, amplitude = robot.gait, robot.body.amplitude
    surrogate = fit_surrogate(robot.dynamics, gait, pairs=_PAIRS, seed=SEED)
    motions = surrogate.motions("spatial")
    plans = np.array(list(itertools.product(range(surrogate.gaits), repeat=_AHEAD)))
    place, turned = np.zeros((len(plans), 3)), np.tile(np.eye(3), (len(plans), 1, 1))
    ways = []
    for cycle in plans.T:
        place, turned = motions.of(cycle).after(place, turned)
        ways.append(place)
    way = np.array(ways)  # (ahead, plans, 3), in the body's frame at the start
    table, chosen = gait.table() / amplitude, np.zeros(robots, int)

    def act(observations: np.ndarray, step: int) -> np.ndarray:
        phase = step % gait.steps_per_cycle
        if phase == 0:
            target = observations[:, -robot.body.n_modes - 9 :][:, :3]
            distance = np.linalg.norm(way[:, :, None] - target, axis=-1)
            # how near it comes in the end, and on the way there
            chosen[:] = plans[(distance[-1] + 1e-2 * distance.sum(0)).argmin(0), 0]
        return table[chosen, phase]

    return act


def _learned(task: str, policy: str, decisions: int) -> tuple[Act, list[tuple[int, float]]]:
    import torch
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.vec_env import VecNormalize

    from defplan_mj.rl.stable_baselines import ManyRobots, learn

    torch.set_num_threads(1)
    robots = ManyRobots(f"defplan/{task}-v0", _LEARNING_ROBOTS, SEED, _REPEAT, time_limit=_SECONDS)
    envs = VecNormalize(robots, gamma=_GAMMA)
    common: dict[str, Any] = {"seed": SEED, "device": "cpu", "gamma": _GAMMA}
    if policy == "ppo":
        model: Any = PPO(
            "MlpPolicy", envs, n_steps=128, batch_size=512, n_epochs=8, target_kl=0.03, **common
        )
    else:
        # few updates: with as many as decisions it would take hours
        model = SAC("MlpPolicy", envs, train_freq=1, gradient_steps=2, batch_size=256, **common)
    curve = learn(model, envs, decisions, 4096)
    last = np.zeros((0, 0))

    def act(observations: np.ndarray, step: int) -> np.ndarray:
        nonlocal last
        if step % _REPEAT == 0:
            normal = envs.normalize_obs(observations)
            last = np.clip(model.predict(normal, deterministic=True)[0], -1.0, 1.0)
        return last

    return act, curve


def table(scores: Sequence[Score]) -> str:
    """Return the scores as a table in Markdown, a row a task."""
    policies = [p for p in POLICIES if any(s.policy == p for s in scores)]
    lines = [f"| task | {' | '.join(policies)} |", "| --- |" + " --- |" * len(policies)]
    for task in dict.fromkeys(s.task for s in scores):
        by = {s.policy: s for s in scores if s.task == task}
        cells = [f"{by[p].mean:.3f} ± {by[p].half:.3f}" if p in by else "–" for p in policies]
        lines.append(f"| `{task}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def write(folder: Path, scores: Sequence[Score]) -> None:
    """Write scores.csv and curves.csv."""
    learned = [(s, *point) for s in scores for point in s.curve]
    rows = {
        "task": [s.task for s in scores],
        "policy": [s.policy for s in scores],
        "reward": [round(s.mean, 4) for s in scores],
        "half_interval": [round(s.half, 4) for s in scores],
        "decisions": [s.decisions for s in scores],
        "steps": [s.steps for s in scores],
        "cpu_s": [round(s.seconds) for s in scores],
    }
    curves = {
        "task": [s.task for s, _, _ in learned],
        "policy": [s.policy for s, _, _ in learned],
        "decisions": [decisions for _, decisions, _ in learned],
        "reward": [round(reward, 4) for _, _, reward in learned],
    }
    for name, columns in (("scores", rows), ("curves", curves)):
        write_table(
            {key: np.array(column) for key, column in columns.items()}, folder / f"{name}.csv"
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Score what is asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m defplan_mj.studies.scores", description=__doc__
    )
    parser.add_argument("folder", nargs="?", type=Path, default=Path())
    tasks = [*TASKS, *scores_navigate.TASKS]
    parser.add_argument("--tasks", nargs="+", choices=tasks, default=tasks)
    parser.add_argument("--policies", nargs="+", choices=POLICIES, default=list(POLICIES))
    parser.add_argument("--decisions", type=int, help="of all robots in learning")
    options = parser.parse_args(arguments)
    scores = []
    for task in options.tasks:
        known = scores_navigate.POLICIES if task in scores_navigate.TASKS else POLICIES
        for policy in (name for name in options.policies if name in known):
            scores.append(score(task, policy, options.decisions))
            print(
                f"{task} {policy}: {scores[-1].mean:.3f}, {scores[-1].seconds:.0f} CPU s",
                flush=True,
            )
            write(options.folder, scores)
    print(table(scores))


if __name__ == "__main__":
    main()
