"""Planner `dql-paper`: deep Q-learning exactly as the paper describes it (section V), in PyTorch.

The training is in `dql_paper_training.py`. What the paper leaves open, and what is chosen here, is
listed in docs/planning.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defplan_mj import files
from defplan_mj.errors import DefplanError
from defplan_mj.planning.planner import Observation, Planner, TrainResult
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation, Progress, no_progress

if TYPE_CHECKING:
    from defplan_solvers.dql_paper_training import PaperNetwork

FORMAT_VERSION = 1


@dataclass(frozen=True)
class PaperConfiguration:
    """The paper's figures; where it has none, the choice is marked.

    Attributes:
        iterations: of DQL (section V: 10^4).
        cycles: of each of the K2 trajectories of an iteration (Table II: N2 = 200 cycles).
        memory: iterations whose transitions are kept (Table II: 10).
        batch: section V.
        updates: of the network in an iteration (choice: each transition is drawn once on average).
        learning_rate, discount: choice.
        explore_first, explore_last: share of random gaits, falling over the training (choice).
        hidden: section IV-B.
        pretraining, pretraining_batch, pretraining_rate: steps of the CNN's supervised training,
            robots that see a new scan in each, and the learning rate (choice).
        checkpoints: evaluations during training, for the curves.
        novel: novel scenes of an evaluation.
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
        laser_range: m.
        meta: how it was trained.
    """

    def __init__(
        self, network: PaperNetwork, task_names: tuple[str, ...], laser_range: float, meta: dict
    ) -> None:
        self.network, self.task_names, self.laser_range = network, task_names, laser_range
        self.meta = meta

    def reset(self) -> None:
        """Do nothing: the network has no memory."""

    def values(self, observation: Observation) -> np.ndarray:
        """Return the (K,) Q values."""
        return self.network.values(observation["laser"][None], observation["target"][None, :2])[0]


class DqlPaperSolver:
    """The planner plugin `dql-paper`."""

    kind = "planner"
    name = "dql-paper"
    summary = "deep Q-learning as in the paper: pretrained CNN, RMSProp, raw Eq. 2, fixed K2 scenes"
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
        from defplan_solvers.dql_paper_training import train

        started = time.perf_counter()
        network, curves, meta = train(
            surrogate, navigation, seed, self.configuration, seconds, progress
        )
        planner = DqlPaperPlanner(network, surrogate.task_names, navigation.laser_range, meta)
        return TrainResult(planner, curves, time.perf_counter() - started)

    def save(self, planner: Planner, path: Path) -> None:
        """Write the networks to `path` (npz), atomically."""
        assert isinstance(planner, DqlPaperPlanner)
        arrays = {k: v.numpy() for k, v in planner.network.state_dict().items()}
        meta = {
            "planner": self.name,
            "task_names": list(planner.task_names),
            "beams": planner.network.beams,
            "laser_range": planner.laser_range,
            "hidden": list(planner.network.hidden),
            "training": planner.meta,
        }
        files.save_archive(path, "policy", FORMAT_VERSION, arrays, meta)

    def load(self, path: Path, surrogate: Surrogate, navigation: Navigation) -> DqlPaperPlanner:
        """Read networks of `save`.

        Raises:
            DefplanError: the file is missing, damaged, of another version, planner or robot.
        """
        import torch

        from defplan_solvers.dql_paper_training import PaperNetwork

        arrays, meta, _ = files.load_archive(path, "policy", FORMAT_VERSION)
        if meta.get("planner") != self.name:
            raise DefplanError(
                f"{path} holds a policy of {meta.get('planner')}, not of {self.name}: train it anew"
            )
        if meta["beams"] != navigation.beams or tuple(meta["task_names"]) != surrogate.task_names:
            raise DefplanError(
                f"{path} was trained for {meta['beams']} beams and the gaits"
                f" {', '.join(meta['task_names'])}: train the planner anew for this task"
            )
        network = PaperNetwork(
            navigation.beams, meta["laser_range"], len(surrogate.task_names), tuple(meta["hidden"])
        )
        network.load_state_dict({k: torch.from_numpy(v) for k, v in arrays.items()})
        return DqlPaperPlanner(network, surrogate.task_names, meta["laser_range"], meta["training"])


SOLVER = DqlPaperSolver()
