"""The viewer command where there is no screen, and what drives the robot in it."""

from __future__ import annotations

import sys
import time
import types
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from defplan_mj import suite
from defplan_mj.base.errors import DefplanError
from defplan_mj.host import viewer
from defplan_mj.host import viewer_keys as keys
from tests.samples import host as samples
from tests.samples.paths import ROOT


class _Window:
    """Stands for MuJoCo's passive viewer: closes after some pictures."""

    def __init__(self, pictures: int):
        self.left, self.synced = pictures, 0
        self.cam = mujoco.MjvCamera()
        self.press: Callable[[int], None] = lambda code: None
        self.texts: list[list[keys.Text]] = []
        self.at: dict[int, int] = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def is_running(self) -> bool:
        return self.left > 0

    def sync(self) -> None:
        self.left, self.synced = self.left - 1, self.synced + 1
        if self.synced in self.at:
            self.press(self.at[self.synced])

    def set_texts(self, texts) -> None:
        self.texts.append(texts)


@pytest.fixture
def window(monkeypatch):
    window = _Window(25)
    module = types.ModuleType("mujoco.viewer")

    def launch_passive(model, data, key_callback, **_):
        window.press = key_callback
        return window

    module.launch_passive = launch_passive  # type: ignore[attr-defined]
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


def test_space_holds_time_and_the_arrow_takes_one_step(window):
    window.left = 30
    window.at = {4: keys.PAUSE, 10: keys.STEP, 20: keys.PAUSE}
    environment = _navigate()
    simulated = []
    draw, times = window.sync, environment.physics.time

    def sync() -> None:
        simulated.append(times())
        draw()

    window.sync = sync
    viewer.view(environment, viewer.play([0]), speed=1000)
    steps = np.round(np.array(simulated) / 0.04).astype(int).tolist()
    # the arrow's step comes at the next look; then it waits again until space goes on
    assert steps == [1, 2, 3] + [4] * 7 + [5] * 10 + list(range(6, 16))


def test_enter_goes_to_the_next_episode(window):
    window.left, window.at = 10**6, {3: keys.NEXT}
    environment = _navigate()
    environment.task.scene = samples.scene([], max_cycles=1)
    outcomes = viewer.view(environment, viewer.play([0]), episodes=2, speed=1000)
    assert outcomes == ["skipped", "timeout"] and window.synced == 3 + 11


def test_minus_and_equals_change_the_speed(window):
    window.left, window.at = 12, {1: keys.FASTER, 2: keys.FASTER}
    viewer.view(_navigate(), viewer.play([0]), speed=8.0)
    assert {texts[0][3].split("\n")[1] for texts in window.texts} == {"8x", "16x", "32x"}
    pressed = keys.Keys()
    for _ in range(20):
        pressed.press(333)
    assert pressed.speed == keys.SLOWEST


def test_the_window_says_what_the_keys_do_until_they_are_hidden(window):
    window.at = {5: keys.HELP}
    viewer.view(_navigate(), viewer.play([0]), speed=1000)
    shown, hidden = window.texts[0][1], window.texts[-1][1]
    assert shown[2].split("\n") == [name for name, _ in keys.KEYS]
    assert (hidden[2], hidden[3]) == ("F8", "hide or show these")


def test_the_command_line_page_names_the_keys():
    page = (ROOT / "docs" / "command-line.md").read_text()
    section = page[page.index("## view") : page.index("## list")]
    for name, does in keys.KEYS:
        assert f"| {' '.join(f'`{key}`' for key in name.split('  '))} | {does} |" in section, name
