"""The robot: one body with its gaits, what it walks on and the feedback that plays them."""

from __future__ import annotations

import json
from dataclasses import dataclass

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain, terrain_json
from defplan_mj.feedback import Feedback, FeedbackSolver
from defplan_mj.gait.gait import Gait


@dataclass(frozen=True, eq=False)
class Robot:
    """What is steered; picklable, as plain as its parts.

    Attributes:
        body, gait: of each other.
        world: what it walks on; None: it swims.
        feedback: plays the gaits; None: open loop.
    """

    body: Body
    gait: Gait
    world: Terrain | None = None
    feedback: FeedbackSolver | None = None

    @property
    def dynamics(self) -> ReducedDynamics:
        """The reduced dynamics at the gait's time step."""
        return ReducedDynamics(self.body, self.gait.timestep, self.world, **self.gait.stepping)

    @property
    def identity(self) -> tuple[str, ...]:
        """What tells it from another robot."""
        ground = "" if self.world is None else json.dumps(terrain_json(self.world))
        return self.body.hash, self.gait.hash, repr(self.feedback), ground

    def prepared(self, space: str) -> Feedback | None:
        """Return the feedback for navigation in `space`; None: open loop."""
        if self.feedback is None:
            return None
        return self.feedback.prepare(self.dynamics, self.gait, space)
