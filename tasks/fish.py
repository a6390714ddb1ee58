"""The fish (paper, first example): the task `fish-swim` and the suite domain with swim and navigate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dm_control.utils import containers

from defplan_mj.task import BodyOptions, GaitTask, Navigation, TaskSpec, Weights
from defplan_tasks import environments, swimming
from defplan_tasks.painting import blend, rise, to_picture


def skin_texture(height: int = 256, width: int = 768) -> np.ndarray:
    """Return the picture of the fish's left side, (height, width, 3) uint8, head to the right."""
    across, up = np.meshgrid(np.linspace(0, 1, width), np.linspace(1, 0, height))
    back, flank, belly = np.array([[0.10, 0.20, 0.34], [0.93, 0.50, 0.16], [0.99, 0.90, 0.72]])
    colour = blend(flank, back, rise(up, 0.55, 0.85))
    colour = blend(colour, belly, rise(-up, -0.42, -0.20))
    tail = rise(-across, -0.20, -0.06)
    colour = blend(colour, np.array([0.86, 0.27, 0.13]), 0.8 * tail)
    for place in (0.34, 0.50, 0.66, 0.80):  # bands across the flank
        band = np.exp(-(((across - place - 0.03 * np.sin(9 * up)) / 0.017) ** 2))
        colour = blend(colour, back, (0.55 * band * rise(up, 0.25, 0.45)[..., 0])[..., None])
    radius = np.hypot((across - 0.925) * 3.2, up - 0.53)
    colour = blend(colour, np.array([0.98, 0.96, 0.88]), rise(-radius, -0.052, -0.046))
    colour = blend(colour, np.array([0.03, 0.03, 0.05]), rise(-radius, -0.032, -0.027))
    return to_picture(colour)


SWIM = TaskSpec(
    name="fish-swim",
    description="a fish swims to targets among upright cylinders (the paper's first example)",
    mesh=environments.ASSETS / "fish.obj",
    body=BodyOptions(vertices=2118, modes=5, basis=31, samples=8, amplitude=2.0, length=1.0),
    timestep=0.01375,
    steps_per_cycle=32,
    gait_tasks=(
        GaitTask("forward", move=(0.7, 0.0, 0.0)),
        GaitTask("left", turn=(0.0, 0.0, 0.8), move=(0.45, 0.0, 0.0)),
        GaitTask("right", turn=(0.0, 0.0, -0.8), move=(0.45, 0.0, 0.0)),
    ),
    gait_steps=576,
    weights=Weights(effort=0.15, style="sideways"),
    navigation=Navigation(),
    gait_solver="shooting",
    planner="dql",
    feedback="none",
    rivals=("alternating",),  # the paper's scheme
    shipped=environments.packaged_files("fish_body", "fish_gait"),
    skin=skin_texture,
    # Tables I to III; hours are the paper's own, tasks in its order: left, right, forward.
    paper={
        "vertices": 2118,
        "dof": 11,
        "full_step_s": 2.5,
        "reduced_step_s": 0.07,
        "gait_h": 1.7,
        "planner_h": 2.5,
        "features_h": 0.7,
        "gait_steps": 200,
        "wavelets": 5,
        "memory": 20_000,
        "k2": 10,
        "n2_cycles": 200,
        "steps_per_cycle": 11,
        "k2_success": 1.0,
        "tasks": ("left", "right", "forward"),
        "rotation_mean": (0.833, 0.969, 0.131),
        "rotation_sd": (0.085, 0.048, 0.044),
        "translation_mean": (1.409, 1.424, 1.484),
        "translation_sd": (0.096, 0.087, 0.058),
    },
)

TUNNEL = replace(
    SWIM,
    name="fish-tunnel",
    description="the fish swims through bending tunnels with its old gaits (the paper's Fig. 7)",
    navigation=Navigation(scenes="tunnel", room=0.65, distance=20.0),
    gait_solver="as-packaged",  # nothing of the first stage is new
    planner="dql-cnn",  # the CNN is trained end to end, as in the paper
    rivals=(),
    paper={},
)

SUITE = containers.TaggedTasks()


@SUITE.add("benchmarking")
def swim(body=None, **kwargs):
    """Return the swim task: the action is the target shape, in [-1, 1] of the body's amplitude.

    Args:
        body: by default the packaged one.
        kwargs: of `swimming.swim_environment`.
    """
    return swimming.swim_environment(
        SWIM, body or environments.packaged_body("fish_body"), **kwargs
    )


@SUITE.add("no_reward_visualization")
def navigate(body=None, gait=None, **kwargs):
    """Return the navigation task: the action is the gait, one step is one gait cycle, Eq. 2's reward.

    Args:
        body, gait: what swims, and how; by default the packaged ones.
        kwargs: of `environments.navigate_environment`.
    """
    body = body or environments.packaged_body("fish_body")
    gait = gait or environments.packaged_gait("fish_gait")
    return environments.navigate_environment(SWIM, body, gait, **kwargs)
