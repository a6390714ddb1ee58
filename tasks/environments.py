"""What all suite domains share: environments of target shapes and of gaits, packaged bodies and gaits."""

from __future__ import annotations

import collections
from pathlib import Path

import numpy as np
from dm_control.rl import control
from dm_control.suite import base

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import Space
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.world import World
from defplan_mj.gait.gait import Gait
from defplan_mj.host.navigation import robot_environment
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.scenes import NovelScenes
from defplan_mj.task import Navigation, TaskSpec

ASSETS = Path(__file__).parent / "assets"


class ShapeTask(base.Task):
    """A task whose action is the target shape, told for n robots at once from their states (n, 13 + 3r).

    A vector environment asks for many robots, dm_control for one.

    Attributes:
        dynamics: what moves.
        time_limit: of an episode, s.
    """

    dynamics: ReducedDynamics
    time_limit: float

    def draw(
        self, random: np.random.RandomState, place: Space, modes: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw the target's position (3,), m, and the state (13 + 3r,) that an episode starts from."""
        raise NotImplementedError

    def observe(
        self, states: np.ndarray, targets: np.ndarray, place: Space
    ) -> collections.OrderedDict:
        """Return arrays (n, size) by name, from states and targets (n, 3)."""
        raise NotImplementedError

    def rewards(self, states: np.ndarray, targets: np.ndarray, place: Space) -> np.ndarray:
        """Return the rewards (n,) of robots that have come to these states."""
        raise NotImplementedError


def shape_environment(
    spec: TaskSpec, task: ShapeTask, environment_kwargs: dict | None
) -> control.Environment:
    """Return `task` as an environment whose action is the target shape, one a time step."""
    model = build_spec(
        task.dynamics.body,
        spec.timestep,
        space=spec.navigation.space,
        terrain=spec.terrain,
        texture=spec.texture(),
        stepping=spec.stepping,
    )
    return control.Environment(
        Physics.from_mjmodel(compile_model(model)),
        task,
        control_timestep=spec.timestep,
        time_limit=task.time_limit,
        **(environment_kwargs or {}),
    )


def navigate_environment(
    spec: TaskSpec,
    body: Body,
    gait: Gait,
    time_limit: float = float("inf"),
    random: np.random.RandomState | int | None = None,
    environment_kwargs: dict | None = None,
    scene: Scene | None = None,
    navigation: Navigation | None = None,
    obstacles: int | None = None,
    obstacle_speed: float = 0.0,
) -> control.Environment:
    """Return the navigation task: the action is the gait, one step is one gait cycle, Eq. 2's reward.

    Args:
        body, gait: what moves, and how.
        time_limit: s.
        scene: keep to this one; by default every episode draws an unseen one.
        navigation: by default that of `spec`.
        obstacles: on the way to a drawn target; by default navigation.novel_obstacles.
        obstacle_speed: of drawn obstacles, m/s.
    """
    there = navigation or spec.navigation
    return robot_environment(
        Robot(body, gait, World(body.medium, spec.terrain)),
        there,
        NovelScenes(there, obstacles, obstacle_speed),
        scene=scene,
        texture=spec.texture(),
        time_limit=time_limit,
        random=random,
        environment_kwargs=environment_kwargs,
    )


def packaged_files(body: str, gait: str) -> tuple[Path, Path]:
    """Return the files of a packaged body and gait, as `TaskSpec.shipped` has them."""
    return ASSETS / f"{body}.npz", ASSETS / f"{gait}.npz"


def packaged_body(name: str) -> Body:
    """Return the body that is packaged as assets/NAME.npz."""
    return Body.load(_packaged(name))


def packaged_gait(name: str) -> Gait:
    """Return the gait that is packaged as assets/NAME.npz."""
    return Gait.load(_packaged(name))


def _packaged(name: str) -> Path:
    path = ASSETS / f"{name}.npz"
    if not path.is_file():
        raise DefplanError(
            f"the packaged file {path} is missing: reinstall defplan,"
            " or hand in your own with task_kwargs={'body': ..., 'gait': ...}"
        )
    return path
