"""The way out of loops and dead ends."""

import numpy as np
import pytest

from defplan_mj.planning.frames import turns
from defplan_mj.planning.odometry import Odometry
from defplan_mj.planning.outcome import SUCCESS
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate_env import SurrogateEnv, run_on_surrogate
from defplan_mj.task import Navigation
from defplan_solvers.search.greedy import GreedyPlanner
from defplan_solvers.search.loops import SAME, VISIT, LoopBreaker
from tests.samples import planning as samples

NAVIGATION = Navigation()
SPATIAL = Navigation(space="spatial", beams=128, k2=30)
FORWARD, BACK, LEFT, RIGHT = range(4)


def lowered(loops, target, observation=None, gaits=4):
    """Return by how much equal values are lowered."""
    return -loops.adjust(np.zeros(gaits), np.asarray(target, float), observation or {})


def walk(loops, steps, values, safe=None):
    """Return the choices of a walker without drift that steps where the adjusted values say."""
    ways = np.array([[0.4, 0], [-0.4, 0], [0, 0.4], [0, -0.4]])
    target, chosen = np.array([20.0, 0.0]), []
    for _ in range(steps):
        observation = {} if safe is None else {"safe": safe}
        adjusted = loops.adjust(np.array(values, float), target, observation)
        gait = int((adjusted if safe is None else np.where(safe, adjusted, -np.inf)).argmax())
        target = target - ways[gait]
        chosen.append(gait)
    return chosen


def breaker(drift=0.0):
    surrogate = samples.walker(scatter=0.0)
    if not drift:
        object.__setattr__(surrogate, "rotations", np.tile(np.eye(3), (4, 1, 1)))
    return LoopBreaker(surrogate, NAVIGATION)


def test_on_a_straight_way_the_order_of_the_other_gaits_stays_and_going_back_costs_a_visit():
    loops = breaker()
    for i in range(10):
        cost = lowered(loops, [20 - 0.4 * i, 0.0])
        loops.odometry.chose(FORWARD)
    assert np.isclose(cost[BACK], VISIT * (1 + 2 * np.exp(-1 / SAME**2)), atol=0.01)
    assert np.isclose(cost[LEFT], cost[RIGHT]) and cost[FORWARD] < cost[LEFT] < 0.25 * cost[BACK]


def test_every_time_more_a_place_was_visited_it_costs_more():
    loops, costs = breaker(), []
    for i in range(8):  # to and fro
        costs.append(lowered(loops, [20 - 0.4 * (i % 2), 0.0]).copy())
        loops.odometry.chose(BACK if i % 2 else FORWARD)
    assert np.all(np.diff([cost[FORWARD] for cost in costs[::2]]) > 0.9 * VISIT)


def test_who_is_let_go_only_to_and_fro_still_prefers_the_less_visited_place():
    # The planner wants to go ahead, for ever; only sideways steps are safe. It must not believe
    # that it went ahead: the gait that is done is the one that counts.
    safe = np.array([False, False, True, True])
    chosen = walk(breaker(), 12, [3.0, 0.0, 0.5, 0.4], safe)
    assert set(chosen) == {LEFT} and len(chosen) == 12


def test_a_robot_that_walks_to_every_side_knows_a_place_again_whatever_its_heading():
    surrogate = samples.walker(scatter=0.0)
    loops = LoopBreaker(surrogate, NAVIGATION)
    env = SurrogateEnv(surrogate, NAVIGATION, samples.batch(samples.scene(target=(20.0, 0.0))))
    target = env.observe().target
    for gait in [FORWARD] * 15 + [BACK] * 14:  # drifts by 0.9 rad
        lowered(loops, target[0])
        loops.odometry.chose(gait)
        target = env.step(np.array([gait])).target
    cost = lowered(loops, target[0])
    ends = env.position[0] + 0.4 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1.0]]) @ env.frames[0].T
    assert cost.argmin() in np.argsort(np.linalg.norm(ends, axis=1))[2:] and cost.max() > VISIT


def test_a_robot_that_turns_in_its_place_may_turn_round_once():
    surrogate = samples.swimmer(scatter=0.0)
    loops = LoopBreaker(surrogate, SPATIAL)
    front, ahead = surrogate.task_names.index("front"), np.array([0.0, 0.0, 10.0])
    direction, costs = np.eye(3), []
    for _ in range(8):
        costs.append(lowered(loops, direction.T @ ahead, gaits=5))
        loops.odometry.chose(front)
        direction = direction @ turns(np.array([0.0, 0.35, 0.0]))
    back = surrogate.task_names.index("back")
    assert all(cost[front] < 0.5 * cost[back] for cost in costs[1:])


@pytest.mark.parametrize("seed", range(3))
def test_odometry_keeps_to_the_way_though_cycles_scatter(seed):
    surrogate, generator = samples.walker(scatter=0.05), np.random.default_rng(seed)
    scene = samples.batch(samples.scene(target=(20.0, 0.0)))
    env = SurrogateEnv(surrogate, NAVIGATION, scene, generator=generator, noise=1.0)
    odometry = Odometry(surrogate, NAVIGATION)
    position, frame = np.zeros(2), env.frames[0].astype(float)
    target = env.observe().target
    assert odometry.moved(target[0].astype(float)) is None
    for gait in generator.integers(0, 4, 60):
        odometry.chose(int(gait))
        target = env.step(np.array([gait])).target
        moved = odometry.moved(target[0].astype(float))
        assert moved is not None
        shift, turn = moved
        position, frame = position + frame @ shift, frame @ turn
    assert np.linalg.norm(position - env.position[0]) < 0.6
    assert np.allclose(frame, env.frames[0], atol=0.1)


class Remembering:
    """The greedy planner, with or without a way out of dead ends."""

    def __init__(self, surrogate, loops):
        self.greedy, self.loops = GreedyPlanner(surrogate, NAVIGATION), loops

    def reset(self):
        pass

    def values(self, observation):
        values = self.greedy.values(observation)
        if self.loops is None:
            return values
        return self.loops.adjust(values, observation["target"][:2], observation)


def test_a_walker_gets_out_of_a_dead_end_in_the_shield():
    surrogate = samples.walker()
    wall = [(6.0, y, 0.5) for y in np.arange(-2.4, 2.5, 0.6)]
    arms = [(x, y, 0.5) for x in (4.8, 5.4) for y in (-2.4, 2.4)]
    scene = samples.batch(samples.scene(wall + arms, target=(12.0, 0.0)))
    rates = {}
    for remembers in (False, True):
        loops = LoopBreaker(surrogate, NAVIGATION) if remembers else None
        pilot = Shield(Remembering(surrogate, loops), surrogate, NAVIGATION)

        def act(laser, target, robots, pilot=pilot):
            return np.array([pilot.values({"laser": laser[0], "target": target[0]}).argmax()])

        runs = run_on_surrogate(
            surrogate, NAVIGATION, scene, act, np.random.default_rng(0), noise=1.0
        )
        rates[remembers] = runs.rate(SUCCESS)
    assert rates == {False: 0.0, True: 1.0}


def test_a_reset_forgets():
    loops = breaker()
    first = lowered(loops, [20.0, 0.0])
    walk(loops, 10, [1.0, 0.0, 0.0, 0.0])
    loops.reset()
    assert np.array_equal(lowered(loops, [20.0, 0.0]), first)
