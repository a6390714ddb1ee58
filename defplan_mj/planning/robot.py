"""The robot: one body with its gaits, the world around it and the feedback that plays the gaits."""

from __future__ import annotations

import json
from dataclasses import dataclass

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.world import World
from defplan_mj.feedback import Feedback, FeedbackSolver
from defplan_mj.gait.gait import Gait


@dataclass(frozen=True, eq=False)
class Robot:
    """What is steered; picklable, as plain as its parts.

    Attributes:
        body, gait: of each other.
        world: what surrounds it; of the medium that the body was made for.
        feedback: plays the gaits; None: open loop.
    """

    body: Body
    gait: Gait
    world: World
    feedback: FeedbackSolver | None = None

    def __post_init__(self) -> None:
        if self.world.medium != self.body.medium:
            raise DefplanError(
                f"the body {self.body.name} was made for another medium ({self.body.medium}) than its"
                f" world's ({self.world.medium}): build it for this one"
            )

    @property
    def dynamics(self) -> ReducedDynamics:
        """The reduced dynamics at the gait's time step."""
        terrain = self.world.terrain
        return ReducedDynamics(self.body, self.gait.timestep, terrain, **self.gait.stepping)

    @property
    def identity(self) -> tuple[str, ...]:
        """What tells it from another robot."""
        ground = json.dumps(self.world.terrain_data) if self.world.walks else ""
        return self.body.hash, self.gait.hash, repr(self.feedback), ground

    def prepared(self, space: str) -> Feedback | None:
        """Return the feedback for navigation in `space`; None: open loop."""
        if self.feedback is None:
            return None
        prepared = self.feedback.prepare(self.dynamics, self.gait, space)
        if prepared is None:
            raise DefplanError(
                f"the feedback {self.feedback.name} returns None from prepare: it has to return a"
                " Feedback"
            )
        return prepared
