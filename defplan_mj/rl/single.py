"""One environment of the suite for Gymnasium: MuJoCo's scene, flat observations, pictures."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from dm_env import specs

from defplan_mj import suite
from defplan_mj.base.errors import DefplanError

_SIZE = (480, 640)  # of a picture: height, width
_LARGEST_ACTION = 1.0 + 1e-6  # of a target shape, in amplitudes: rounding is no mistake


class SuiteEnv(gymnasium.Env):
    """A task of the suite. Observations are flat, in the order that docs/gymnasium.md tells."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(
        self,
        domain: str,
        task: str,
        render_mode: str | None = None,
        task_kwargs: dict[str, Any] | None = None,
    ) -> None:
        """Load `suite.load(domain, task, task_kwargs)`."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise DefplanError(f"render_mode is {render_mode}, there is: rgb_array")
        self.render_mode = render_mode
        self._env = suite.load(domain, task, {"random": 0, **(task_kwargs or {})})
        fps = round(1 / self._env.control_timestep())
        self.metadata = {**self.metadata, "render_fps": max(fps, 1)}
        self.observation_space = flat_space(self._env.observation_spec())
        self.action_space = action_space(self._env.action_spec())

    @property
    def suite_environment(self) -> Any:
        """dm_control's environment inside."""
        return self._env

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; with a seed all that follows is drawn from it."""
        super().reset(seed=seed)
        if seed is not None:
            self._env.task.random.seed(seed)
        return flat(self._env.reset().observation), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take an action: a target shape in [-1, 1] of the amplitude (r,), or the number of a gait."""
        step = self._env.step(check_action(self.action_space, action))
        over = step.last() and step.discount == 0
        return flat(step.observation), float(step.reward), over, step.last() and not over, {}

    def render(self) -> np.ndarray | None:
        """Return the picture (480, 640, 3) that the robot's camera sees."""
        if self.render_mode is None:
            return None
        return self._env.physics.render(*_SIZE, camera_id=0)

    def close(self) -> None:
        """Free the scene."""
        self._env.close()


def flat(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Return an observation's arrays one behind the other."""
    return np.concatenate([np.ravel(array) for array in observation.values()])


def flat_space(spec: dict[str, specs.Array]) -> gymnasium.spaces.Box:
    """Return the space of flat observations: unbounded, float64."""
    size = sum(int(np.prod(part.shape)) for part in spec.values())
    return gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)


def action_space(spec: specs.Array) -> gymnasium.Space:
    """Return the space of actions: gaits by number, or target shapes in [-1, 1] of the amplitude."""
    if isinstance(spec, specs.DiscreteArray):
        return gymnasium.spaces.Discrete(int(spec.num_values))
    return gymnasium.spaces.Box(-1.0, 1.0, spec.shape, np.float64)


def check_action(space: gymnasium.Space, action: Any) -> Any:
    """Return the action as the suite takes it.

    Raises:
        DefplanError: it is none of the space.
    """
    if isinstance(space, gymnasium.spaces.Discrete):
        array = np.asarray(action)
        if array.shape != () or array.dtype.kind not in "iu" or not 0 <= array < space.n:
            raise DefplanError(f"the action is {action}, it must be a gait: 0 to {space.n - 1}")
        return int(array)
    return check_shapes(np.asarray(action), space.shape or ())


def check_shapes(action: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return target shapes in units of the amplitude, float64; raises DefplanError if they are none."""
    if action.shape != shape or action.dtype.kind not in "fiu":
        raise DefplanError(
            f"the action has shape {action.shape} of {action.dtype}, it must be {shape} numbers"
        )
    # not `> 1`: NaN is no action either
    if not np.all(np.abs(action) <= _LARGEST_ACTION):
        worst = action.flat[np.argmax(np.nan_to_num(np.abs(action), nan=np.inf))]
        raise DefplanError(f"an action is {worst}: target shapes are -1 to 1 of the amplitude")
    return np.clip(action.astype(np.float64), -1.0, 1.0)
