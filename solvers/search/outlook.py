"""How many gait cycles the way to a target takes if nothing is in it: an estimate for searches."""

from __future__ import annotations

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.planning.surrogate import Motions

LEAST_TURN = 0.1  # a gait that turns the robot by less than this does not steer, rad
NEARLY = 0.7  # gaits that come this far, as a share of the farthest, count as ways to advance


class Outlook:
    """Gait cycles to a target in free space: the distance at full advance, and the turning before it.

    A turn costs its cycles less the way they make meanwhile: little for a fish that swims a curve,
    all of it for a robot that turns in its place, nothing for one that walks to every side alike. Within
    a cycle a body swings to and fro: where it goes is told in its frame at each phase.

    Args:
        motions: of a whole cycle of each gait, (K, ...); or (m, K, ...) of one that begins at each phase.
        goal_radius: distance from the target that is near enough, m.

    Attributes:
        motions: (K, ...) at the start of a cycle.
        advance: the longest way of a cycle, m.
        per_radian: cycles that a turn of a radian costs.
        axes: (a, d) unit vectors along which gaits advance, in the robot's frame at the start of a cycle.
        axes_at: (m, a, d) the same at each phase.
    """

    def __init__(self, motions: Motions, goal_radius: float) -> None:
        if motions.translations.ndim == 2:
            motions = Motions(*(part[None] for part in motions))
        self.by_phase, self.goal_radius = motions, goal_radius
        self.motions = motions = motions.of(0)
        lengths = np.linalg.norm(motions.translations, axis=1)
        self.advance = max(float(lengths.max()), 1e-9)
        forth = lengths >= NEARLY * self.advance
        self.axes_at = np.array([_directions(ways[forth]) for ways in self.by_phase.translations])
        self.axes = self.axes_at[0]
        angle = rotations.angle(motions.rotations)
        cost = (1 - lengths / self.advance) / np.maximum(angle, 1e-9)
        self.per_radian = float(cost[angle > LEAST_TURN].min(initial=np.inf))
        if not np.isfinite(self.per_radian):
            self.per_radian = 0.0

    def cycles(self, offset: np.ndarray, phase: int = 0) -> np.ndarray:
        """Return the cycles (...,) to targets at `offset` (..., d), m, in the robot's frame at a phase."""
        distance = np.sqrt(np.einsum("...d,...d->...", offset, offset))
        ahead = (offset @ self.axes_at[phase].T).max(-1) / np.maximum(distance, 1e-9)
        turn = np.arccos(np.clip(ahead, -1, 1))
        rest = np.maximum(distance - self.goal_radius, 0)
        return rest / self.advance + np.where(rest > 0, self.per_radian * turn, 0)

    def after_each(self, offset: np.ndarray, phase: int = 0) -> np.ndarray:
        """Return the cycles (..., K) that are left after one whole cycle of each gait."""
        rotations, translations = self.by_phase.of(phase)
        ends = np.einsum("kij,...ki->...kj", rotations, offset[..., None, :] - translations)
        return self.cycles(ends, phase)


def _directions(ways: np.ndarray) -> np.ndarray:
    return ways / np.maximum(np.linalg.norm(ways, axis=1), 1e-9)[:, None]
