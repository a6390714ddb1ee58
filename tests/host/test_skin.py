"""What is drawn is the deformed surface."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from defplan_mj.host.scene import build_spec
from defplan_mj.host.skin import shaded_texture, texture_of
from defplan_mj.registry import get_task
from tests.samples import host as samples


def _drawn(physics) -> np.ndarray:
    """Return the skin's vertices in the scene that every renderer draws."""
    model, data = physics.model.ptr, physics.data.ptr
    scene = mujoco.MjvScene(model, maxgeom=100)
    mujoco.mjv_updateScene(
        model,
        data,
        mujoco.MjvOption(),
        mujoco.MjvPerturb(),
        mujoco.MjvCamera(),
        mujoco.mjtCatBit.mjCAT_ALL,
        scene,
    )
    return np.array(scene.skinvert).reshape(-1, 3)


def test_skin_follows_the_deformed_surface():
    physics = samples.physics()
    generator = np.random.default_rng(1)
    for _ in range(3):
        samples.place(
            physics,
            generator.normal(size=3),
            generator.normal(size=4),
            q=generator.uniform(-1, 1, physics.n_modes),
        )
        assert np.abs(_drawn(physics) - physics.surface()).max() < 1e-5


def test_skin_of_the_rest_shape_is_the_mesh():
    body = samples.fish()
    drawn = _drawn(samples.physics())
    assert np.abs(drawn - body.vertices[body.surface]).max() < 1e-6
    assert np.array_equal(body.surface[body.surface_faces], body.faces)


def test_default_skin_is_dark_above():
    picture = shaded_texture()
    assert picture.dtype == np.uint8 and picture[0].sum() < picture[-1].sum()


def test_a_body_wears_the_skin_of_its_task_whatever_it_is_called():
    skin, drawn = get_task("fish-swim").skin, texture_of("fish-swim")
    assert skin is not None and drawn is not None
    assert np.array_equal(drawn, skin())
    assert texture_of("no-such-task") is None
    mine = replace(samples.fish(), name="fish")  # a user's own fish.stl
    spec = build_spec(mine, 0.04)
    picture = next(t for t in spec.textures if t.name == "self")
    assert bytes(picture.data) == shaded_texture().tobytes()
