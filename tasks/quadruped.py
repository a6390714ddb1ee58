"""The 4-legged body (paper, last examples): it swims in space and walks; the suite domain `quadruped`."""

from __future__ import annotations

import dataclasses

import numpy as np
from dm_control.utils import containers

from defplan_mj.base.space import SPACE
from defplan_mj.body.model import Medium
from defplan_mj.task import BodyOptions, GaitTask, Navigation, TaskSpec, Weights
from defplan_tasks import environments, swimming, walking
from defplan_tasks.painting import blend, rise, to_picture


def skin_texture(height: int = 384, width: int = 384) -> np.ndarray:
    """Return the body's picture, (height, width, 3) uint8: coral above, legs dark towards pale feet.

    It is projected along y, so that it depends on the height mostly, which all sides share.
    """
    across, up = np.meshgrid(np.linspace(-1, 1, width), np.linspace(1, 0, height))
    crown, bell, leg, foot = np.array(
        [[0.96, 0.70, 0.36], [0.90, 0.37, 0.26], [0.50, 0.14, 0.28], [0.98, 0.88, 0.66]]
    )
    colour = blend(leg, bell, rise(up, 0.35, 0.75))
    colour = blend(colour, crown, rise(up, 0.86, 0.97))
    for place in (0.22, 0.36, 0.50):  # rings around the legs
        ring = np.exp(-(((up - place - 0.012 * np.cos(14 * across)) / 0.018) ** 2))
        colour = blend(colour, bell, (0.8 * ring)[..., None])
    return to_picture(blend(colour, foot, rise(-up, -0.13, -0.06)))


TURN, ADVANCE = 0.45, 0.55  # wanted of a cycle: rad, m

SWIM = TaskSpec(
    name="quadruped-swim",
    description="a 4-legged body swims like a jellyfish to targets among spheres, in three dimensions",
    mesh=environments.ASSETS / "quadruped.obj",
    # Nothing rights it: all attitudes are alike.
    body=BodyOptions(
        vertices=1054,
        modes=10,
        basis=60,
        samples=24,
        shapes="elastic",
        amplitude=1.5,
        length=1.0,
        medium=Medium(righting_height=0.0),
    ),
    timestep=0.025,
    steps_per_cycle=18,
    # The body's own axis is +z: bell first, legs behind. A turn tilts it to one of the four sides.
    gait_tasks=(
        GaitTask("front", turn=(0.0, TURN, 0.0), move=(0.0, 0.0, 0.0)),
        GaitTask("back", turn=(0.0, -TURN, 0.0), move=(0.0, 0.0, 0.0)),
        GaitTask("left", turn=(-TURN, 0.0, 0.0), move=(0.0, 0.0, 0.0)),
        GaitTask("right", turn=(TURN, 0.0, 0.0), move=(0.0, 0.0, 0.0)),
        GaitTask("forward", move=(0.0, 0.0, ADVANCE)),
    ),
    gait_steps=200,
    weights=Weights(turn=6.0, move=6.0, drift=6.0, roll=1.0, effort=0.15, style="pulse"),
    axis=(0.0, 0.0, 1.0),
    navigation=Navigation(k2=30, beams=128, space=SPACE.name),
    gait_solver="shooting",
    planner="dql",
    feedback="none",
    rivals=("alternating",),  # the paper's scheme
    shipped=environments.packaged_files("quadruped_body", "quadruped_gait"),
    skin=skin_texture,
    # Tables I to III; hours are the paper's own.
    paper={
        "vertices": 1054,
        "dof": 16,
        "full_step_s": 5.2,
        "reduced_step_s": 0.17,
        "gait_h": 5.2,
        "planner_h": 11.0,
        "features_h": 9.12,
        "gait_steps": 200,
        "wavelets": 5,
        "memory": 240_000,
        "k2": 30,
        "n2_cycles": 800,
        "steps_per_cycle": 9,
        "k2_success": 1.0,
        "tasks": ("front", "back", "left", "right", "forward"),
        "rotation_mean": (0.184, 0.206, 0.229, 0.211, 0.971),
        "rotation_sd": (0.129, 0.121, 0.118, 0.122, 0.274),
        "translation_mean": (0.09, 0.087, 0.089, 0.089, 0.426),
        "translation_sd": (0.076, 0.073, 0.05, 0.066, 0.055),
    },
)

WALK = walking.walk_spec(
    "quadruped-walk",
    "a 4-legged body walks to targets among upright cylinders, without turning",
    mesh="quadruped.obj",
    vertices=1054,
    shipped=environments.packaged_files("quadruped_walker_body", "quadruped_walker_gait"),
    skin=skin_texture,
    gait_solver="cio-shooting",  # it trots: shooting alone finds other patterns, and skates more
    paper={
        "full_step_s": 2.1,
        "reduced_step_s": 0.11,
        "gait_h": 2.5,
        "planner_h": 3.3,
        "features_h": 1.51,
        "rotation_mean": (0.083, 0.132, 0.071, 0.129),
        "rotation_sd": (0.104, 0.107, 0.107, 0.105),
        "translation_mean": (1.963, 0.67, 0.93, 1.64),
        "translation_sd": (0.269, 0.127, 0.165, 0.305),
    },
)

RUN = dataclasses.replace(
    WALK,
    name="quadruped-run",
    description="the 4-legged walker in a hurry: gaits that want 1 m a cycle, kept on their feet by feedback",
    gait_tasks=walking.walking_tasks(1.0),
    weights=dataclasses.replace(walking.WEIGHTS, slip=0.1),
    feedback="ilqg",
    shipped=environments.packaged_files("quadruped_walker_body", "quadruped_runner_gait"),
)

SUITE = containers.TaggedTasks()


@SUITE.add("benchmarking")
def swim(body=None, **kwargs):
    """Return the swim task: the action is the target shape, the attitude at the start is any.

    Args:
        body: by default the packaged one.
        kwargs: of `swimming.swim_environment`.
    """
    body = body or environments.packaged_body("quadruped_body")
    return swimming.swim_environment(SWIM, body, **kwargs)


@SUITE.add("no_reward_visualization")
def navigate3d(body=None, gait=None, **kwargs):
    """Return the navigation task among spheres: the action is the gait, one step is one cycle.

    Args:
        body, gait: by default the packaged ones.
        kwargs: of `environments.navigate_environment`.
    """
    body = body or environments.packaged_body("quadruped_body")
    gait = gait or environments.packaged_gait("quadruped_gait")
    return environments.navigate_environment(SWIM, body, gait, **kwargs)


@SUITE.add("benchmarking")
def walk(body=None, **kwargs):
    """Return the walk task: the action is the target shape, in [-1, 1] of the body's amplitude.

    Args:
        body: by default the packaged one.
        kwargs: of `walking.walk_environment`.
    """
    body = body or environments.packaged_body("quadruped_walker_body")
    return walking.walk_environment(WALK, body, **kwargs)


@SUITE.add("no_reward_visualization")
def navigate(body=None, gait=None, **kwargs):
    """Return the navigation task on the ground: the action is the gait, one step is one gait cycle.

    Args:
        body, gait: what walks, and how; by default the packaged ones.
        kwargs: of `environments.navigate_environment`.
    """
    body = body or environments.packaged_body("quadruped_walker_body")
    gait = gait or environments.packaged_gait("quadruped_walker_gait")
    return environments.navigate_environment(WALK, body, gait, **kwargs)
