"""The search in place and time, against rollouts and by hand, and the planners that are made of it."""

import numpy as np
import pytest

from defplan_mj.planning.outcome import SUCCESS
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import novel_scenes
from defplan_mj.planning.surrogate_env import SurrogateEnv, run_all
from defplan_mj.planning.tracking import Balls
from defplan_mj.task import Navigation
from defplan_solvers.search import foresight, oracle
from defplan_solvers.search.space_time import SpaceTime
from tests.samples import planning as samples

NAVIGATION = Navigation()
SPATIAL = Navigation(space="spatial", beams=128, k2=30)
NOTHING = Balls(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)))


def drive(surrogate, plan):
    """Return the places (n + 1, 2) of a way from rest."""
    motions, before = surrogate.switched_motions("planar"), surrogate.rest
    position, frame, places = np.zeros((1, 2)), np.eye(2)[None], [np.zeros(2)]
    for gait in plan:
        position, frame = motions.of((np.array([before]), np.array([gait]))).after(position, frame)
        places.append(position[0])
        before = gait
    return np.array(places)


def gaps(places, balls):
    """Return how close a way comes to each ball's surface, sampled finely, m."""
    share = np.linspace(0, 1, 200)[:, None]
    nearest = []
    for cycle, (a, b) in enumerate(zip(places[:-1], places[1:], strict=True)):
        robot = a + share * (b - a)
        ball = balls.centres + (cycle + share[:, None]) * balls.drift
        nearest.append((np.linalg.norm(robot[:, None] - ball, axis=2) - balls.radii).min(0))
    return np.min(nearest, axis=0)


def test_a_way_in_free_space_is_straight_and_ends_at_the_target():
    surrogate = samples.surrogate()
    plan, arrives = SpaceTime(surrogate, NAVIGATION).way(NOTHING, np.array([8.0, 0.0]), 3, 0.3)
    assert arrives and not plan.any()
    assert np.linalg.norm(drive(surrogate, plan)[-1] - [8, 0]) <= 1.0


@pytest.mark.parametrize("seed", range(6))
def test_a_way_among_moving_balls_keeps_its_margin_from_all_of_them(seed):
    generator = np.random.default_rng(seed)
    centres = generator.uniform([2, -6], [14, 6], (12, 2))
    balls = Balls(centres, generator.uniform(0.3, 1.0, 12), generator.uniform(-0.5, 0.5, (12, 2)))
    apart = np.linalg.norm(centres, axis=1) > balls.radii + 1.5
    balls = Balls(*(part[apart] for part in balls))
    surrogate, target = samples.surrogate(), np.array([16.0, 0.0])
    plan, arrives = SpaceTime(surrogate, NAVIGATION).way(balls, target, surrogate.rest, 0.2)
    places = drive(surrogate, plan)
    assert arrives and np.linalg.norm(places[-1] - target) <= 1.0
    assert gaps(places, balls).min() >= surrogate.radius + 0.2 - 1e-3


def test_a_way_waits_for_what_will_be_gone_and_not_for_what_stands():
    surrogate, target = samples.surrogate(), np.array([10.0, 0.0])
    search = SpaceTime(surrogate, NAVIGATION)
    y = np.arange(-30.0, 31.0, 0.9)
    wall = np.column_stack([np.full(len(y), 5.0), y])
    stands = Balls(wall, np.full(len(y), 0.5), np.zeros_like(wall))
    _, arrives = search.way(stands, target, surrogate.rest, 0.1)
    assert not arrives
    leaves = stands._replace(drift=np.tile([0.0, 2.5], (len(y), 1)))
    plan, arrives = search.way(leaves, target, surrogate.rest, 0.1)
    assert arrives and gaps(drive(surrogate, plan), leaves).min() >= surrogate.radius + 0.1 - 1e-3


def pilots(make, surrogate, navigation, env, knows):
    """Return an act function: a planner of its own for each robot."""
    planners = [make(surrogate, navigation) for _ in range(env.n)]

    def act(sight, robots):
        chosen = []
        for row, robot in enumerate(robots):
            observation = {"laser": sight.laser[row], "target": sight.target[row].astype(float)}
            if knows:
                there, frame = env.radii[robot] > 0, env.frames[robot]
                offset = (env.centres[robot] - env.position[robot]) @ frame
                drift = env.velocities[robot] @ frame * surrogate.cycle_seconds
                parts = (offset[there], env.radii[robot][there, None], drift[there])
                observation["obstacles"] = np.concatenate(parts, axis=1).astype(float)
            chosen.append(int(planners[robot].values(observation).argmax()))
        return np.array(chosen)

    return act


@pytest.mark.parametrize(
    ("robot", "navigation"),
    [
        pytest.param(samples.surrogate, NAVIGATION, id="planar"),
        pytest.param(samples.swimmer, SPATIAL, id="spatial"),
    ],
)
def test_the_bound_reaches_its_targets_among_what_moves(robot, navigation):
    surrogate = robot()
    batch = SceneBatch.of(novel_scenes(navigation, 5, 0, obstacle_speed=0.5))
    env = SurrogateEnv(surrogate, navigation, batch, generator=np.random.default_rng(0), noise=1.0)
    runs = run_all(env, pilots(oracle.OraclePlanner, surrogate, navigation, env, True))
    assert runs.rate(SUCCESS) == 1


def test_foresight_dodges_what_comes_its_way():
    surrogate = samples.surrogate(scatter=0.005)
    scene = samples.scene(
        [(9.0, 0.3, 1.0), (14.0, -0.2, 0.8)], target=(18.0, 0.0), velocities=[(-1.2, 0), (-1.0, 0)]
    )
    env = SurrogateEnv(surrogate, NAVIGATION, samples.batch(scene))
    runs = run_all(env, pilots(foresight.ForesightPlanner, surrogate, NAVIGATION, env, False))
    assert runs.rate(SUCCESS) == 1
