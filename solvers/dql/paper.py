"""Planner `dql-paper`: deep Q-learning exactly as the paper describes it (section V), in PyTorch.

The training is in `paper_training.py`. What the paper leaves open, and what is chosen here, is
listed in docs/planning.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.planning.planner import Observation, Planner, TrainResult
from defplan_mj.planning.surrogate import Surrogate, check_whole_cycles
from defplan_mj.task import Navigation
from defplan_solvers.policy_files import load_policy, save_policy

_MOST_LAYERS, _MOST_UNITS = 16, 2048  # of a network that is read

if TYPE_CHECKING:
    from defplan_solvers.dql.paper_training import PaperNetwork


@dataclass(frozen=True)
class PaperConfiguration:
    """The paper's figures; where it has none, the choice is marked.

    Attributes:
        iterations: of DQL (section V: 10^4).
        cycles: of each trajectory to a training target in an iteration (Table II: N2 = 200 cycles).
        memory: iterations whose transitions are kept (Table II: 10).
        batch: section V.
        updates: of the network in an iteration (choice: each transition is drawn once on average).
        learning_rate, discount: choice.
        explore_first, explore_last: share of random gaits, falling over the training (choice).
        hidden: section IV-B.
        pretraining, pretraining_batch, pretraining_rate: steps of the CNN's supervised training,
            robots that see a new scan in each, and the learning rate (choice).
        checkpoints: evaluations during training, for the curves.
        novel: unseen scenes of an evaluation.
    """

    iterations: int = 10_000
    cycles: int = 200
    memory: int = 10
    batch: int = 32
    updates: int = 62
    learning_rate: float = 1e-3
    discount: float = 0.95
    explore_first: float = 0.5
    explore_last: float = 0.05
    hidden: tuple[int, ...] = (64, 64, 64)
    pretraining: int = 2000
    pretraining_batch: int = 256
    pretraining_rate: float = 1e-3
    checkpoints: int = 40
    novel: int = 100


class DqlPaperPlanner:
    """The paper's network as a planner.

    Args:
        network: CNN and Q network.
        task_names: the gaits.
        meta: how it was trained.
    """

    def __init__(self, network: PaperNetwork, task_names: tuple[str, ...], meta: dict) -> None:
        self.network, self.task_names, self.meta = network, task_names, meta

    def reset(self) -> None:
        """Do nothing: the network has no memory."""

    def values(self, observation: Observation) -> np.ndarray:
        """Return the (K,) Q values."""
        target = observation["target"][: self.network.dimension]
        return self.network.values(observation["laser"][None], target[None])[0]


class DqlPaperSolver:
    """The planner plugin `dql-paper`."""

    kind = "planner"
    name = "dql-paper"
    summary = "deep Q-learning as in the paper: pretrained CNN, RMSProp, raw Eq. 2, fixed training targets"
    needs_training = True

    def __init__(self, configuration: PaperConfiguration = PaperConfiguration()) -> None:
        self.configuration = configuration

    def train(
        self,
        surrogate: Surrogate,
        navigation: Navigation,
        seed: int,
        seconds: float | None = None,
        progress: Progress = no_progress,
    ) -> TrainResult:
        """Train the CNN, then the Q network; the same seed gives the same networks to the bit.

        Curves as those of planner `dql`, without the held-out scenes: the last network is kept.

        Args:
            seconds: stop after this wall time (default: when all iterations are done).
        """
        from defplan_solvers.dql.paper_training import train

        check_whole_cycles(self.name, navigation)
        started = time.perf_counter()
        network, curves, meta = train(
            surrogate, navigation, seed, self.configuration, seconds, progress
        )
        planner = DqlPaperPlanner(network, surrogate.task_names, meta)
        spent = time.perf_counter() - started
        cut_short = meta["iterations"] < self.configuration.iterations
        return TrainResult(planner, curves, spent, cut_short)

    def save(self, planner: Planner, path: Path) -> None:
        """Write the networks to `path` (npz), atomically."""
        assert isinstance(planner, DqlPaperPlanner)
        arrays = {k: v.numpy() for k, v in planner.network.state_dict().items()}
        network = planner.network
        meta = {
            "task_names": list(planner.task_names),
            "beams": network.beams,
            "space": network.space,
            "laser_range": network.laser_range,
            "hidden": list(network.hidden),
            "training": planner.meta,
        }
        save_policy(path, self.name, arrays, meta)

    def load(self, path: Path, surrogate: Surrogate, navigation: Navigation) -> DqlPaperPlanner:
        """Read networks of `save`.

        Raises:
            DefplanError: the file is missing, damaged, of another version, planner or robot.
        """
        import torch

        from defplan_solvers.dql.paper_training import PaperNetwork

        check_whole_cycles(self.name, navigation)
        arrays, meta = load_policy(path, self.name, surrogate.task_names)
        with files.fields_of(path, "policy"):
            if (meta["beams"], meta["space"]) != (navigation.beams, navigation.space):
                raise DefplanError(
                    f"{path} was trained for {meta['beams']} beams in {meta['space']} scenes, not for"
                    f" {navigation.beams} in {navigation.space} ones: train the planner anew"
                )
            hidden, reach = tuple(meta["hidden"]), float(meta["laser_range"])
            # before layers are made for them
            if len(hidden) > _MOST_LAYERS or not all(
                isinstance(n, int) and 0 < n <= _MOST_UNITS for n in hidden
            ):
                raise ValueError(f"hidden can be {_MOST_LAYERS} layers of {_MOST_UNITS} units")
            if not 0.0 < reach < float("inf"):
                raise ValueError("laser_range must be positive")
            trained = replace(navigation, laser_range=reach)
            network = PaperNetwork(trained, len(surrogate.task_names), hidden)
            try:
                network.load_state_dict({k: torch.from_numpy(v) for k, v in arrays.items()})
            except RuntimeError as error:
                raise ValueError("its arrays do not fit its layers") from error
            return DqlPaperPlanner(network, surrogate.task_names, dict(meta["training"]))


SOLVER = DqlPaperSolver()
