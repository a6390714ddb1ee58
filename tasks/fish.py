"""The fish (paper, first example): the task `fish-swim` and the suite domain with swim and navigate."""

from __future__ import annotations

import collections
from pathlib import Path

import numpy as np
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import containers, rewards

from defplan_mj.body.model import Body
from defplan_mj.errors import DefplanError
from defplan_mj.gait.gait import Gait
from defplan_mj.host.navigation import navigation_environment
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import TARGET, build_spec, compile_model
from defplan_mj.planning.scenes import Scene, novel_scenes
from defplan_mj.task import BodyOptions, GaitTask, Navigation, TaskSpec, Weights

ASSETS = Path(__file__).parent / "assets"

SWIM = TaskSpec(
    name="fish-swim",
    description="a fish swims to targets among upright cylinders (the paper's first example)",
    mesh=ASSETS / "fish.obj",
    body=BodyOptions(vertices=2118, modes=5, basis=31, samples=8, amplitude=2.0, length=1.0),
    timestep=0.04,
    steps_per_cycle=11,
    gait_tasks=(
        GaitTask("forward", move=(0.7, 0.0, 0.0)),
        GaitTask("left", turn=(0.0, 0.0, 0.8), move=(0.45, 0.0, 0.0)),
        GaitTask("right", turn=(0.0, 0.0, -0.8), move=(0.45, 0.0, 0.0)),
    ),
    gait_steps=200,
    weights=Weights(off_plane=0.15),
    navigation=Navigation(),
    # Tables I to III; hours are the paper's own, tasks in its order: left, right, forward.
    paper={
        "vertices": 2118,
        "dof": 11,
        "full_step_s": 2.5,
        "reduced_step_s": 0.07,
        "gait_h": 1.7,
        "dql_h": 2.5,
        "cnn_h": 0.7,
        "k2": 10,
        "k2_success": 1.0,
        "tasks": ("left", "right", "forward"),
        "rotation_mean": (0.833, 0.969, 0.131),
        "rotation_sd": (0.085, 0.048, 0.044),
        "translation_mean": (1.409, 1.424, 1.484),
        "translation_sd": (0.096, 0.087, 0.058),
    },
)

SUITE = containers.TaggedTasks()

_TIME_LIMIT = 40  # s
_TARGET_DISTANCE = (3.0, 8.0)  # m
_TARGET_RADIUS = 0.5  # m
_SPEED = 1.0  # body lengths a second that earn the full reward
_TILT, _BEND = 0.1, 0.2  # spread of the start: rad; share of the amplitude


@SUITE.add("benchmarking")
def swim(time_limit=_TIME_LIMIT, random=None, environment_kwargs=None, body=None):
    """Return the swim task: the action is the target shape, in [-1, 1] of the body's amplitude."""
    spec = build_spec(_body(body), SWIM.timestep, texture=skin_texture())
    physics = Physics.from_mjmodel(compile_model(spec))
    return control.Environment(
        physics,
        Swim(random=random),
        control_timestep=SWIM.timestep,
        time_limit=time_limit,
        **(environment_kwargs or {}),
    )


@SUITE.add("no_reward_visualization")
def navigate(
    time_limit=float("inf"),
    random=None,
    environment_kwargs=None,
    body=None,
    gait=None,
    scene=None,
    navigation=None,
    obstacles=None,
    obstacle_speed=0.0,
):
    """Return the navigate task: the action is the gait, one step is one gait cycle, Eq. 2's reward.

    Args:
        body, gait: what swims, and how; by default the packaged ones.
        scene: keep to this one; by default every episode draws a novel one.
        navigation: a task.Navigation; by default the paper's.
        obstacles: on the way to a drawn target; by default navigation.novel_obstacles.
        obstacle_speed: of drawn obstacles, m/s.
    """
    navigation = navigation or SWIM.navigation

    def sampler(generator: np.random.RandomState) -> Scene:
        seed = int(generator.randint(2**31))
        return novel_scenes(navigation, 1, seed, obstacles, obstacle_speed)[0]

    return navigation_environment(
        _body(body),
        _gait(gait),
        navigation,
        sampler,
        scene=scene,
        time_limit=time_limit,
        random=random,
        environment_kwargs=environment_kwargs,
    )


class Swim(base.Task):
    """Swim to a target at one body length a second, upright."""

    def initialize_episode(self, physics: Physics) -> None:
        """Draw the target, the heading, a slight tilt and a slightly bent shape."""
        angle, distance = self.random.uniform(-np.pi, np.pi), self.random.uniform(*_TARGET_DISTANCE)
        target = np.array([distance * np.cos(angle), distance * np.sin(angle), 0.0])
        physics.named.model.site_pos[TARGET] = target
        physics.named.model.site_size[TARGET] = _TARGET_RADIUS
        yaw, tilt = self.random.uniform(-np.pi, np.pi), _TILT * self.random.uniform(-1, 1, size=2)
        quaternion = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        quaternion[1:3] = 0.5 * tilt
        physics.data.qpos[3:7] = quaternion / np.linalg.norm(quaternion)
        r = physics.n_modes
        physics.data.qpos[7 : 7 + r] = _BEND * self.random.uniform(-1, 1, size=r)
        super().initialize_episode(physics)

    def get_observation(self, physics: Physics) -> collections.OrderedDict:
        """Return shape, uprightness, target and velocities, all in the body's frame."""
        frame = physics.orientation()
        observation = collections.OrderedDict()
        observation["shape"] = physics.shape()
        observation["upright"] = np.array([physics.upright()])
        observation["target"] = _to_target(physics) @ frame
        observation["velocity"] = np.concatenate(
            [physics.data.qvel[:3] @ frame, physics.data.qvel[3:6], physics.shape_velocity()]
        )
        return observation

    def get_reward(self, physics: Physics) -> float:
        """Return in [0, 1]: speed towards the target (or being there) times uprightness."""
        to_target = _to_target(physics)
        distance = np.linalg.norm(to_target)
        if distance <= _TARGET_RADIUS:
            swimming = 1.0
        else:
            speed = physics.data.qvel[:3] @ to_target / distance
            swimming = rewards.tolerance(
                speed,
                bounds=(_SPEED, float("inf")),
                margin=_SPEED,
                value_at_margin=0,
                sigmoid="linear",
            )
        return float(swimming * (1 + physics.upright()) / 2)


def skin_texture(height: int = 256, width: int = 768) -> np.ndarray:
    """Return the picture of the fish's left side, (height, width, 3) uint8, head to the right."""
    across, up = np.meshgrid(np.linspace(0, 1, width), np.linspace(1, 0, height))
    back, flank, belly = np.array([[0.10, 0.20, 0.34], [0.93, 0.50, 0.16], [0.99, 0.90, 0.72]])
    colour = _blend(flank, back, _rise(up, 0.55, 0.85))
    colour = _blend(colour, belly, _rise(-up, -0.42, -0.20))
    tail = _rise(-across, -0.20, -0.06)
    colour = _blend(colour, np.array([0.86, 0.27, 0.13]), 0.8 * tail)
    for place in (0.34, 0.50, 0.66, 0.80):  # bands across the flank
        band = np.exp(-(((across - place - 0.03 * np.sin(9 * up)) / 0.017) ** 2))
        colour = _blend(colour, back, (0.55 * band * _rise(up, 0.25, 0.45)[..., 0])[..., None])
    radius = np.hypot((across - 0.925) * 3.2, up - 0.53)
    colour = _blend(colour, np.array([0.98, 0.96, 0.88]), _rise(-radius, -0.052, -0.046))
    colour = _blend(colour, np.array([0.03, 0.03, 0.05]), _rise(-radius, -0.032, -0.027))
    return np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8)


def _rise(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return (..., 1): 0 below `low`, 1 above `high`, smooth between."""
    share = np.clip((value - low) / (high - low), 0, 1)
    return (share * share * (3 - 2 * share))[..., None]


def _blend(colour: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
    return colour + share * (other - colour)


def _to_target(physics: Physics) -> np.ndarray:
    return physics.target() - physics.com()


def _body(body: Body | None) -> Body:
    return Body.load(_packaged("fish_body.npz")) if body is None else body


def _gait(gait: Gait | None) -> Gait:
    return Gait.load(_packaged("fish_gait.npz")) if gait is None else gait


def _packaged(name: str) -> Path:
    path = ASSETS / name
    if not path.is_file():
        raise DefplanError(
            f"the packaged file {path} is missing: reinstall defplan,"
            " or hand in your own with task_kwargs={'body': ..., 'gait': ...}"
        )
    return path
