"""Training of planner `dql-paper`, to be read in one sitting: a pretrained CNN, then Q-learning."""

from __future__ import annotations

import copy
import time
from dataclasses import asdict

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from defplan_mj.base.progress import Progress
from defplan_mj.planning.outcome import SUCCESS
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import k2_scenes, novel_scenes, training_scenes
from defplan_mj.planning.sensors.laser import laser_of
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.surrogate_env import SurrogateEnv, run_on_surrogate
from defplan_mj.task import Navigation
from defplan_solvers.dql.beams import FEATURES
from defplan_solvers.dql.laser_cnn import LaserCnn
from defplan_solvers.dql.paper import PaperConfiguration

NEAREST = 2  # obstacles whose positions the CNN learns to tell


class PaperNetwork(nn.Module):
    """CNN features and the target's relative position to the values of the gaits.

    Args:
        navigation: for the laser and the dimension d of targets.
        gaits: how many.
        hidden: units of each hidden layer.
    """

    def __init__(self, navigation: Navigation, gaits: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        laser_of(navigation)  # it looks at beams
        self.beams, self.space = navigation.beams, navigation.space
        self.dimension, self.laser_range = navigation.dimension, navigation.laser_range
        self.hidden = hidden
        self.cnn = LaserCnn(self.beams, self.space, self.laser_range)
        layers: list[nn.Module] = []
        self.inputs = inputs = FEATURES + self.dimension
        for units in hidden:
            layers += [nn.Linear(inputs, units), nn.Softplus()]
            inputs = units
        self.q = nn.Sequential(*layers, nn.Linear(inputs, gaits))

    @torch.no_grad()
    def see(self, laser: np.ndarray, target: np.ndarray) -> torch.Tensor:
        """Return the (n, 32 + d) inputs of `q`: features of the scans, target (n, d) in 10 m."""
        distances = torch.as_tensor(laser, dtype=torch.float32)
        position = torch.as_tensor(target, dtype=torch.float32) / 10
        return torch.cat([self.cnn(distances), position], 1)

    @torch.no_grad()
    def values(self, laser: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the (n, K) values for scans (n, beams) and targets (n, d)."""
        return self.q(self.see(laser, target)).numpy()


def train(
    surrogate: Surrogate,
    navigation: Navigation,
    seed: int,
    configuration: PaperConfiguration,
    seconds: float | None,
    progress: Progress,
) -> tuple[PaperNetwork, dict[str, np.ndarray], dict]:
    """Return the trained networks, the training curves, and how they were made."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the sums' order, so the result, would depend on it
    deadline = time.perf_counter() + seconds if seconds is not None else float("inf")
    try:
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            network = PaperNetwork(navigation, len(surrogate.task_names), configuration.hidden)
            error = pretrain(
                network.cnn, surrogate, navigation, seed, configuration, deadline, progress
            )
            curves, done = learn(
                network, surrogate, navigation, seed, configuration, deadline, progress
            )
    finally:
        torch.set_num_threads(threads)
    meta = {
        "seed": seed,
        "iterations": done,
        "pretraining_error_m": error,
        "configuration": asdict(configuration),
    }
    return network, curves, meta


def pretrain(
    cnn: LaserCnn,
    surrogate: Surrogate,
    navigation: Navigation,
    seed: int,
    configuration: PaperConfiguration,
    deadline: float,
    progress: Progress,
) -> float:
    """Teach the CNN to tell where the nearest obstacles are; return its last mean error, m."""
    generator = np.random.default_rng([seed, 1])
    robots = configuration.pretraining_batch
    scenes = training_scenes(navigation, 2000, seed)
    env = SurrogateEnv(surrogate, navigation, scenes, robots, generator)
    head = nn.Linear(FEATURES, NEAREST * navigation.dimension)
    rate = configuration.pretraining_rate
    optimiser = torch.optim.RMSprop([*cnn.parameters(), *head.parameters()], rate)
    errors: list[float] = []
    for step in range(configuration.pretraining):
        laser = env.step(generator.integers(0, len(surrogate.task_names), robots)).laser
        truth, visible = nearest_obstacles(env)
        guess = head(cnn(torch.from_numpy(laser))).view(robots, NEAREST, -1)
        offset = guess - torch.from_numpy(truth) / navigation.laser_range
        square = (offset**2).sum(2)[torch.from_numpy(visible)]
        loss = square.mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        errors.append(navigation.laser_range * float(square.detach().sqrt().mean()))
        if step % 100 == 99:
            progress(f"CNN, error {np.mean(errors[-100:]):.2f} m", step / configuration.pretraining)
            if time.perf_counter() > deadline:
                break
    return float(np.mean(errors[-100:]))


def nearest_obstacles(env: SurrogateEnv) -> tuple[np.ndarray, np.ndarray]:
    """Return centres of the nearest obstacles in the robots' frames (n, 2, d), m, and who is in range."""
    offset = env.centres - env.position[:, None]
    gap = np.linalg.norm(offset, axis=2) - env.radii
    order = np.argsort(gap, axis=1)[:, :NEAREST]
    rows = np.arange(env.n)[:, None]
    return (offset @ env.frames)[rows, order], gap[rows, order] < env.navigation.laser_range


def learn(
    network: PaperNetwork,
    surrogate: Surrogate,
    navigation: Navigation,
    seed: int,
    configuration: PaperConfiguration,
    deadline: float,
    progress: Progress,
) -> tuple[dict[str, np.ndarray], int]:
    """Q-learning on the way to training targets (the paper's K2); return the curves and the iterations done."""
    generator = np.random.default_rng([seed, 2])
    scenes = SceneBatch.of(k2_scenes(navigation, seed))
    novel = SceneBatch.of(novel_scenes(navigation, configuration.novel, seed))
    gaits, robots = len(surrogate.task_names), len(scenes)
    per_iteration = robots * configuration.cycles
    capacity = configuration.memory * per_iteration
    state, after = (torch.zeros(capacity, network.inputs) for _ in range(2))
    gait = torch.zeros(capacity, dtype=torch.long)
    reward = torch.zeros(capacity)
    q, target_q = network.q, copy.deepcopy(network.q)
    optimiser = torch.optim.RMSprop(q.parameters(), configuration.learning_rate)
    curves: dict[str, list[float]] = {}
    every = max(1, configuration.iterations // configuration.checkpoints)
    stored = iteration = 0
    for iteration in range(1, configuration.iterations + 1):
        # trajectories of fixed length: neither the target nor a collision ends them.
        share = (iteration - 1) / configuration.iterations
        explore = configuration.explore_first * (1 - share) + configuration.explore_last * share
        env = SurrogateEnv(surrogate, navigation, scenes)
        seen = network.see(*env.observe()[:2])
        for _ in range(configuration.cycles):
            with torch.no_grad():
                best = q(seen).argmax(1).numpy()
            random = generator.random(robots) < explore
            chosen = np.where(random, generator.integers(0, gaits, robots), best)
            step = env.step(chosen)
            slots = slice(stored % capacity, stored % capacity + robots)
            state[slots], gait[slots] = seen, torch.from_numpy(chosen)
            reward[slots] = torch.as_tensor(step.reward, dtype=torch.float32)
            after[slots] = seen = network.see(step.laser, step.target)
            stored += robots
        target_q.load_state_dict(q.state_dict())
        for _ in range(configuration.updates):
            drawn = torch.from_numpy(
                generator.integers(0, min(stored, capacity), configuration.batch)
            )
            with torch.no_grad():
                best_after = target_q(after[drawn]).max(1).values
            target = reward[drawn] + configuration.discount * best_after
            value = q(state[drawn]).gather(1, gait[drawn, None])[:, 0]
            loss = functional.mse_loss(value, target)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        late = time.perf_counter() > deadline
        if iteration % every == 0 or late:
            for name, number in _checkpoint(network, surrogate, navigation, scenes, novel).items():
                curves.setdefault(name, []).append(number)
            curves.setdefault("transitions", []).append(stored)
            message = f"iteration {iteration}, training targets {curves['k2_success'][-1]:.0%}"
            progress(message, iteration / configuration.iterations)
        if late:
            break
    return {name: np.array(curve) for name, curve in curves.items()}, iteration


def _checkpoint(
    network: PaperNetwork,
    surrogate: Surrogate,
    navigation: Navigation,
    k2: SceneBatch,
    novel: SceneBatch,
) -> dict[str, float]:
    """Return the row of the training curves."""
    runs = run_on_surrogate(
        surrogate,
        navigation,
        SceneBatch.join([k2, novel]),
        lambda laser, target, _: network.values(laser, target).argmax(1),
    )
    reward, success = runs.reward[: len(k2)], runs.outcome == SUCCESS
    return {
        "k2_reward_mean": float(reward.mean()),
        "k2_reward_min": float(reward.min()),
        "k2_reward_max": float(reward.max()),
        "k2_success": float(success[: len(k2)].mean()),
        "novel_success": float(success[len(k2) :].mean()),
    }
