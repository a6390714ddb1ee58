"""The viewer command where there is no screen, and what drives the robot in it."""

from __future__ import annotations

import sys
import time
import types

import mujoco
import numpy as np
import pytest

from defplan_mj import suite
from defplan_mj.base.errors import DefplanError
from defplan_mj.host import viewer
from tests.samples import host as samples


class _Window:
    """Stands for MuJoCo's passive viewer: closes after some pictures."""

    def __init__(self, pictures: int):
        self.left, self.synced = pictures, 0
        self.cam = mujoco.MjvCamera()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def is_running(self) -> bool:
        return self.left > 0

    def sync(self) -> None:
        self.left, self.synced = self.left - 1, self.synced + 1


@pytest.fixture
def window(monkeypatch):
    window = _Window(25)
    module = types.ModuleType("mujoco.viewer")
    module.launch_passive = lambda model, data, **_: window  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "mujoco.viewer", module)
    monkeypatch.setattr("mujoco.viewer", module, raising=False)
    monkeypatch.setattr(viewer, "require_display", lambda: None)
    return window


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there it can be told")
def test_no_screen_is_one_sentence(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(DefplanError, match="no screen to open the viewer on.*--video"):
        viewer.view(None, viewer.play([0]))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there it can be told")
def test_screen_that_does_not_answer_is_one_sentence(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(DefplanError, match="DISPLAY is :4711, which does not answer"):
        viewer.require_display()


def _navigate():
    kwargs = {"body": samples.fish(), "gait": samples.gait(), "scene": samples.scene([])}
    return suite.load("fish", "navigate", task_kwargs=kwargs)


def test_navigate_is_shown_at_every_physics_step(window):
    environment = _navigate()
    viewer.view(environment, viewer.play([0, 1]), speed=1000)
    assert window.synced == 25
    assert environment.physics.time() == pytest.approx(33 * 0.04)  # three whole cycles
    assert environment.task.step_hook is None
    assert window.cam.trackbodyid == environment.physics.model.name2id("robot", "body")


def test_swim_is_shown_at_every_step(window):
    environment = suite.load("fish", "swim", task_kwargs={"body": samples.fish()})
    viewer.view(environment, lambda _: np.zeros(5), speed=1000)
    assert window.synced == 25 and environment.physics.time() == pytest.approx(25 * 0.01375)


def test_outcomes_of_whole_episodes_are_returned(window):
    window.left = 10**6
    environment = _navigate()
    environment.task.scene = samples.scene([], max_cycles=2)
    assert viewer.view(environment, viewer.play([0]), episodes=2, speed=1000) == ["timeout"] * 2


def test_pace_is_that_of_the_clock(window):
    start = time.monotonic()
    viewer.view(_navigate(), viewer.play([0]), speed=4.0)
    assert time.monotonic() - start >= 0.98 * 24 * 0.04 / 4


def test_play_goes_round_its_gaits():
    policy = viewer.play([2, 0])
    assert [policy(None) for _ in range(5)] == [2, 0, 2, 0, 2]
