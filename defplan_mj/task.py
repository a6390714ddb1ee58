"""What a task file says: the body, the gaits to learn, the navigation problem. Plain data, no code paths."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.places import check_place
from defplan_mj.base.space import PLANE, SPACES, Space
from defplan_mj.body.options import BodyOptions
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.dynamics.world import World

if TYPE_CHECKING:
    from defplan_mj.body.model import Body
    from defplan_mj.dynamics.reduced import ReducedDynamics


@dataclass(frozen=True)
class GaitTask:
    """One task of the multitask gait: what a cycle of it should do, in the frame at its start.

    That frame is the body's own in space, and its yaw frame (x ahead, z up) in the plane.

    Attributes:
        name: e.g. 'left'.
        turn: wanted rotation of a cycle, rad (a rotation vector; in the plane (0, 0, yaw)).
        move: wanted displacement of a cycle, m.
    """

    name: str
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    move: tuple[float, float, float] = (1.0, 0.0, 0.0)

    @property
    def angle(self) -> float:
        """Of the wanted rotation, rad."""
        return math.hypot(*self.turn)

    @property
    def advance(self) -> float:
        """Length of the wanted displacement, m."""
        return math.hypot(*self.move)

    @property
    def turn_axis(self) -> tuple[float, ...]:
        """Unit vector of the wanted rotation, or zeros."""
        return tuple(value / (self.angle or 1.0) for value in self.turn)

    @property
    def direction(self) -> tuple[float, ...]:
        """Unit vector of the wanted displacement, or zeros."""
        return tuple(value / (self.advance or 1.0) for value in self.move)


@dataclass(frozen=True)
class Weights:
    """Weights of a gait's objective E_obj, per cycle.

    Attributes:
        turn: of the squared error of a cycle's rotation: of the yaw in the plane, of where the
            body's own axis points in space, 1/rad^2.
        move: of the squared shortfall of its advance in the wanted direction, 1/m^2.
        drift: of the squared displacement across that direction (all of it if none is wanted), 1/m^2.
        roll: in space, of the squared rotation about the own axis, 1/rad^2.
        tilt: in the plane, of the mean squared tilt, 1/rad^2.
        upright: in the plane, of the mean squared excess of the squared tilt over (15 degrees)^2,
            1/rad^4.
        sink: in the plane, of the squared change of depth, 1/m^2.
        slip: on level ground, of the way that the loaded contacts slide in a cycle, 1/m.
        effort: of the mean squared target shape, in units of the amplitude; with a style, in modes
            that are not of it.
        style: which modes gaits start in, and use freely: 'any', 'sideways' (modes that bend the
            body sideways: a fish swims with its tail, not like a corkscrew) or 'pulse' (modes that
            are alike all around the body's own axis: a jellyfish opens and closes).
        sharpness: of the mean squared beta.
    """

    turn: float = 2.0
    move: float = 6.0
    drift: float = 0.0
    roll: float = 0.0
    tilt: float = 1.0
    upright: float = 10.0
    sink: float = 20.0
    slip: float = 0.0
    effort: float = 0.0
    style: str = "any"
    sharpness: float = 1e-3


@dataclass(frozen=True)
class Navigation:
    """The navigation problem of the second stage (paper, section V).

    Attributes:
        distance: of the targets, m.
        goal_radius: m.
        max_cycles: gait cycles before an episode times out.
        decisions_per_cycle: how often in a gait cycle the robot senses and chooses its gait; the cycle has to have
            so many equal parts (the paper: 1).
        k2: number of training targets (the paper's K2), evenly spread.
        k2_obstacles, novel_obstacles: obstacles on the way, to a training target and in an unseen scene.
        beams: laser beams.
        laser_range: m.
        space: 'planar' (targets, obstacles and laser in the horizontal plane, in the yaw frame) or
            'spatial' (all of them in three dimensions, in the body frame).
        sensor: what the robot senses of its surroundings, by name; '': the laser of its space.
        scenes: '': obstacles beside the straight way to the target. Or a name of `base.places`, such as
            'tunnel': training targets, unseen and training scenes are all of that kind, whose
            obstacles are its own and stand still; the counts above do not matter.
        room: radius of the disc that gates, lanes and tunnels of these scenes are made for, m.
    """

    distance: float = 20.0
    goal_radius: float = 1.0
    max_cycles: int = 200
    k2: int = 10
    k2_obstacles: int = 2
    novel_obstacles: int = 10
    beams: int = 64
    laser_range: float = 10.0
    space: str = PLANE.name
    sensor: str = ""
    scenes: str = ""
    room: float = 0.75
    decisions_per_cycle: int = 1

    def __post_init__(self) -> None:
        if self.space not in SPACES:
            raise DefplanError(
                f"there is no space {self.space!r} to navigate in: take {' or '.join(SPACES)}"
            )
        if self.scenes:
            check_place(self.scenes, self.dimension)

    @property
    def dimension(self) -> int:
        """Of positions and directions: 2 in the plane, 3 in space."""
        return self.place.dimension

    @property
    def place(self) -> Space:
        """The space itself."""
        return SPACES[self.space]


def steps_of_decision(steps_per_cycle: int, decisions: int) -> int:
    """Return the control steps that a decision lasts, with so many decisions in a cycle.

    Raises:
        DefplanError: the cycle does not have so many equal parts.
    """
    if decisions < 1 or steps_per_cycle % decisions:
        raise DefplanError(
            f"a gait cycle of {steps_per_cycle} steps has no {decisions} equal parts: set"
            " navigation.decisions_per_cycle to a divisor of steps_per_cycle"
        )
    return steps_per_cycle // decisions


@dataclass(frozen=True)
class Effort:
    """How much a run of the task does where its command does not say.

    Attributes:
        pairs: (before, after) pairs a gait that the surrogate is fitted to.
        episodes: unseen scenes of the evaluation.
        moving: episodes at training targets among moving obstacles, at each of four speeds (0: none).
        unchecked: share of the unseen scenes that are gone through without the collision check, too.
    """

    pairs: int = 1000
    episodes: int = 200
    moving: int = 40
    unchecked: float = 1.0


@dataclass(frozen=True)
class TaskSpec:
    """A task: one body, its gaits and its navigation problem.

    Attributes:
        name: 'domain-task', e.g. 'fish-swim'; runs lie in a folder of that name.
        description: one line for `defplan list`.
        mesh: path of the mesh file the body is built from.
        body: how it is built.
        timestep: of a control step, s.
        substeps, integrator: of the reduced dynamics in it, see `dynamics.reduced.ReducedDynamics`.
        steps_per_cycle: control steps in one gait cycle.
        gait_tasks: what the gaits should do.
        gait_steps: N_1, steps of a gait trajectory.
        weights: of the gaits' objective.
        axis: the body's own axis, a unit vector of its frame: where it heads, and what a turn in
            space is about to tilt.
        terrain: what the robot walks on; None: it swims.
        navigation: the second stage.
        effort: how much a run does where its command does not say.
        gait_solver, planner, feedback: default plugins, by name; '': the one that says of itself that
            it is the default of its kind (`registry.get_task` fills in its name).
        rivals: gait solvers to compare with in the report, if they are installed.
        shipped: files of a body and of gaits that are packaged for the task, or None.
        skin: makes the picture that the body wears, see `host.skin.add_skin`; None: a plain one.
        paper: the paper's figures for this example (Tables I to III), for the report.
        file: the task file that it was read from; None: it is a plugin's.
    """

    name: str
    description: str
    mesh: Path
    body: BodyOptions
    timestep: float
    steps_per_cycle: int
    gait_tasks: tuple[GaitTask, ...]
    gait_steps: int = 200
    substeps: int = 2
    integrator: str = "variational"
    weights: Weights = Weights()
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    terrain: Terrain | None = None
    navigation: Navigation = Navigation()
    effort: Effort = Effort()
    gait_solver: str = ""
    planner: str = ""
    feedback: str = ""
    rivals: tuple[str, ...] = ()
    shipped: tuple[Path, Path] | None = None
    skin: Callable[[], np.ndarray] | None = None
    paper: dict = field(default_factory=dict)
    file: Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        _ = self.world  # medium and terrain have to agree
        steps_of_decision(self.steps_per_cycle, self.navigation.decisions_per_cycle)

    @property
    def world(self) -> World:
        """What surrounds the robot."""
        return World(self.body.medium, self.terrain)

    def dynamics(self, body: Body) -> ReducedDynamics:
        """Return the reduced dynamics of `body` in this task's world, at its time step."""
        from defplan_mj.dynamics.reduced import ReducedDynamics  # a task is read without the kernel

        return ReducedDynamics(body, self.timestep, self.world.terrain, **self.stepping)

    def of_gaits(self, names: Sequence[str]) -> TaskSpec:
        """Return the task with some of its gait tasks, in this order."""
        known = {task.name: task for task in self.gait_tasks}
        return replace(self, gait_tasks=tuple(known[name] for name in names))

    def texture(self) -> np.ndarray | None:
        """Return the picture of the skin, or None."""
        return None if self.skin is None else self.skin()

    @property
    def stepping(self) -> dict[str, Any]:
        """'substeps' and 'integrator', as `ReducedDynamics` and `build_spec` take them."""
        return {"substeps": self.substeps, "integrator": self.integrator}
