"""What all suite domains share: environments of target shapes and of gaits, packaged bodies and gaits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from dm_control.rl import control
from dm_control.suite import base

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.gait.gait import Gait
from defplan_mj.host.navigation import navigation_environment
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.planning.scenes import NovelScenes, Scene
from defplan_mj.task import Navigation, TaskSpec

ASSETS = Path(__file__).parent / "assets"


def shape_environment(
    spec: TaskSpec,
    body: Body,
    task: base.Task,
    time_limit: float,
    environment_kwargs: dict | None,
) -> control.Environment:
    """Return `task` as an environment whose action is the target shape, one a time step."""
    model = build_spec(
        body,
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
        time_limit=time_limit,
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
        scene: keep to this one; by default every episode draws a novel one.
        navigation: by default that of `spec`.
        obstacles: on the way to a drawn target; by default navigation.novel_obstacles.
        obstacle_speed: of drawn obstacles, m/s.
    """
    there = navigation or spec.navigation
    return navigation_environment(
        body,
        gait,
        there,
        NovelScenes(there, obstacles, obstacle_speed),
        scene=scene,
        terrain=spec.terrain,
        texture=spec.texture(),
        time_limit=time_limit,
        random=random,
        environment_kwargs=environment_kwargs,
    )


def shipped(body: str, gait: str) -> tuple[Path, Path]:
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
