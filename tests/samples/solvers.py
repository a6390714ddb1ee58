"""Plugins that take no time: gaits that are a wave or fail, a planner that never turns."""

from __future__ import annotations

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import no_progress
from defplan_mj.gait.gait import Gait
from defplan_mj.planning.planner import TrainResult


class Wave:
    """A gait solver that optimises nothing: a travelling wave with a bend to either side."""

    kind = "gait"
    summary = "a wave"

    def __init__(self, name="wave"):
        self.name = name
        self.calls = 0

    def solve(self, problem, seed, progress=no_progress):
        self.calls += 1
        progress("gait: waving", 0.5)
        body = problem.dynamics.body
        alpha = np.zeros((3, problem.elements, body.n_modes))
        alpha[:, 0, :2] = 0.2 * body.amplitude[:2]
        alpha[:, 1, 0] = 0.3 * np.array([0.0, 1.0, -1.0]) * body.amplitude[0]
        beta = np.zeros_like(alpha)
        beta[:, 0] = 1.0
        mu = np.zeros((problem.elements, body.n_modes))
        mu[0, 1] = np.pi / 2
        return Gait(
            body_hash=body.hash,
            task_names=tuple(task.name for task in problem.tasks),
            timestep=problem.dynamics.timestep,
            steps_per_cycle=problem.steps_per_cycle,
            alpha=alpha,
            beta=beta,
            mu=mu,
            amplitude=body.amplitude,
            meta={"solver": self.name, "seed": seed},
        )


class Lame(Wave):
    """A gait solver that fails."""

    def solve(self, problem, seed, progress=no_progress):
        raise DefplanError("it cannot walk")


class Straight:
    """A planner that always takes the first gait."""

    def reset(self):
        pass

    def values(self, observation):
        return np.array([1.0, 0.0, 0.0])


class Stubborn:
    """The plugin of `Straight`."""

    kind = "planner"
    name = "stubborn"
    summary = "never turns"
    needs_training = False

    def __init__(self):
        self.calls = 0

    def train(self, surrogate, navigation, seed, seconds=None, progress=no_progress):
        self.calls += 1
        return TrainResult(Straight(), {"iterations": np.arange(3.0)}, 0.0)

    def save(self, planner, path):
        files.save_archive(path, "stubborn", 1, {}, {})

    def load(self, path, surrogate, navigation):
        files.load_archive(path, "stubborn", 1)
        return Straight()
