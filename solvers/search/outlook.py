"""How many gait cycles the way to a target takes if nothing is in it: an estimate for searches."""

from __future__ import annotations

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.planning.surrogate import Motions

LEAST_TURN = 0.1  # a gait that turns the robot by less than this does not steer, rad
NEARLY = 0.7  # gaits that come this far, as a share of the farthest, count as ways to advance


class Outlook:
    """Cycles to a target in free space: the distance at full advance, and the turning before it.

    A turn costs its cycles less the way they make meanwhile: little for a fish that swims a curve,
    all of it for a robot that turns in its place, nothing for one that walks to every side alike.

    Args:
        motions: of the gaits.
        goal_radius: distance from the target that is near enough, m.

    Attributes:
        advance: the longest way of a cycle, m.
        per_radian: cycles that a turn of a radian costs.
        axes: (a, d) unit vectors along which gaits advance, in the robot's frame.
    """

    def __init__(self, motions: Motions, goal_radius: float) -> None:
        self.motions, self.goal_radius = motions, goal_radius
        lengths = np.linalg.norm(motions.translations, axis=1)
        self.advance = max(float(lengths.max()), 1e-9)
        forth = lengths >= NEARLY * self.advance
        self.axes = motions.translations[forth] / np.maximum(lengths[forth], 1e-9)[:, None]
        angle = rotations.angle(motions.rotations)
        cost = (1 - lengths / self.advance) / np.maximum(angle, 1e-9)
        self.per_radian = float(cost[angle > LEAST_TURN].min(initial=np.inf))
        if not np.isfinite(self.per_radian):
            self.per_radian = 0.0

    def cycles(self, offset: np.ndarray) -> np.ndarray:
        """Return the cycles (...,) to targets at `offset` (..., d), m, in the robot's frame."""
        distance = np.sqrt(np.einsum("...d,...d->...", offset, offset))
        ahead = (offset @ self.axes.T).max(-1) / np.maximum(distance, 1e-9)
        turn = np.arccos(np.clip(ahead, -1, 1))
        rest = np.maximum(distance - self.goal_radius, 0)
        return rest / self.advance + np.where(rest > 0, self.per_radian * turn, 0)

    def after_each(self, offset: np.ndarray) -> np.ndarray:
        """Return the cycles (..., K) that are left after one cycle of each gait."""
        rotations, translations = self.motions
        return self.cycles(
            np.einsum("kij,...ki->...kj", rotations, offset[..., None, :] - translations)
        )
