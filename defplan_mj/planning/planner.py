"""What a planner is, and what a planner plugin has to offer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from defplan_mj.base.progress import Progress
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

Observation = Mapping[str, np.ndarray]
"""'laser' (beams,) m; 'target' (3,) m, of which the first d count; 'state' reduced state. All in the
robot's frame: the yaw frame of planar tasks (d = 2), the body frame of those in space (d = 3). In the
shield there is 'safe' (K,), too: which gaits it lets pass; the planner's best of these is done; and
'drift' (p, d): how far the reading's points move in a cycle, m (`planning.tracking`). A planner that says
`needs_obstacles = True` is also told 'obstacles' (`host.navigation.true_obstacles`): a bound or a peer, which
knows what a robot cannot know."""


def carried_out(values: np.ndarray, observation: Observation) -> int:
    """Return which gait is done if a planner gives these values (K,): the best, or the best safe one."""
    safe = observation.get("safe")
    return int(np.argmax(values if safe is None else np.where(safe, values, -np.inf)))


def needs_obstacles(planner: Planner) -> bool:
    """Return whether a planner is to be told all obstacles: it says so by `needs_obstacles = True`.

    Its observations then have 'obstacles' (n, 2 d + 1): centres in the robot's frame, radii, and how far they
    move in a cycle, m, as they truly are. That is no robot that only senses: such planners are peers and
    bounds for those that do.
    """
    return bool(getattr(planner, "needs_obstacles", False))


class Planner(Protocol):
    """What drives one robot: values each gait at every cycle; the largest value is chosen."""

    def reset(self) -> None:
        """Forget the past: a new episode begins."""

    def values(self, observation: Observation) -> np.ndarray:
        """Return the (K,) value of each gait in the present observation."""


@dataclass(frozen=True)
class TrainResult:
    """A planner and how it came about.

    Attributes:
        planner: ready for use.
        curves: arrays of equal length by name, for the report's training curves (Fig. 5).
        seconds: wall time of the training, s.
        cut_short: whether the limit of the wall time ended it before its budget was used up.
    """

    planner: Planner
    curves: dict[str, np.ndarray] = field(default_factory=dict)
    seconds: float = 0.0
    cut_short: bool = False


class PlannerSolver(Protocol):
    """A planner plugin (entry point group `defplan_mj.solvers`).

    Attributes:
        kind: 'planner'.
        name: of the plugin.
        summary: one line for `defplan list`.
        needs_training: False if `train` costs nothing.
    """

    kind: str
    name: str
    summary: str
    needs_training: bool

    def train(
        self,
        surrogate: Surrogate,
        navigation: Navigation,
        seed: int,
        seconds: float | None = None,
        progress: Progress = ...,
    ) -> TrainResult:
        """Train a planner for the surrogate.

        Args:
            seconds: limit of the wall time; None: none, so that the same seed gives the same planner
                on any machine. A result that it cut short says so (`TrainResult.cut_short`).
        """

    def save(self, planner: Planner, path: Path) -> None:
        """Write the planner to `path`, atomically and without pickle."""

    def load(self, path: Path, surrogate: Surrogate, navigation: Navigation) -> Planner:
        """Read a planner of `save`.

        Raises:
            DefplanError: the file is missing, damaged, of another version or of another robot.
        """
