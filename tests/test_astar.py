"""Planners astar and greedy, and the map of remembered laser points."""

import numpy as np
import planning_samples as samples
import pytest

from defplan_mj.errors import DefplanError
from defplan_mj.planning.scenes import SceneBatch, novel_scenes
from defplan_mj.planning.surrogate_env import SurrogateEnv, run_on_surrogate
from defplan_mj.task import Navigation
from defplan_solvers import astar, greedy
from defplan_solvers.laser_map import LaserMap

NAVIGATION = Navigation()


def rate(planner_of, scenes, surrogate):
    """Return the success of one planner for each scene, on the surrogate."""
    batch = SceneBatch.of(scenes)
    planners = [planner_of() for _ in scenes]

    def act(laser, target, robots):
        return np.array(
            [
                planners[robot].values({"laser": scan, "target": np.append(place, 0)}).argmax()
                for robot, scan, place in zip(robots, laser, target, strict=True)
            ]
        )

    return run_on_surrogate(surrogate, NAVIGATION, batch, act).rate()


def wall_with_target_behind():
    """Return a wall of cylinders, 6 m wide, straight between start and target."""
    circles = [(5.0, y, 0.4) for y in np.linspace(-3, 3, 11)]
    return samples.scene(circles, target=(10.0, 0.0), max_cycles=60)


def test_astar_goes_round_a_wall_and_greedy_does_not():
    surrogate, scenes = samples.surrogate(), [wall_with_target_behind()]
    assert rate(lambda: astar.AstarPlanner(surrogate, NAVIGATION), scenes, surrogate) == 1
    assert rate(lambda: greedy.GreedyPlanner(surrogate, NAVIGATION), scenes, surrogate) == 0


@pytest.mark.parametrize("solver", [astar.SOLVER, greedy.SOLVER])
def test_all_reach_the_target_where_nothing_is_in_the_way(solver):
    surrogate, scenes = samples.surrogate(), novel_scenes(NAVIGATION, 5, 0, obstacles=0)
    assert rate(lambda: solver.train(surrogate, NAVIGATION, 0).planner, scenes, surrogate) == 1


@pytest.mark.slow
def test_astar_reaches_nearly_all_novel_targets_on_the_surrogate():
    surrogate, scenes = samples.surrogate(), novel_scenes(NAVIGATION, 50, 3)
    assert rate(lambda: astar.AstarPlanner(surrogate, NAVIGATION), scenes, surrogate) >= 0.94


def test_the_map_keeps_points_where_they_are_though_the_robot_never_knows_how_it_turned():
    surrogate = samples.surrogate(scatter=0.08)
    scene = samples.scene([(4, 2, 0.7), (6, -2, 1.0), (2, -3, 0.5), (9, 1, 1.2)], target=(20.0, 0))
    batch = samples.batch(scene)
    env = SurrogateEnv(surrogate, NAVIGATION, batch, generator=np.random.default_rng(1), noise=1.0)
    memory = LaserMap(surrogate.planar(), NAVIGATION.laser_range)
    laser, target = env.observe()
    for gait in [0, 1, 0, 2, 0, 2, 1, 0, 0, 1]:
        points = memory.update(laser[0], target[0])
        memory.chose(gait)
        step = env.step(np.array([gait]))
        laser, target = step.laser, step.target
    points = memory.update(laser[0], target[0])
    cosine, sine = np.cos(env.yaw[0]), np.sin(env.yaw[0])
    world = env.position[0] + points @ np.array([[cosine, sine], [-sine, cosine]])
    centres, radii = scene.centres[:, :2], scene.radii
    error = np.abs(np.linalg.norm(world[:, None] - centres, axis=2) - radii).min(1)
    assert len(points) > 20 and np.median(error) < 0.1 and np.quantile(error, 0.95) < 0.4


def test_the_map_forgets_what_a_beam_passes():
    memory = LaserMap(samples.surrogate().planar(), 10.0)
    seen = np.full(64, 10.0)
    seen[:3], seen[-2:] = 3.0, 3.0
    memory.update(seen, np.array([10.0, 0.0]))
    memory.chose(0)
    free = memory.update(np.full(64, 10.0), np.array([9.35, 0.0]))
    assert len(free) == 0


def test_a_reset_forgets_the_map():
    memory = LaserMap(samples.surrogate().planar(), 10.0)
    memory.update(np.full(64, 3.0), np.array([10.0, 0.0]))
    memory.reset()
    assert len(memory.points) == 0


@pytest.mark.parametrize("solver", [astar.SOLVER, greedy.SOLVER])
def test_planners_without_training_have_files_too(solver, tmp_path):
    path, surrogate = tmp_path / "policy.npz", samples.surrogate()
    solver.save(solver.train(surrogate, NAVIGATION, 0).planner, path)
    planner = solver.load(path, surrogate, NAVIGATION)
    values = planner.values({"laser": np.full(64, 10.0), "target": np.array([5.0, 0, 0])})
    assert values.argmax() == 0 and not solver.needs_training
    other = greedy.SOLVER if solver is astar.SOLVER else astar.SOLVER
    with pytest.raises(DefplanError, match=f"a policy of {solver.name}, not of {other.name}"):
        other.load(path, surrogate, NAVIGATION)
