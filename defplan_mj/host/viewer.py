"""Watch a task in MuJoCo's viewer, in real time, driven by a policy or a gait."""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import dm_env
import mujoco
import numpy as np
from dm_control.rl import control

from defplan_mj.base.errors import DefplanError
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import ROBOT
from defplan_mj.host.viewer_keys import Keys, Text

_GLANCE = 1 / 30  # s, between looks at the keys while paused

Policy = Callable[[dm_env.TimeStep], Any]


def require_display() -> None:
    """Raise unless a window can be opened.

    Raises:
        DefplanError: there is no screen.
    """
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in screens):
        reason = "DISPLAY is not set"
    else:
        import glfw  # only where there may be a screen

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if glfw.init():
                return
        reason = f"DISPLAY is {os.environ.get('DISPLAY')}, which does not answer"
    raise DefplanError(
        f"there is no screen to open the viewer on ({reason}):"
        " use `defplan replay LOG --video FILE` to make a video instead"
    )


def view(
    environment: control.Environment,
    policy: Policy,
    *,
    episodes: int | None = None,
    speed: float = 1.0,
) -> list[str]:
    """Open the viewer and run episodes until it is closed.

    Args:
        policy: returns an action of `environment` for its last time step.
        episodes: stop after so many; None goes on until the window is closed.
        speed: simulated seconds a second of wall time, until a key changes it (`viewer_keys`).

    Returns:
        The outcomes of the finished episodes, of tasks that have an `outcome`; "skipped" of those that
        the user had enough of.

    Raises:
        DefplanError: there is no screen.
    """
    require_display()
    from mujoco import viewer  # opens GLFW, so only where there is a screen

    physics, task = environment.physics, environment.task
    outcomes: list[str] = []
    others = set(threading.enumerate())
    model, data, keys = physics.model.ptr, physics.data.ptr, Keys(speed)
    with viewer.launch_passive(
        model, data, key_callback=keys.press, show_left_ui=False, show_right_ui=False
    ) as window:
        follow_robot(window.cam, model)
        shown = _Shown(window, keys)

        def show(physics: Physics, target_shape: np.ndarray | None = None) -> None:
            shown.picture(physics.time())

        hooked = hasattr(task, "step_hook")
        before = task.step_hook if hooked else None
        if hooked:
            task.step_hook = show
        try:
            while window.is_running() and (episodes is None or len(outcomes) < episodes):
                step = environment.reset()
                keys.skipping = False
                shown.start(physics.time())
                while window.is_running() and not (step.last() or keys.skipping):
                    step = environment.step(policy(step))
                    if not hooked:
                        show(physics)
                outcomes.append("skipped" if keys.skipping else getattr(task, "outcome", ""))
        finally:
            if hooked:
                task.step_hook = before
    # the viewer closes in a thread of its own; leaving before it has may end in an X error
    for thread in set(threading.enumerate()) - others:
        thread.join(timeout=5.0)
    return [outcome for outcome in outcomes if outcome]


def follow_robot(camera: mujoco.MjvCamera, model: mujoco.MjModel) -> None:
    """Let a camera keep the robot in view, from behind and above."""
    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, ROBOT)
    camera.distance, camera.azimuth, camera.elevation = 4.0, 50.0, -28.0


def play(gaits: Sequence[int]) -> Policy:
    """Return a policy that plays a list of gaits, one a cycle, over and over."""
    count = 0

    def policy(_: dm_env.TimeStep) -> int:
        nonlocal count
        count += 1
        return gaits[(count - 1) % len(gaits)]

    return policy


class _Shown:
    """The pictures and texts of a window, held to wall time as the keys want it."""

    def __init__(self, window: Any, keys: Keys):
        self._window, self._keys = window, keys
        self._texts: list[Text] = []
        self.start(0.0)

    def start(self, simulated: float) -> None:
        """Count time from here on."""
        self._speed = self._keys.speed
        self._simulated, self._wall = simulated, time.monotonic()

    def picture(self, simulated: float) -> None:
        """Show the present state when it is due, and wait while the keys say so."""
        window, keys = self._window, self._keys
        if not window.is_running() or keys.skipping:
            return
        self._draw(simulated)
        held = False
        while window.is_running() and keys.holds():
            held = True
            time.sleep(_GLANCE)
            self._draw(simulated)
        if held or keys.speed != self._speed:
            self.start(simulated)
        due = self._wall + (simulated - self._simulated) / self._speed
        time.sleep(max(0.0, due - time.monotonic()))

    def _draw(self, simulated: float) -> None:
        texts = self._keys.texts(simulated)
        if texts != self._texts:
            self._window.set_texts(texts)
            self._texts = texts
        self._window.sync()
