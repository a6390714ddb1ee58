"""Planners that are told all obstacles: they find ways that are free, the same ones every time."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.planning.frames import attitude_frames
from defplan_mj.planning.planner import needs_obstacles
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Motions
from defplan_mj.task import Navigation
from defplan_solvers.search import astar_map, rrt
from defplan_solvers.search.full_map import clearances, surface_points
from tests.samples import planning as samples

PLANAR, SPATIAL = Navigation(), Navigation(space="spatial", beams=128, k2=30)
PLANNERS = pytest.mark.parametrize(
    "solver", [astar_map.SOLVER, rrt.SOLVER], ids=["astar-map", "rrt"]
)


def steer(planner, scene, surrogate, navigation):
    """Steer the surrogate itself through a scene; return its outcome and the gaits."""
    d, motions = navigation.dimension, surrogate.motions(navigation.space)
    position = np.zeros((1, d))
    frames = attitude_frames(scene.orientation[None], d)
    gaits: list[int] = []
    planner.reset()
    while len(gaits) < scene.max_cycles:
        centres = (scene.centres[:, :d] - position) @ frames[0]
        target = np.zeros(3)
        target[:d] = (scene.target[:d] - position[0]) @ frames[0]
        told = {"target": target, "obstacles": np.column_stack([centres, scene.radii])}
        gait = int(planner.values(told).argmax())
        one = Motions(motions.rotations[[gait]], motions.translations[[gait]])
        _, _, way = clearances(told["obstacles"], np.zeros(d), np.eye(d), one)
        gaits.append(gait)
        if way[0] < surrogate.radius:
            return "collision", gaits
        position, frames = one.after(position, frames)
        if np.linalg.norm(scene.target[:d] - position[0]) <= scene.goal_radius:
            return "success", gaits
    return "timeout", gaits


def pocket():
    """Return a pocket that opens towards the start, with the target behind its bottom."""
    bottom = [(7.0, y, 0.4) for y in np.linspace(-2.4, 2.4, 7)]
    sides = [(x, side, 0.4) for x in np.linspace(3.4, 6.6, 5) for side in (-2.6, 2.6)]
    return samples.scene([*bottom, *sides], target=(11.0, 0.0), max_cycles=120)


@PLANNERS
def test_the_way_out_of_a_pocket_is_found_without_a_touch(solver):
    surrogate = samples.surrogate()
    planner = solver.train(surrogate, PLANAR, 0).planner
    outcome, gaits = steer(planner, pocket(), surrogate, PLANAR)
    assert outcome == "success" and len(gaits) > 11 / 0.65  # longer than the straight way
    assert steer(planner, pocket(), surrogate, PLANAR)[1] == gaits  # the same, every time


@PLANNERS
def test_spheres_are_passed_in_space(solver):
    surrogate = samples.swimmer()
    wall = [(4.5, y, z, 0.6) for y in (-1.5, 0, 1.5) for z in (-1.5, 0, 1.5)]
    scene = samples.spheres(wall, target=(8.0, 0, 0), max_cycles=120)
    planner = solver.train(surrogate, SPATIAL, 0).planner
    assert steer(planner, scene, surrogate, SPATIAL)[0] == "success"


@PLANNERS
def test_an_environment_that_tells_no_obstacles_is_one_sentence(solver):
    planner = solver.train(samples.surrogate(), PLANAR, 0).planner
    with pytest.raises(DefplanError, match="has to be told where all obstacles are"):
        planner.values({"target": np.array([5.0, 0, 0]), "laser": np.full(64, 10.0)})


@PLANNERS
def test_the_shield_passes_the_need_on(solver):
    surrogate = samples.surrogate()
    planner = solver.train(surrogate, PLANAR, 0).planner
    assert needs_obstacles(Shield(planner, surrogate, PLANAR))


@pytest.mark.parametrize("d", [2, 3])
def test_clearances_are_those_of_points_along_the_way(d):
    rng = np.random.default_rng(d)
    obstacles = np.column_stack([rng.normal(size=(6, d)) * 3, rng.uniform(0.2, 1, 6)])
    motions = Motions(np.repeat(np.eye(d)[None], 4, 0), rng.normal(size=(4, d)))
    frame, _ = np.linalg.qr(rng.normal(size=(d, d)))
    position = rng.normal(size=d)
    start, end, way = clearances(obstacles, position, frame, motions)
    for k, move in enumerate(motions.translations):
        points = position + np.linspace(0, 1, 2001)[:, None] * (frame @ move)
        away = np.linalg.norm(points[:, None] - obstacles[:, :d], axis=2) - obstacles[:, d]
        dense = away.min(1)
        assert (start[k], end[k]) == pytest.approx((dense[0], dense[-1]))
        assert way[k] == pytest.approx(dense.min(), abs=1e-5)


@pytest.mark.parametrize("d", [2, 3])
def test_surface_points_lie_on_the_surfaces_and_leave_no_hole(d):
    centre = np.zeros(d)
    centre[0] = 4.0
    points = surface_points(np.array([[*centre, 1.5]]), 0.4, 20.0)
    assert np.linalg.norm(points - centre, axis=1) == pytest.approx(1.5)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(apart, np.inf)
    assert apart.min(1).max() < 0.5
    assert len(surface_points(np.array([[*centre, 1.5]]), 0.4, 2.0)) == 0  # out of reach
