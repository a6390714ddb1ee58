"""Pictures and videos made without a screen."""

from __future__ import annotations

import imageio.v3 as iio
import mujoco
import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.host import render
from defplan_mj.host.render import motes_around, render_states
from defplan_tasks.fish import skin_texture
from tests.samples import host as samples

SKIN = skin_texture()
SIZE = (128, 96)


@pytest.fixture(scope="module")
def states() -> np.ndarray:
    dynamics = samples.dynamics()
    return dynamics.rollout(dynamics.rest_state(), 0.4 * samples.gait().table()[0])


def _orange(frame: np.ndarray) -> np.ndarray:
    """Return where the picture shows the fish's flank."""
    red, green, blue = (frame[..., i].astype(int) for i in range(3))
    return (red > 150) & (red > green + 40) & (green > blue)


@pytest.mark.usefixtures("rendering")
def test_frames_show_the_fish_move(states):
    ends = states[[0, -1]]
    frames = render_states(
        samples.fish(), ends, size=SIZE, camera="side", timestep=0.5, fps=2, texture=SKIN
    )
    assert len(frames) == 2
    first, last = frames
    assert first.shape == (96, 128, 3) and first.dtype == np.uint8
    assert _orange(first).sum() > 100 and _orange(last).sum() > 100
    assert (_orange(first) != _orange(last)).sum() > 20


@pytest.mark.usefixtures("rendering")
@pytest.mark.parametrize("camera", ["chase", "top", "map", "overview"])
def test_cameras_see_fish_and_obstacles(states, camera):
    scene = samples.scene([(1.2, 0.9, 0.4)], target=(2.5, 0.0, 0.0))
    [frame] = render_states(
        samples.fish(), states[:1], scene, size=SIZE, camera=camera, texture=SKIN
    )
    blue = _blue(frame)
    assert _orange(frame).any() and blue.sum() > 30


def _blue(frame: np.ndarray) -> np.ndarray:
    """Return where the picture shows an obstacle."""
    red, green, blue = (frame[..., i].astype(int) for i in range(3))
    return (blue > red + 40) & (blue > green + 40)


@pytest.mark.usefixtures("rendering")
@pytest.mark.parametrize("camera", ["map", "overview"])
@pytest.mark.parametrize("target", [(15.0, 0.0, 0.0), (-4.0, 9.0, 8.0), (0.0, 0.0, 15.0)])
def test_everything_is_in_the_picture_from_afar(states, camera, target):
    """Obstacles at the ends of the way, and to its sides, are seen whole: none is cut by the edge."""
    place = np.array(target)
    balls = [(*(1.1 * place), 1.0), (*(-0.3 * place), 1.5), (3.0, 5.0, -6.0, 1.2)]
    if camera == "map":  # what lies above one another hides: look at them one by one
        balls = balls[:1]
    for ball in balls:
        scene = samples.spheres([ball], target=target)
        [frame] = render_states(
            samples.fish(), states[:1], scene, size=SIZE, camera=camera, texture=SKIN
        )
        blue = _blue(frame)
        assert blue.sum() > 15
        assert not (blue[[0, -1]].any() or blue[:, [0, -1]].any())


def test_cameras_go_along_with_the_body_but_do_not_turn_with_it():
    physics = samples.physics(space="spatial")
    samples.place(physics)
    places, axes = physics.data.cam_xpos.copy(), physics.data.cam_xmat.copy()
    for quaternion in samples.attitudes(20):
        samples.place(physics, (3.0, -2.0, 7.0), quaternion)
        assert physics.data.cam_xpos - physics.com() == pytest.approx(places, abs=1e-6)
        assert physics.data.cam_xmat == pytest.approx(axes, abs=1e-12)


def test_motes_stay_where_they_are_and_are_all_around():
    here, there = np.array([0.3, 0.2, -0.4]), np.array([1.9, -0.7, 0.6])
    around_here, around_there = motes_around(here), motes_around(there)
    near = [
        {tuple(mote) for mote in motes if np.linalg.norm(mote - here) < 3.0}
        for motes in (around_here, around_there)
    ]
    assert near[0] == near[1] and len(near[0]) > 30
    assert np.abs((around_here - here).mean(0)).max() < 0.7  # half a cell of the grid
    assert np.ptp(around_here, axis=0) == pytest.approx(13.0, abs=1.3)


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


@pytest.mark.usefixtures("rendering")
def test_the_side_camera_turns_with_the_heading_and_not_with_the_stroke(states):
    turned = np.repeat(states[:1], 60, axis=0)
    turned[:, 3:7] = [np.cos(0.7), 0, 0, np.sin(0.7)]
    frames = [
        render_states(samples.fish(), some, size=SIZE, camera="side", timestep=0.04, texture=SKIN,
                      trail=False)[30]
        for some in (np.repeat(states[:1], 60, axis=0), turned)
    ]  # fmt: skip
    shown = [np.argwhere(_orange(frame)) for frame in frames]
    wide = [np.ptp(places[:, 1]) for places in shown]
    assert min(wide) > SIZE[0] / 4 and abs(wide[0] - wide[1]) <= 3


@pytest.mark.usefixtures("rendering")
def test_a_caption_is_written_into_the_corner(states):
    plain, written = (
        render_states(samples.fish(), states[:1], size=(256, 192), caption=caption)[0].astype(int)
        for caption in (None, lambda index: ("time", "1.0 s"))
    )
    changed = np.abs(plain - written).sum(2) > 60
    assert changed[:60, :128].any() and not changed[100:].any()


@pytest.mark.parametrize(
    ("name", "camera", "sentence"),
    [
        ("folder", "chase", "is a folder: name a video in it"),
        ("x.avi", "chase", "end its name in .mp4"),
        ("x.mp4", "sde", "there is no camera sde, did you mean side?"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_the_work(tmp_path, name, camera, sentence):
    (tmp_path / "folder").mkdir()
    with pytest.raises(DefplanError, match=sentence):
        render.check_video(tmp_path / name, camera)
