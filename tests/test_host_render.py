"""Pictures and videos made without a screen."""

from __future__ import annotations

import host_samples as samples
import imageio.v3 as iio
import mujoco
import numpy as np
import pytest

from defplan_mj.errors import DefplanError
from defplan_mj.host import render
from defplan_mj.host.render import render_states

SIZE = (128, 96)


@pytest.fixture(scope="module")
def states() -> np.ndarray:
    dynamics = samples.dynamics()
    return dynamics.rollout(dynamics.rest_state(), np.tile(samples.gait().table()[0], (1, 1)))


def _orange(frame: np.ndarray) -> np.ndarray:
    """Return where the picture shows the fish's flank."""
    red, green, blue = (frame[..., i].astype(int) for i in range(3))
    return (red > 150) & (red > green + 40) & (green > blue)


@pytest.mark.usefixtures("rendering")
def test_frames_show_the_fish_move(states):
    ends = states[[0, -1]]
    frames = render_states(samples.fish(), ends, size=SIZE, camera="side", timestep=0.5, fps=2)
    assert len(frames) == 2
    first, last = frames
    assert first.shape == (96, 128, 3) and first.dtype == np.uint8
    assert _orange(first).sum() > 100 and _orange(last).sum() > 100
    assert (_orange(first) != _orange(last)).sum() > 20


@pytest.mark.usefixtures("rendering")
@pytest.mark.parametrize("camera", ["chase", "top", "map", "overview"])
def test_cameras_see_fish_and_obstacles(states, camera):
    scene = samples.scene([(1.2, 0.9, 0.4)], target=(2.5, 0.0, 0.0))
    [frame] = render_states(samples.fish(), states[:1], scene, size=SIZE, camera=camera)
    blue = (frame[..., 2].astype(int) > frame[..., 0] + 80) & (frame[..., 2] > frame[..., 1] + 50)
    assert _orange(frame).any() and blue.sum() > 30


@pytest.mark.usefixtures("rendering")
def test_picture_and_video_are_whole_files(states, tmp_path):
    picture, video = tmp_path / "fish.png", tmp_path / "fish.mp4"
    assert render_states(samples.fish(), states, path=picture, size=SIZE) == []
    render_states(samples.fish(), states, path=video, size=SIZE, fps=6.25)
    assert iio.imread(picture).shape == (96, 128, 3)
    frames = iio.imread(video)
    assert frames.shape[1:] == (96, 128, 3)
    assert len(frames) == 3  # 12 states of 0.04 s, every fourth one
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fish.mp4", "fish.png"]


@pytest.mark.usefixtures("rendering")
def test_mujocos_own_renderer_and_dm_control_draw_the_fish():
    physics = samples.physics()
    with mujoco.Renderer(physics.model.ptr, 96, 128) as renderer:
        renderer.update_scene(physics.data.ptr, "side")
        own = renderer.render()
    theirs = physics.render(96, 128, camera_id="side")
    for frame in (own, theirs):
        assert frame.std() > 5
        assert (frame[48, 64].astype(int) - frame[5, 5]).any()


def test_unknown_camera_names_those_there_are(states):
    with pytest.raises(
        DefplanError, match="no camera front: there are chase, side, top, map, overview"
    ):
        render_states(samples.fish(), states, camera="front")


def test_no_way_to_draw_is_one_sentence(monkeypatch):
    monkeypatch.setattr(render, "_BACKENDS", ("nothing",))
    with pytest.raises(DefplanError, match="install libegl1 or libosmesa6"):
        render._open_context(*SIZE)
