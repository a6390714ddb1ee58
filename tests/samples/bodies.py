"""Bodies that several files use, each built once in a session: the same options give the same object."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import trimesh

from defplan_mj.body.build import build_body
from defplan_mj.body.model import Body, Medium
from defplan_mj.task import BodyOptions
from tests.samples.paths import ASSETS

AIR = Medium(name="air", density=0.0, gravity=-9.81, righting_height=0.0)


@functools.cache
def built(mesh: Path, options: BodyOptions, name: str | None = None) -> Body:
    """Return `build_body(mesh, options, name)`, built once."""
    return build_body(mesh, options, name=name)


def small_fish() -> Body:
    """Return the fish on a coarse mesh: fast to build and to compare with the full FEM."""
    options = BodyOptions(vertices=300, modes=5, basis=20, samples=16, drag_points=40)
    return built(ASSETS / "fish.obj", options, "small fish")


def small_walker() -> Body:
    """Return the 4-legged body in air on a coarse mesh: on a coarser one its legs would be lost."""
    options = BodyOptions(
        vertices=450, modes=6, basis=20, samples=10, drag_points=4, amplitude=1.0, medium=AIR
    )
    return built(ASSETS / "quadruped.obj", options, "small walker")


def fish() -> Body:
    """Return the fish of the paper's size; takes some seconds, so for slow tests."""
    return built(ASSETS / "fish.obj", BodyOptions(vertices=2118, modes=5), "fish")


@functools.cache
def pebble(medium: Medium | None = None, radii: tuple[float, ...] = (0.5, 0.12, 0.2)) -> Body:
    """Return a small flat ellipsoid that the kernel can simulate."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale(radii)
    options = BodyOptions(
        vertices=200, modes=3, basis=10, samples=10, drag_points=24, medium=medium or Medium()
    )
    with tempfile.TemporaryDirectory() as folder:
        mesh.export(Path(folder) / "pebble.stl")
        return build_body(Path(folder) / "pebble.stl", options)
