"""The T-shaped body (paper, second example): the task `tee-walk` and the suite domain `tee`.

It walks with its bar down, on the bar's ends and its middle by turns, the stem up.
"""

from __future__ import annotations

import numpy as np
from dm_control.utils import containers

from defplan_tasks import environments, walking
from defplan_tasks.painting import blend, rise, to_picture


def skin_texture(height: int = 256, width: int = 256) -> np.ndarray:
    """Return the body's picture, (height, width, 3) uint8: a blue bar, a stem that pales to its top."""
    across, up = np.meshgrid(np.linspace(-1, 1, width), np.linspace(1, 0, height))
    bar, stem, top = np.array([[0.13, 0.33, 0.60], [0.26, 0.60, 0.72], [0.97, 0.86, 0.50]])
    colour = blend(bar, stem, rise(up, 0.24, 0.36))
    colour = blend(colour, top, rise(up, 0.72, 0.92))
    for place in (0.44, 0.56, 0.68):  # rings around the stem
        ring = np.exp(-(((up - place) / 0.016) ** 2))
        colour = blend(colour, bar, (0.5 * ring)[..., None])
    ends = rise(abs(across), 0.72, 0.95) * rise(-up, -0.3, -0.2)
    return to_picture(blend(colour, top, 0.8 * ends))


WALK = walking.walk_spec(
    "tee-walk",
    "a T-shaped body walks on its bar to targets among upright cylinders",
    mesh="tee.obj",
    vertices=3121,
    shipped=environments.packaged_files("tee_body", "tee_gait"),
    skin=skin_texture,
    gait_solver="shooting",  # contact-invariant optimisation does not make it walk
    paper={
        "full_step_s": 2.2,
        "reduced_step_s": 0.13,
        "gait_h": 3.2,
        "planner_h": 3.3,
        "features_h": 1.2,
        "rotation_mean": (0.009, 0.012, 0.001, 0.02),
        "rotation_sd": (0.0, 0.0, 0.03, 0.001),
        "translation_mean": (0.672, 0.643, 0.522, 0.541),
        "translation_sd": (0.007, 0.012, 0.031, 0.016),
    },
)

SUITE = containers.TaggedTasks()


@SUITE.add("benchmarking")
def walk(body=None, **kwargs):
    """Return the walk task: the action is the target shape, in [-1, 1] of the body's amplitude.

    Args:
        body: by default the packaged one.
        kwargs: of `walking.walk_environment`.
    """
    return walking.walk_environment(WALK, body or environments.packaged_body("tee_body"), **kwargs)


@SUITE.add("no_reward_visualization")
def navigate(body=None, gait=None, **kwargs):
    """Return the navigation task: the action is the gait, one step is one gait cycle, Eq. 2's reward.

    Args:
        body, gait: what walks, and how; by default the packaged ones.
        kwargs: of `environments.navigate_environment`.
    """
    body = body or environments.packaged_body("tee_body")
    gait = gait or environments.packaged_gait("tee_gait")
    return environments.navigate_environment(WALK, body, gait, **kwargs)
