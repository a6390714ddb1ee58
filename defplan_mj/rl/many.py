"""Many robots at once for Gymnasium, stepped by the kernel's threads without MuJoCo: same episodes, faster."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from defplan_mj import suite
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.batch import Batch
from defplan_mj.rl.single import action_space, check_shapes, flat_space


class KernelVectorEnv(gymnasium.vector.VectorEnv):
    """n robots of a task whose actions are target shapes.

    Robot i of seed s plays the episodes of `SuiteEnv` with seed s + i. An episode that is over begins
    anew with the next step, whose action does not count (Gymnasium's NEXT_STEP).
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        domain: str,
        task: str,
        num_envs: int = 1,
        render_mode: str | None = None,
        task_kwargs: dict[str, Any] | None = None,
        workers: int | None = None,
    ) -> None:
        """Load the task once and take its body, its rewards and its time limit.

        Args:
            num_envs: n.
            render_mode: None, since there is no scene.
            workers: threads; by default one a core. Results do not depend on it.
        """
        if render_mode is not None:
            raise DefplanError("the vector environment has no pictures: make one environment")
        kwargs = task_kwargs or {}
        env = suite.load(domain, task, {"random": 0, **kwargs})
        self._task, self._place = env.task, env.physics.place
        self._dynamics = env.task.dynamics
        self._limit = env.task.time_limit / env.control_timestep()
        self.num_envs = num_envs
        self.metadata = {**self.metadata, "render_fps": round(1 / env.control_timestep())}
        self.single_observation_space = flat_space(env.observation_spec())
        self.single_action_space = action_space(env.action_spec())
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._batch = Batch(self._dynamics, num_envs, workers)
        self._targets = np.zeros((num_envs, 3))
        self._steps, self._over = np.zeros(num_envs, int), np.ones(num_envs, bool)
        self._random = [np.random.RandomState(i) for i in range(num_envs)]
        env.close()

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode of each robot; with a seed s robot i draws from s + i."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is not None:
            seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
            if len(seeds) != self.num_envs:
                raise DefplanError(f"{len(seeds)} seeds for {self.num_envs} robots")
            self._random = [np.random.RandomState(each) for each in seeds]
        self._begin(np.arange(self.num_envs))
        return self._observations(), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take the target shapes (n, r), in [-1, 1] of the amplitude; rewards, ends (n,) as Gymnasium has them."""
        n, modes = self.num_envs, self._dynamics.body.n_modes
        shapes = check_shapes(np.asarray(actions), (n, modes)) * self._dynamics.body.amplitude
        anew = np.flatnonzero(self._over)
        self._batch.step(shapes)
        self._begin(anew)
        states = self._batch.states
        rewards = self._task.rewards(states, self._targets, self._place)
        rewards[anew] = 0.0
        lost = self._batch.failed.astype(bool)
        lost[anew] = False
        self._steps += 1
        self._steps[anew] = 0
        late = (self._steps >= self._limit) & ~lost
        self._over = lost | late
        return self._observations(), rewards, lost, late, {}

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        self._batch.close()

    def _begin(self, robots: np.ndarray) -> None:
        """Draw the start of an episode of each of `robots`."""
        modes = self._dynamics.body.n_modes
        for i in robots:
            self._targets[i], self._batch.states[i] = self._task.draw(
                self._random[i], self._place, modes
            )
        self._steps[robots], self._over[robots] = 0, False

    def _observations(self) -> np.ndarray:
        arrays = self._task.observe(self._batch.states, self._targets, self._place)
        return np.concatenate(list(arrays.values()), axis=1)
