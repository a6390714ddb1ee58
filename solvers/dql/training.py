"""Training of planner `dql`: stable-baselines3's DQN over many surrogate robots at once."""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv

from defplan_mj.base.progress import Progress
from defplan_mj.planning.observation import Senses
from defplan_mj.planning.outcome import COLLISION, RUNNING, SUCCESS, TIMEOUT
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import (
    k2_scenes,
    training_scenes,
    validation_scenes,
    validation_targets,
)
from defplan_mj.planning.sensors.laser import laser_of
from defplan_mj.planning.shield import LEVELS
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.surrogate_env import (
    SurrogateEnv,
    SurrogateRuns,
    Transition,
    run_all,
)
from defplan_mj.task import Navigation
from defplan_solvers.dql.beams import FEATURES
from defplan_solvers.dql.dql import QNetwork
from defplan_solvers.dql.laser_cnn import LaserCnn


@dataclass(frozen=True)
class Recipe:
    """What was found to matter: scaled reward, varied scenes, target network, n-step returns.

    Attributes:
        transitions: the budget.
        robots: environments stepped at once.
        scenes: size of the bank of training scenes.
        fastest: speed of obstacles in half of these, at most, m/s.
        noise: scatter of the cycles, in units of the surrogate's standard deviations.
        margin: what the disc is larger in training than the surrogate's, m. It is the shield's: where
            the planner wants to pass and the shield does not let it, the robot would be stuck.
        hidden: units of each hidden layer.
        convolutions: the paper's CNN sees the beams.
        batch, buffer, learning_rate, discount, n_steps: of DQN, the last two for whole gait cycles. The
            buffer holds the whole training: one that forgets early collisions unlearns to avoid them.
        target_steps: updates between two copies to the target network.
        explore_first, explore_share: random gaits at the start, falling over that share of training.
        explore_range: lowest and highest share of random gaits afterwards, spread over the robots.
        reward: 'progress' in units of an advance, besides the terms below; 'goal', these terms
            alone; or 'eq2', the paper's reward as it stands, without them.
        collision, goal, cycle: terms of the reward, the last one for each gait cycle.
        k2_only: trains on the K2 scenes, as the paper does, not on the bank.
        averaging: decay of the averaged network, a step.
        checkpoints: evaluations during training.
        targets, standing, moving: held-out scenes that choose the network, no evaluation's: at training
            targets, with other obstacles, and of the unseen kind, with obstacles that stand and that move.
    """

    transitions: int = 300_000
    robots: int = 64
    scenes: int = 10_000
    fastest: float = 2.0
    noise: float = 1.0
    margin: float = LEVELS[0][1]
    hidden: tuple[int, ...] = (64, 64, 64)
    convolutions: bool = False
    batch: int = 512
    buffer: int = 300_000
    learning_rate: float = 1e-3
    discount: float = 0.97
    n_steps: int = 3
    target_steps: int = 500
    explore_first: float = 0.5
    explore_share: float = 0.15
    explore_range: tuple[float, float] = (0.05, 0.4)
    reward: str = "progress"
    collision: float = 10.0
    goal: float = 5.0
    cycle: float = 0.05
    k2_only: bool = False
    averaging: float = 0.999
    checkpoints: int = 10
    targets: int = 50
    standing: int = 100
    moving: int = 100


def train(
    surrogate: Surrogate,
    navigation: Navigation,
    seed: int,
    recipe: Recipe,
    seconds: float,
    progress: Progress,
) -> tuple[QNetwork, dict[str, np.ndarray], dict]:
    """Return the best network on held-out scenes and training targets, the training curves, and how it was made.

    Args:
        seconds: limit of the wall time.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the sums' order, so the result, would depend on it
    try:
        env = _Robots(surrogate, navigation, seed, recipe)
        model = _build(env, seed, recipe)
        watch = _Checkpoints(surrogate, navigation, seed, recipe, seconds, progress)
        model.learn(recipe.transitions, callback=watch, log_interval=1_000_000_000)
    finally:
        torch.set_num_threads(threads)
    if watch.best is None:
        watch.evaluate()
    assert watch.best is not None
    meta = {
        "seed": seed,
        "transitions": model.num_timesteps,
        "stopped_early": model.num_timesteps < recipe.transitions,
        "validation_score": watch.best_score,
        "recipe": asdict(recipe),
    }
    return watch.best, {name: np.array(row) for name, row in watch.curves.items()}, meta


def _build(env: _Robots, seed: int, recipe: Recipe) -> _RobotsDQN:
    decisions = env.robots.past.decisions
    network: dict[str, Any] = {
        "net_arch": list(recipe.hidden),
        "activation_fn": torch.nn.Softplus,
    }
    if recipe.convolutions:
        network["features_extractor_class"] = _SeeingBeams
        network["features_extractor_kwargs"] = {"navigation": env.robots.navigation}
    model = _RobotsDQN(
        "MlpPolicy",
        env,
        explore_range=recipe.explore_range,
        learning_rate=lambda remaining: recipe.learning_rate * min(1.0, 2 * remaining + 0.02),
        buffer_size=recipe.buffer,
        learning_starts=min(5000, recipe.transitions // 4),
        batch_size=recipe.batch,
        gamma=recipe.discount ** (1 / decisions),
        n_steps=recipe.n_steps * decisions,
        train_freq=1,
        gradient_steps=1,
        target_update_interval=recipe.target_steps * recipe.robots,
        exploration_initial_eps=recipe.explore_first,
        exploration_final_eps=0.0,
        exploration_fraction=recipe.explore_share,
        policy_kwargs=network,
        seed=seed,
        device="cpu",
    )
    # the one that it makes by itself leaves a folder SB3-... among the temporary files
    model.set_logger(Logger(None, []))
    return model


class _Robots(VecEnv):
    """The surrogate environment as stable-baselines3 wants it, with the recipe's reward."""

    def __init__(
        self, surrogate: Surrogate, navigation: Navigation, seed: int, recipe: Recipe
    ) -> None:
        if recipe.k2_only:
            bank = SceneBatch.of(k2_scenes(navigation, seed))
        else:
            bank = training_scenes(navigation, recipe.scenes, seed, recipe.fastest)
        generator = np.random.default_rng(seed)
        wary = replace(surrogate, radius=surrogate.radius + recipe.margin)
        self.robots = SurrogateEnv(wary, navigation, bank, recipe.robots, generator, recipe.noise)
        self.recipe, self.senses = recipe, Senses(surrogate, navigation)
        self.advance = float(np.linalg.norm(surrogate.translations, axis=1).max())
        self.actions = np.zeros(recipe.robots, np.int64)
        self.render_mode = None
        box = gymnasium.spaces.Box(-np.inf, np.inf, (self.senses.size,), np.float32)
        gaits = gymnasium.spaces.Discrete(len(surrogate.task_names))
        super().__init__(recipe.robots, box, gaits)

    def reset(self) -> np.ndarray:
        return self.senses(*self.robots.reset())

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        step = self.robots.step(self.actions)
        reward = _reward(step, self.recipe, self.advance, self.robots.past.decisions)
        done = step.outcome != RUNNING
        infos: list[dict] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(done)
        last = self.senses(*step.final.of(ended))
        for robot, observation in zip(ended, last, strict=True):
            infos[robot] = {
                "terminal_observation": observation,
                "TimeLimit.truncated": bool(step.outcome[robot] == TIMEOUT),
            }
        observation = self.senses(*step.sight)
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("the robots share their attributes")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list:
        raise NotImplementedError("the robots are one environment")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def _reward(step: Transition, recipe: Recipe, advance: float, decisions: int = 1) -> np.ndarray:
    """Return the (n,) rewards of a decision; `advance` is the longest of a gait's cycle, m."""
    if recipe.reward == "eq2":
        return step.reward
    reward = step.progress / advance if recipe.reward == "progress" else np.zeros(len(step.outcome))
    reward = reward - recipe.cycle / decisions
    reward -= recipe.collision * (step.outcome == COLLISION)
    reward += recipe.goal * (step.outcome == SUCCESS)
    return reward


class _RobotsDQN(DQN):
    """DQN whose robots explore each for itself, some more than others.

    stable-baselines3 draws once for all environments whether the whole step is random.
    """

    def __init__(self, *args: Any, explore_range: tuple[float, float], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        low, high = explore_range
        self.exploration = low * (high / low) ** np.linspace(0, 1, self.n_envs)
        self.generator = np.random.default_rng(self.seed)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, Any]:
        with torch.no_grad():
            gaits = self.q_net(torch.from_numpy(observation)).argmax(1).numpy()
        if not deterministic:
            rate = np.maximum(self.exploration, self.exploration_rate)
            random = self.generator.random(len(gaits)) < rate
            choice = self.generator.integers(0, self.q_net.action_space.n, len(gaits))
            gaits = np.where(random, choice, gaits)
        return gaits, state


class _Checkpoints(BaseCallback):
    """Averages the network, evaluates both now and then, keeps the best on held-out scenes and targets."""

    def __init__(
        self,
        surrogate: Surrogate,
        navigation: Navigation,
        seed: int,
        recipe: Recipe,
        seconds: float,
        progress: Progress,
    ) -> None:
        super().__init__()
        self.surrogate, self.navigation, self.seed = surrogate, navigation, seed
        self.recipe, self.progress = recipe, progress
        self.senses = Senses(surrogate, navigation)
        self.deadline = time.perf_counter() + seconds
        batch = SceneBatch.join(
            [
                validation_targets(navigation, recipe.targets, seed),
                validation_scenes(navigation, recipe.standing, seed),
                *(
                    validation_scenes(navigation, recipe.moving // 2, seed + 1 + i, speed)
                    for i, speed in enumerate(np.array([0.5, 1.0]) * recipe.fastest)
                    if not navigation.scenes  # there, all obstacles stand
                ),
            ]
        )
        # one that arrives does so early: half of the time tells as much
        self.batch = replace(batch, max_cycles=navigation.max_cycles // 2)
        self.curves: dict[str, list[float]] = {}
        self.best: QNetwork | None = None
        self.best_score = -2.0
        self.due = recipe.transitions // recipe.checkpoints

    def _on_training_start(self) -> None:
        assert isinstance(self.model, DQN)
        self.averaged = copy.deepcopy(self.model.q_net)
        self.evaluate()  # the curves begin where the training does

    def _on_step(self) -> bool:
        assert isinstance(self.model, DQN)
        with torch.no_grad():
            torch._foreach_lerp_(
                list(self.averaged.parameters()),
                list(self.model.q_net.parameters()),
                1 - self.recipe.averaging,
            )
        if self.num_timesteps >= self.due:
            self.due += self.recipe.transitions // self.recipe.checkpoints
            self.evaluate()
            done = min(self.num_timesteps / self.recipe.transitions, 1.0)
            self.progress(f"training, best score {self.best_score:.2f} of 2", done)
        return time.perf_counter() < self.deadline

    def evaluate(self) -> None:
        """Add a checkpoint to the curves; keep a network that beats all before."""
        assert isinstance(self.model, DQN)
        runs, score = self._run(network := _network(self.model.q_net))
        _, averaged_score = self._run(averaged := _network(self.averaged))
        parts = np.cumsum([self.recipe.targets, self.recipe.standing])
        k2, standing, moving = np.split(runs.outcome == SUCCESS, parts)
        reward = runs.reward[: self.recipe.targets]
        row = {
            "transitions": self.num_timesteps,
            "k2_reward_mean": reward.mean(),
            "k2_reward_min": reward.min(),
            "k2_reward_max": reward.max(),
            "k2_success": k2.mean(),
            "novel_success": standing.mean(),
            **({"moving_success": moving.mean()} if len(moving) else {}),
            "validation_score": score,
            "validation_score_averaged": averaged_score,
        }
        for name, value in row.items():
            self.curves.setdefault(name, []).append(float(value))
        for candidate, result in ((network, score), (averaged, averaged_score)):
            if result >= self.best_score:  # later is better trained
                self.best, self.best_score = candidate, result

    def _run(self, network: QNetwork) -> tuple[SurrogateRuns, float]:
        generator = np.random.default_rng(self.seed)
        env = SurrogateEnv(
            self.surrogate, self.navigation, self.batch, None, generator, self.recipe.noise
        )
        runs = run_all(env, lambda sight, _: network(self.senses(*sight)).argmax(1))
        targets, others = np.split(runs.outcome, [self.recipe.targets])
        # the shield mends collisions, but no time-outs
        score = (
            (others == SUCCESS).mean() - (others == TIMEOUT).mean() + (targets == SUCCESS).mean()
        )
        return runs, float(score)


class _SeeingBeams(BaseFeaturesExtractor):
    """The paper's CNN over the proximities of the beams; the other features as they are."""

    def __init__(self, space: gymnasium.spaces.Box, navigation: Navigation) -> None:
        laser_of(navigation)  # it looks at beams
        self.beams = navigation.beams
        super().__init__(space, space.shape[0] - self.beams + FEATURES)
        self.cnn = LaserCnn(self.beams, navigation.space, navigation.laser_range)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        seen = self.cnn.see(features[:, : self.beams])
        return torch.cat([seen, features[:, self.beams :]], 1)


def _network(q_net: Any) -> QNetwork:
    """Return the NumPy copy of a stable-baselines3 Q network."""
    seeing = q_net.features_extractor
    layers: Sequence[Any] = [m for m in q_net.q_net if isinstance(m, torch.nn.Linear)]
    return QNetwork(
        tuple(layer.weight.detach().numpy().copy() for layer in layers),
        tuple(layer.bias.detach().numpy().copy() for layer in layers),
        seeing.cnn.frozen() if isinstance(seeing, _SeeingBeams) else None,
    )
