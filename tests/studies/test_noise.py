"""Disturbed sensing and robots: what is read, what the robot is, and what the rows say."""

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.body.model import Body
from defplan_mj.cli.text import noise_text
from defplan_mj.dynamics.world import WATER
from defplan_mj.gait.gait import Gait
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scenes import novel_scenes
from defplan_mj.studies.noise import DISTURBANCES, Disturbance, Disturbed, measure_noise
from defplan_mj.task import Navigation
from defplan_tasks.environments import ASSETS

NEAR = Navigation(distance=6.0)
NAMED = {one.name: one for one in DISTURBANCES}


class Listener:
    """A planner that keeps what it is told."""

    def __init__(self):
        self.told = []

    def reset(self):
        pass

    def values(self, observation):
        self.told.append(observation)
        return np.zeros(3)


def heard(name: str, strength: float, times: int = 1, seed: int = 0):
    listener, sense = Listener(), NAMED[name].sense
    assert sense is not None
    planner = Disturbed(listener, sense, strength, NEAR, seed)
    true = {"laser": np.linspace(1.0, 10.0, 64), "target": np.array([5.0, 1.0, 0.5])}
    kept = {key: value.copy() for key, value in true.items()}
    for _ in range(times):
        planner.reset()
        planner.values(true)
    assert all(np.array_equal(true[key], kept[key]) for key in true)  # what is true stays so
    return true, listener.told


@pytest.mark.parametrize("name", [one.name for one in DISTURBANCES if one.sense])
def test_noise_is_of_the_scene_and_the_seed(name):
    true, (first, again) = heard(name, NAMED[name].strengths[-1], times=2)
    assert all(np.array_equal(first[key], again[key]) for key in true)
    assert any(not np.array_equal(first[key], true[key]) for key in true)
    _, (nothing,) = heard(name, 0.0)
    assert all(np.array_equal(nothing[key], true[key]) for key in true)


def test_each_disturbance_does_what_it_says():
    true, (told,) = heard("laser noise", 0.1)
    assert 0.05 < np.std(told["laser"] - true["laser"]) < 0.15 and told["laser"].max() <= 10.0
    true, (told,) = heard("dropped beams", 0.4)
    lost = told["laser"] != true["laser"]
    assert 10 < lost.sum() < 40 and np.all(told["laser"][lost] == 10.0)
    true, (told,) = heard("laser turns slowly", 0.1)
    assert told["laser"][50] == true["laser"][45] and told["laser"][0] == true["laser"][0]
    true, (told,) = heard("target noise", 1.0)
    assert told["target"][2] == 0.5 and not np.any(told["target"][:2] == true["target"][:2])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(Body.load(ASSETS / "fish_body.npz"), Gait.load(ASSETS / "fish_gait.npz"), WATER)


def test_a_heavier_robot_and_more_drag_swim_differently(robot):
    def way(who: Robot) -> float:
        dynamics = who.dynamics
        shapes = np.tile(who.gait.table()[0], (2, 1))
        return dynamics.rollout(dynamics.rest_state(), shapes)[-1][0]

    mass, drag = NAMED["mass"].change, NAMED["drag"].change
    assert mass is not None and drag is not None
    heavy, slick = mass(robot, 0.2), drag(robot, -0.2)
    assert heavy.body.mass == pytest.approx(1.2 * robot.body.mass)
    assert slick.world.medium.density == pytest.approx(0.8 * 1000)
    assert len({round(way(who), 6) for who in (robot, heavy, slick)}) == 3


def test_rows_begin_undisturbed_and_say_how_episodes_end(robot):
    surrogate = fit_surrogate(robot.dynamics, robot.gait, 6)
    greedy = registry.get_solver("greedy", "planner").train(surrogate, NEAR, 0).planner
    measured = [
        Disturbance("dropped beams", "", (1.0,), sense=NAMED["dropped beams"].sense),
        Disturbance("mass", "", (0.2,), change=NAMED["mass"].change),
    ]
    scenes = novel_scenes(NEAR, 3, 0, obstacles=0)
    rows = measure_noise(robot, surrogate, NEAR, greedy, scenes, measured)
    assert [row["disturbance"] for row in rows] == ["none", "dropped beams", "mass"]
    assert rows[0]["success"] == 1 and rows[1]["success"] == 1  # no obstacle that could be missed
    assert all(row["interval"][0] <= row["success"] <= row["interval"][1] for row in rows)
    assert "dropped beams" in noise_text({"task": "fish-swim", "planner": "greedy", "rows": rows})
