"""Feedback `none`: the gait is played as it is, whatever the body does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from defplan_mj.base.space import PLANE
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.feedback import OpenLoop
from defplan_mj.gait.gait import Gait


@dataclass(frozen=True)
class OpenLoopSolver:
    """The plugin."""

    kind: ClassVar = "feedback"
    name: ClassVar = "none"
    summary: ClassVar = "no feedback: gaits are played in open loop"
    default: ClassVar = True

    def prepare(self, dynamics: ReducedDynamics, gait: Gait, space: str = PLANE.name) -> OpenLoop:
        """Return what plays the gait's table."""
        return OpenLoop(gait)


SOLVER = OpenLoopSolver()
