"""The three ways in which a guessed body gets about, and what each brings to its task, in body lengths."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from defplan_mj.body.fidelity import MOST_DISTANCE
from defplan_mj.body.model import Material, Medium
from defplan_mj.body.options import BodyOptions
from defplan_mj.dynamics.world import GROUND
from defplan_mj.gait.trials import ADVANCE, BENT_ADVANCE, BENT_STEP, STEP, STEP_TURN, TILT, TURN
from defplan_mj.task import GaitTask, Navigation, Weights
from defplan_mj.taskfile.rhythm import Rhythm

Axis = tuple[float, float, float]
_MOVED = 0.01  # a fish's tail fin moves 1.4% of it, a cow's ears, horns and tail .2 to .6%
_STILL = (0.0, 0.0, 0.0)
GAIT_CYCLES = 8  # that gaits are judged by: half of what the shipped swimmers have


@dataclass(frozen=True)
class Kind:
    """How a body gets about.

    Attributes:
        does: as a sentence says it.
        walks: it stands on the ground.
        bends: it swims by bending sideways as a whole, and gets as many modes as that takes.
        body: how it is built: about as the body of the shipped task.
        rhythm: its time step and cycle.
        gaits: (length, m; own axis) to what its gaits should do.
        more: so many times what a short trial reached is wanted; of a walker no more, or it falls.
        weights: of the gaits, for a body of 1 m.
        navigation: for a body of 1 m.
    """

    does: str
    walks: bool
    bends: bool
    body: BodyOptions
    rhythm: Rhythm
    gaits: Callable[[float, Axis], tuple[GaitTask, ...]]
    more: float
    weights: Weights
    navigation: Navigation

    def weights_of(self, length: float) -> Weights:
        """Return the weights for a body of `length`, m."""
        usual = self.weights
        per_square = {n: getattr(usual, n) / length**2 for n in ("move", "drift", "sink")}
        return dataclasses.replace(usual, slip=usual.slip / length, **per_square)

    def navigation_of(self, length: float) -> Navigation:
        """Return the navigation problem for a body of `length`, m."""
        names = ("distance", "goal_radius", "laser_range")
        lengths = {n: length * getattr(self.navigation, n) for n in names}
        return dataclasses.replace(self.navigation, **lengths)


def triple(vector: np.ndarray) -> Axis:
    """Return a vector (3,) as a task has it, in nine digits."""
    x, y, z = (float(value) + 0.0 for value in np.round(vector, 9))
    return x, y, z


def _swims_ahead(length: float, axis: Axis) -> tuple[GaitTask, ...]:
    return _straight_and_bent(ADVANCE * length, TURN, BENT_ADVANCE * length)


def _walks_ahead(length: float, axis: Axis) -> tuple[GaitTask, ...]:
    return _straight_and_bent(STEP * length, STEP_TURN, BENT_STEP * length)


def _straight_and_bent(ahead: float, turn: float, bent: float) -> tuple[GaitTask, ...]:
    """Return forward, and left and right with a turn (rad), by how far (m)."""
    sides = {"left": turn, "right": -turn}
    turns = (GaitTask(n, turn=(0.0, 0.0, t), move=(bent, 0.0, 0.0)) for n, t in sides.items())
    return (GaitTask("forward", move=(ahead, 0.0, 0.0)), *turns)


def _tilts(length: float, axis: Axis) -> tuple[GaitTask, ...]:
    """Return tilts of the own axis to four sides, and forward along it."""
    own = np.array(axis)
    first = np.array([1.0, 0.0, 0.0]) if abs(own[0]) < 0.5 else np.array([0.0, 0.0, -1.0])
    sides = {
        "front": first,
        "back": -first,
        "left": np.cross(own, first),
        "right": np.cross(first, own),
    }
    tilts = [GaitTask(n, triple(TILT * np.cross(own, to)), _STILL) for n, to in sides.items()]
    return (*tilts, GaitTask("forward", move=triple(ADVANCE * length * own)))


# Half as far as in the shipped tasks: most of a run's time goes into its evaluation, and that into the way.
# There are half as many obstacles, so that they stand as close together. A walker's targets are at 6 lengths: a
# stranger's steps are short.
_NEAR = Navigation(distance=10.0, k2_obstacles=1, novel_obstacles=5)

KINDS = {
    "planar": Kind(
        does="swims in the plane",
        walks=False,
        bends=True,
        body=BodyOptions(
            modes=5,
            basis=31,
            samples=16,
            drag_error=0.06,
            amplitude=2.0,
            shape_error=MOST_DISTANCE,
            moved=_MOVED,
        ),
        rhythm=Rhythm(fastest=5.75, periods=2.5, steps=32, finest=0.58),
        gaits=_swims_ahead,
        more=2.0,
        weights=Weights(effort=0.15, style="sideways"),
        navigation=_NEAR,
    ),
    "spatial": Kind(
        does="swims in space",
        walks=False,
        bends=False,
        body=BodyOptions(
            vertices=1500,
            modes=10,
            basis=60,
            samples=24,
            drag_error=0.06,
            medium=Medium(righting_height=0.0),
            shape_error=MOST_DISTANCE,
            moved=_MOVED,
        ),
        rhythm=Rhythm(fastest=3.1, periods=1.4, steps=18, finest=0.58),
        gaits=_tilts,
        more=2.0,
        weights=Weights(turn=6.0, move=6.0, drift=6.0, roll=1.0, effort=0.15, style="pulse"),
        navigation=dataclasses.replace(_NEAR, beams=128, space="spatial"),
    ),
    "ground": Kind(
        does="walks",
        walks=True,
        bends=False,
        body=BodyOptions(
            vertices=1500,
            modes=10,
            basis=31,
            drag_error=0.3,
            amplitude=1.0,
            material=Material(damping=0.15),
            medium=GROUND.medium,
            shape_error=MOST_DISTANCE,
            moved=_MOVED,
        ),
        rhythm=Rhythm(fastest=np.inf, periods=2.1, steps=46, finest=0.58, falling=2.6),
        gaits=_walks_ahead,
        more=1.0,
        weights=Weights(turn=3.0, move=8.0, drift=8.0, tilt=3.0, slip=0.8),
        navigation=dataclasses.replace(_NEAR, distance=6.0, novel_obstacles=3),
    ),
}
"""About as the shipped tasks: the fish, the jellyfish-like swimmer, the 4-legged and the T-shaped walker."""
