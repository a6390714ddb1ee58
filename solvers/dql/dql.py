"""Planner `dql`: deep Q-learning on the rigid surrogate; acts by a small network in plain NumPy.

The recipe is in `training.py`, which is imported only to train: acting needs no torch.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.planning.observation import Senses
from defplan_mj.planning.planner import Observation, Planner, TrainResult, carried_out
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.tracking import Tracker
from defplan_mj.task import Navigation
from defplan_solvers.dql.beams import FEATURES, BeamFilters, softplus
from defplan_solvers.policy_files import load_policy, save_policy
from defplan_solvers.search.loops import LoopBreaker


@dataclass(frozen=True)
class QNetwork:
    """A fully connected network with softplus units (the paper's BNLL): features to gait values.

    Attributes:
        weights: of each layer, (outputs, inputs).
        biases: of each layer, (outputs,).
        beams: what sees the proximities of the beams, which the features begin with; None: the first layer.
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    beams: BeamFilters | None = None

    @property
    def inputs(self) -> int:
        """How many features it takes."""
        first = self.weights[0].shape[1]
        return first if self.beams is None else first - FEATURES + self.beams.count

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Return the (..., K) values of (..., inputs) features."""
        hidden = inputs
        if self.beams is not None:
            flat, n = inputs.reshape(-1, inputs.shape[-1]), self.beams.count
            hidden = np.hstack([self.beams(flat[:, :n]), flat[:, n:]])
            hidden = hidden.reshape(*inputs.shape[:-1], -1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = softplus(hidden @ weight.T + bias)
        return hidden @ self.weights[-1].T + self.biases[-1]


class DqlPlanner:
    """A trained Q network as a planner.

    Args:
        network: values of the gaits.
        surrogate: of the robot.
        navigation: for the laser and the space.
        meta: how the network was trained.
    """

    def __init__(
        self, network: QNetwork, surrogate: Surrogate, navigation: Navigation, meta: dict
    ) -> None:
        self.network, self.meta = network, meta
        self.task_names, self.navigation = surrogate.task_names, navigation
        self.senses = Senses(surrogate, navigation)
        self.loops = LoopBreaker(surrogate, navigation)
        self.tracker = Tracker(surrogate, navigation)

    def reset(self) -> None:
        """Forget the episode."""
        self.loops.reset()
        self.tracker.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return the (K,) Q values, lowered where they would lead round in circles."""
        laser, target = observation["laser"], observation["target"][: self.navigation.dimension]
        drift = observation.get("drift")  # the shield's tracker has seen the same
        if drift is None:
            drift = self.tracker.update(laser, target).drift_of_all
        inputs = self.senses(laser, target, self.loops.odometry.past, drift)
        values = self.loops.adjust(self.network(inputs), target, observation)
        self.tracker.chose(carried_out(values, observation))
        return values


class DqlSolver:
    """The planner plugins `dql` and `dql-cnn`.

    Args:
        convolutions: the paper's CNN sees the beams, trained with all else, end to end.
    """

    kind = "planner"
    needs_training = True

    def __init__(self, name: str, summary: str, convolutions: bool = False) -> None:
        self.name, self.summary, self.convolutions = name, summary, convolutions
        self.default = not convolutions

    def train(
        self,
        surrogate: Surrogate,
        navigation: Navigation,
        seed: int,
        seconds: float | None = None,
        progress: Progress = no_progress,
    ) -> TrainResult:
        """Train a network; the same seed gives the same network to the bit.

        Curves, one entry a checkpoint: `transitions`; `k2_reward_mean`, `_min`, `_max` (Eq. 2 over
        an episode) and `k2_success` on the K2 scenes of this seed; `novel_success`;
        `validation_score` and `validation_score_averaged` (success less time-outs on held-out scenes,
        plus success at the training targets), by which the network is chosen.

        Args:
            seconds: limit of the wall time (None: none); reached, the result depends on the machine.
        """
        from defplan_solvers.dql.training import Recipe, train

        started = time.perf_counter()
        limit = float("inf") if seconds is None else seconds
        recipe = Recipe()
        if self.convolutions:  # dearer by as much as these two figures are less
            recipe = Recipe(convolutions=True, transitions=200_000, batch=256)
        network, curves, meta = train(surrogate, navigation, seed, recipe, limit, progress)
        planner = DqlPlanner(network, surrogate, navigation, meta)
        spent = time.perf_counter() - started
        return TrainResult(planner, curves, spent, meta["stopped_early"])

    def save(self, planner: Planner, path: Path) -> None:
        """Write the network to `path` (npz), atomically."""
        assert isinstance(planner, DqlPlanner)
        arrays: dict[str, np.ndarray] = {}
        network = planner.network
        for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
            arrays[f"weight{i}"], arrays[f"bias{i}"] = weight, bias
        if network.beams is not None:
            arrays |= network.beams.arrays()
        meta = {
            "layers": len(network.weights),
            "task_names": list(planner.task_names),
            "laser_range": planner.navigation.laser_range,
            "training": planner.meta,
        }
        save_policy(path, self.name, arrays, meta)

    def load(self, path: Path, surrogate: Surrogate, navigation: Navigation) -> DqlPlanner:
        """Read a network of `save`.

        Raises:
            DefplanError: the file is missing, damaged, of another version, planner or robot.
        """
        arrays, meta = load_policy(path, self.name, surrogate.task_names)
        with files.fields_of(path, "policy"):
            beams = None
            if self.convolutions:
                beams = BeamFilters.take(arrays, navigation)
            network = _network(arrays, meta["layers"], len(surrogate.task_names), beams)
            reach = float(meta["laser_range"])
            if not 0.0 < reach < np.inf:
                raise ValueError("laser_range must be positive")
            trained = replace(navigation, laser_range=reach)
            planner = DqlPlanner(network, surrogate, trained, dict(meta["training"]))
        if network.inputs != planner.senses.size:
            raise DefplanError(
                f"{path} wants {network.inputs} inputs, this task's laser, target and"
                f" gaits give {planner.senses.size}: train the planner anew"
            )
        return planner


def _network(
    arrays: dict[str, np.ndarray], layers: int, gaits: int, beams: BeamFilters | None
) -> QNetwork:
    """Return the network of a file. Raises ValueError or KeyError: its layers do not fit."""
    if len(arrays) != 2 * layers or layers < 1:
        raise ValueError(f"{len(arrays)} arrays are not those of {layers} layers")
    weights = tuple(arrays[f"weight{i}"] for i in range(layers))
    biases = tuple(arrays[f"bias{i}"] for i in range(layers))
    size = weights[0].shape[1]
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1]:
            raise ValueError(f"weight{i} and bias{i} do not fit the layers about them")
        size = len(weight)
    if size != gaits:
        raise ValueError(f"it values {size} gaits, there are {gaits}")
    return QNetwork(weights, biases, beams)


SOLVER = DqlSolver(
    "dql", "deep Q-learning on the surrogate (stable-baselines3), many varied scenes at once"
)
CNN = DqlSolver(
    "dql-cnn", "as dql, with the paper's CNN over the beams, trained end to end", convolutions=True
)
