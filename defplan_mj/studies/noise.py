"""How well a planner steers when the robot senses badly, or is not as it was when the planner was trained."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.host.evaluation import evaluate
from defplan_mj.planning.outcome import ENDINGS
from defplan_mj.planning.planner import Observation, Planner, needs_obstacles
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.sensors.laser import laser_of
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.studies.robustness import heavier
from defplan_mj.task import Navigation

Sense = Callable[[np.ndarray, np.ndarray, float, np.random.Generator, Navigation], None]
"""sense(laser, target, strength, generator, navigation) changes what was read, (beams,) and (3,) m, in place."""
Change = Callable[[Robot, float], Robot]
"""change(robot, strength) returns the robot as it really is."""


def _scatter_laser(
    laser: np.ndarray, target: np.ndarray, strength: float, rng: np.random.Generator, at: Navigation
) -> None:
    laser += rng.normal(0.0, strength, len(laser)) * (laser < at.laser_range)
    np.clip(laser, 0.0, at.laser_range, out=laser)


def _drop_beams(
    laser: np.ndarray, target: np.ndarray, strength: float, rng: np.random.Generator, at: Navigation
) -> None:
    laser[rng.random(len(laser)) < strength] = at.laser_range


def _turn_slowly(
    laser: np.ndarray, target: np.ndarray, strength: float, rng: np.random.Generator, at: Navigation
) -> None:
    beams = np.arange(len(laser))
    laser[:] = laser[np.rint(beams * (1.0 - strength)).astype(int)]


def _scatter_target(
    laser: np.ndarray, target: np.ndarray, strength: float, rng: np.random.Generator, at: Navigation
) -> None:
    target[: at.dimension] += rng.normal(0.0, strength, at.dimension)


def _with_body(robot: Robot, body: Any) -> Robot:
    world = replace(robot.world, medium=body.medium)
    return replace(robot, body=body, gait=replace(robot.gait, body_hash=body.hash), world=world)


def _mass(robot: Robot, strength: float) -> Robot:
    return _with_body(robot, heavier(robot.body, 1.0 + strength))


def _drag(robot: Robot, strength: float) -> Robot:
    body = robot.body
    medium = replace(body.medium, density=(1.0 + strength) * body.medium.density)
    return _with_body(robot, replace(body, medium=medium))


@dataclass(frozen=True)
class Disturbance:
    """One way in which things are not as the planner takes them to be.

    Attributes:
        name: for tables.
        unit: of the strengths.
        strengths: that are measured.
        sense: changes what the planner and its collision check read; None: nothing.
        change: changes the robot; None: nothing.
        of_plane: whether it means something in the plane only.
    """

    name: str
    unit: str
    strengths: tuple[float, ...]
    sense: Sense | None = None
    change: Change | None = None
    of_plane: bool = False


DISTURBANCES = (
    Disturbance("laser noise", "m", (0.02, 0.05, 0.1, 0.2, 0.4), sense=_scatter_laser),
    Disturbance("dropped beams", "", (0.02, 0.05, 0.1, 0.2, 0.4), sense=_drop_beams),
    Disturbance(
        "laser turns slowly", "", (0.02, 0.05, 0.1, 0.15, 0.2), sense=_turn_slowly, of_plane=True
    ),
    Disturbance("target noise", "m", (0.1, 0.2, 0.5, 1.0, 2.0), sense=_scatter_target),
    Disturbance("mass", "", (-0.2, -0.1, 0.05, 0.1, 0.2), change=_mass),
    Disturbance("drag", "", (-0.2, -0.1, 0.05, 0.1, 0.2), change=_drag),
)
"""What is measured: noise as standard deviations, the others as shares."""


class Disturbed:
    """A planner that reads a disturbed laser and target; its random numbers are of the scene.

    So episodes do not depend on the process that runs them, nor on those before.
    """

    def __init__(
        self, planner: Planner, sense: Sense, strength: float, navigation: Navigation, seed: int
    ) -> None:
        self.planner, self.sense, self.strength = planner, sense, strength
        self.navigation, self.seed = navigation, seed
        self.generator: np.random.Generator | None = None

    @property
    def needs_obstacles(self) -> bool:
        """Whether the planner is told all obstacles."""
        return needs_obstacles(self.planner)

    def reset(self) -> None:
        """Begin an episode."""
        self.planner.reset()
        self.generator = None

    def values(self, observation: Observation) -> np.ndarray:
        """Return the planner's (K,) values of what is read."""
        laser, target = observation["laser"].copy(), observation["target"].copy()
        if self.generator is None:
            scene = zlib.crc32(laser.tobytes() + target.tobytes())
            self.generator = np.random.default_rng([self.seed, scene])
        self.sense(laser, target, self.strength, self.generator, self.navigation)
        return self.planner.values({**observation, "laser": laser, "target": target})


def measure_noise(
    robot: Robot,
    surrogate: Surrogate,
    navigation: Navigation,
    planner: Planner,
    scenes: Sequence[Scene],
    disturbances: Sequence[Disturbance] = DISTURBANCES,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[dict[str, Any]]:
    """Return a row for each disturbance and strength, in the collision check, undisturbed first.

    'disturbance', 'strength', 'unit', 'episodes', the share of each ending, 'interval' of the successes (95%,
    Wilson). Neither planner nor collision check is told of it: their surrogate is the undisturbed robot's.
    A feedback's model is the disturbed robot's.
    """
    laser_of(navigation)  # what is disturbed are beams
    steered = Shield(planner, surrogate, navigation)
    plane = navigation.dimension == 2
    measured = [(Disturbance("none", "", (0.0,)), 0.0)]
    measured += [(d, s) for d in disturbances if plane or not d.of_plane for s in d.strengths]
    rows: list[dict[str, Any]] = []
    for what, strength in measured:
        pilot: Planner = steered
        if what.sense is not None:
            pilot = Disturbed(steered, what.sense, strength, navigation, seed)
        real = what.change(robot, strength) if what.change is not None else robot
        result = evaluate(real, surrogate, navigation, pilot, scenes, shield=False).to_json()
        rows.append(
            {
                "disturbance": what.name,
                "strength": strength,
                "unit": what.unit,
                "episodes": result["episodes"],
                **{ending: result[ending] for ending in ENDINGS},
                "interval": result["interval"]["success"],
            }
        )
        progress(f"{what.name} {strength:g}", len(rows) / len(measured))
    return rows
