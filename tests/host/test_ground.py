"""Walkers in MuJoCo: the kernel's contact to the bit, heights above the terrain, and falls."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Heightfield, Terrain, TerrainGeom
from defplan_mj.dynamics.world import World
from defplan_mj.gait.gait import Gait
from defplan_mj.host.evaluation import evaluate
from defplan_mj.host.navigation import navigation_environment
from defplan_mj.host.physics import Physics
from defplan_mj.host.render import render_states
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.planning.robot import Robot
from defplan_mj.task import Navigation
from tests.samples import host as samples
from tests.samples.planning import surrogate

TIMESTEP = 0.02


def _physics(terrain: Terrain) -> Physics:
    spec = build_spec(samples.walker(), TIMESTEP, max_obstacles=2, terrain=terrain)
    return Physics.from_mjmodel(compile_model(spec))


@pytest.fixture(scope="module")
def dynamics() -> ReducedDynamics:
    return ReducedDynamics(samples.walker(), TIMESTEP, Terrain())


@pytest.fixture(scope="module")
def still() -> Gait:
    """Return a gait of one task that hardly moves the legs."""
    body = samples.walker()
    shape = (1, 2, body.n_modes)
    alpha, beta = np.full(shape, 0.01), np.zeros(shape)
    mu = np.zeros(shape[1:])
    return Gait(body.hash, ("stand",), TIMESTEP, 10, alpha, beta, mu, body.amplitude)


def _environment(still: Gait, terrain: Terrain, scene=None):
    shown = scene or samples.scene([], yaw=0.7)
    return navigation_environment(
        samples.walker(), still, Navigation(), lambda random: shown, terrain=terrain, scene=shown
    )


def _put(physics: Physics, lean: float = 0.0, height: float | None = None) -> None:
    """Lean the standing robot to a side by an angle, rad, with its centre of mass at a height."""
    turned = np.empty(4)
    mujoco.mju_mulQuat(turned, np.array([np.cos(lean / 2), np.sin(lean / 2), 0, 0]),
                       physics.data.qpos[3:7].copy())  # fmt: skip
    physics.data.qpos[3:7] = turned
    if height is not None:
        physics.data.qpos[2] = height
    physics.forward()


def test_steps_on_the_ground_equal_the_python_face_to_the_bit(dynamics):
    model = _physics(Terrain()).model.ptr
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    x, carried = dynamics.rest_state(), 0
    data.qpos[:], data.qvel[:], data.act[:] = np.split(x, [model.nq, model.nq + model.nv])
    for control in 0.4 * np.sin(np.cumsum(generator.normal(0, 0.3, (100, dynamics.nu)), axis=0)):
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        x = dynamics.step(x, samples.walker().amplitude * control)
        assert np.array_equal(np.concatenate([data.qpos, data.qvel, data.act]), x)
        carried += dynamics.contacts(x).total[2] > 0
    assert carried > 50  # the feet were on the ground


def test_height_is_that_above_planes_boxes_and_balls():
    terrain = Terrain(
        (
            TerrainGeom("plane", position=(0, 0, -0.5)),
            TerrainGeom("box", (1.0, 1.0, 0.2), (5, 0, 0)),
            TerrainGeom("sphere", (1.0,), (0, 5, 0)),
        )
    )
    physics = _physics(terrain)
    for position, height in (
        ((0, 0, 1), 1.5), ((5.5, 0.5, 1), 0.8), ((6.5, 0, 1), 1.5),
        ((0, 5, 3), 2.0), ((0, 5.6, 3), 2.2), ((0, 6.1, 3), 3.5),
    ):  # fmt: skip
        samples.place(physics, position)
        assert physics.height() == pytest.approx(height, abs=1e-9)


def test_height_is_that_above_the_points_of_a_heightfield():
    heights = np.random.default_rng(0).uniform(-0.3, 0.5, (5, 7))
    field = Heightfield(heights, (3.0, 2.0), (0.4, -0.2, 0.1))
    physics = _physics(Terrain((), field))
    for row, y in enumerate(np.linspace(-2.0, 2.0, 5)[1:-1], 1):
        for column, x in enumerate(np.linspace(-3.0, 3.0, 7)[1:-1], 1):
            samples.place(physics, (0.4 + x, -0.2 + y, 2.0))
            expected = 2.0 - 0.1 - heights[row, column]
            assert physics.height() == pytest.approx(expected, abs=1e-5)
    samples.place(physics, (9.0, 0.0, 2.0))
    assert physics.height() == -1


def test_swimmers_have_no_ground():
    physics = samples.physics()
    assert not physics.walks and physics.height() == -1


def test_the_laser_sees_obstacles_but_not_the_terrain(still):
    wall = TerrainGeom("box", (0.5, 5.0, 5.0), (4, 0, 0))
    environment = _environment(
        still, Terrain((TerrainGeom("plane"), wall)), samples.scene([(0.0, 5.0, 1.0)])
    )
    laser = environment.reset().observation["laser"]
    assert laser[0] == 10.0 and laser[16] == pytest.approx(4.0, abs=1e-6)


def test_terrain_is_no_obstacle_and_standing_is_no_fall(dynamics, still):
    environment = _environment(still, Terrain())
    environment.reset()
    physics, rest = environment.physics, dynamics.rest_state()
    assert physics.walks and physics.height() == pytest.approx(rest[2], abs=1e-12)
    assert physics.yaw() == pytest.approx(0.7, abs=1e-3)
    for _ in range(5):
        environment.step(0)
    assert environment.task.outcome == "running" and environment.task.closest == 1.0
    assert physics.height() == pytest.approx(rest[2], rel=0.1)


def test_an_evaluation_of_a_walker_is_on_its_terrain(still):
    class Stand:
        def reset(self):
            pass

        def values(self, observation):
            return np.zeros(1)

    ahead = samples.scene([], target=(5.0, 0.0, 0.0), max_cycles=3)
    paths = []
    for terrain in (Terrain(), None):
        walker = samples.walker()
        robot = Robot(walker, still, World(walker.medium, terrain))
        result = evaluate(robot, surrogate(), Navigation(), Stand(), [ahead], shield=False)
        [episode] = result.episodes
        assert episode.outcome == "timeout" and episode.cycles == 3
        paths.append(episode.path)
    # 0.6 s: it stands, or drops by g t^2 / 2 = 1.77 m
    assert paths[0] < 0.05 and paths[1] == pytest.approx(1.77, abs=0.1)


@pytest.mark.parametrize(("lean", "outcome"), [(50.0, "running"), (65.0, "fall")])
def test_leaning_by_more_than_60_degrees_is_a_fall(still, lean, outcome):
    environment = _environment(dataclasses.replace(still, steps_per_cycle=1), Terrain())
    environment.reset()
    _put(environment.physics, np.radians(lean), height=3.0)  # in the air
    step = environment.step(0)
    assert environment.task.outcome == outcome
    assert step.last() == (outcome == "fall")
    assert step.discount == (0.0 if outcome == "fall" else 1.0)


def test_sinking_below_half_the_standing_height_is_a_fall(dynamics, still):
    environment = _environment(dataclasses.replace(still, steps_per_cycle=1), Terrain())
    standing = dynamics.rest_state()[2]
    for share, outcome in ((1.0, "running"), (0.6, "running"), (0.35, "fall")):
        environment.reset()
        environment.step(0)
        _put(environment.physics, height=share * standing)
        fallen = environment.task._fallen(environment.physics)
        assert fallen == (outcome == "fall")


@pytest.mark.usefixtures("rendering")
def test_the_ground_is_drawn_under_the_feet(dynamics):
    dark = []
    for terrain in (Terrain(), None):
        [frame] = render_states(
            samples.walker(),
            dynamics.rest_state(),
            size=(160, 120),
            camera="side",
            terrain=terrain,
        )
        dark.append((frame.astype(int).sum(2)[60:110, 50:110] < 230).sum())
    assert dark[0] > dark[1] + 100  # the body's shadow is between its feet, not metres below
