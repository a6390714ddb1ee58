"""Episodes on the reduced dynamics: what is counted, and that nothing but the scene matters."""

import dataclasses

import numpy as np
import pytest

from defplan_mj.base.statistics import wilson_interval
from defplan_mj.body.model import Body
from defplan_mj.dynamics.world import WATER
from defplan_mj.gait.gait import Gait
from defplan_mj.host.evaluation import (
    Episode,
    EvaluationResult,
    evaluate,
    run_episode,
)
from defplan_mj.host.navigation import robot_environment
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.planner import Observation
from defplan_mj.planning.robot import Robot
from defplan_mj.task import Navigation
from defplan_tasks.environments import ASSETS
from tests.samples import planning as samples

NAVIGATION = Navigation()
MEASURED = ("wall", "decision")


class Fixed:
    """Always chooses the same gait."""

    def __init__(self, gait: int) -> None:
        self.gait = gait
        self.observations: list[Observation] = []

    def reset(self):
        self.observations = []

    def values(self, observation):
        self.observations.append(observation)
        return np.eye(3)[self.gait]


class Note:
    """A recorder that keeps all it is told."""

    def __init__(self):
        self.steps: list[tuple] = []
        self.cycles: list[tuple] = []
        self.begun: tuple = ()
        self.ended: tuple = ()

    def begin(self, context, scene):
        self.begun = (context, scene)

    def step(self, time, x, target_shape, clearance):
        self.steps.append((time, x, target_shape, clearance))

    def cycle(self, index, time, x, gait_index, values, reward, laser):
        self.cycles.append((index, time, x, gait_index, values, reward, laser))

    def end(self, outcome, reason=""):
        self.ended = (outcome, reason)


@pytest.fixture(scope="module")
def robot():
    """Return the packaged fish."""
    return Robot(Body.load(ASSETS / "fish_body.npz"), Gait.load(ASSETS / "fish_gait.npz"), WATER)


@pytest.fixture(scope="module")
def env(robot):
    return robot_environment(robot, NAVIGATION, lambda random: samples.scene())


def scenes():
    return [
        samples.scene(target=(3.0, 0.0), max_cycles=12),
        samples.scene([(2.5, 0.0, 0.6)], target=(10.0, 0.0), max_cycles=12),
        samples.scene(target=(-5.0, 0.0), max_cycles=3),
    ]


def facts(episode: Episode) -> dict:
    return {k: v for k, v in dataclasses.asdict(episode).items() if k not in MEASURED}


def test_the_interval_is_wilsons():
    # Values of the score interval from Newcombe, Stat. Med. 17 (1998), table I, method 3.
    assert np.allclose(wilson_interval(81, 263), (0.2553, 0.3662), atol=5e-5)
    assert np.allclose(wilson_interval(15, 148), (0.0624, 0.1605), atol=5e-5)
    assert np.allclose(wilson_interval(0, 20), (0, 0.1611), atol=5e-5)
    assert np.allclose(wilson_interval(1, 29), (0.0061, 0.1718), atol=5e-5)


def test_episodes_end_in_success_collision_and_time_out(env):
    success, collision, timeout = (run_episode(env, scene, Fixed(0)) for scene in scenes())
    assert success.outcome == "success" and success.distance <= 1
    assert collision.outcome == "collision" and collision.closest < 0
    assert collision.reward < -900
    assert timeout.outcome == "timeout" and timeout.cycles == 3
    assert np.isclose(timeout.seconds, 3 * 11 * 0.04)
    assert success.path >= 3 - 1 - 1e-6


def test_an_episode_does_not_depend_on_what_was_run_before(env):
    alone = facts(run_episode(env, scenes()[0], Fixed(0)))
    run_episode(env, scenes()[1], Fixed(1))
    assert facts(run_episode(env, scenes()[0], Fixed(0))) == alone


def test_the_recorder_hears_every_step_and_cycle(env):
    note, planner = Note(), Fixed(0)
    episode = run_episode(env, scenes()[0], planner, note, {"task": "test"})
    context, scene = note.begun
    assert context["task"] == "test" and context["timestep"] == 0.01375
    assert context["state"].shape == (28,) and scene.max_cycles == 12
    assert len(note.steps) == round(episode.seconds / 0.01375)
    assert len(note.cycles) == episode.cycles == len(planner.observations)
    assert np.array_equal(note.cycles[0][2], context["state"])
    for i, (index, time, x, gait, _, _, laser) in enumerate(note.cycles):
        assert index == i and gait == 0 and np.isclose(time, i * 0.44)
        assert np.array_equal(laser, planner.observations[i]["laser"])
        if i:
            assert np.array_equal(x, note.steps[32 * i - 1][1])
    assert note.ended[0] == "success" and "reached the target" in note.ended[1]
    assert env.task.step_hook is None


def test_rates_and_intervals_are_those_of_the_episodes():
    def episode(index, outcome):
        return Episode(index, outcome, 10, 4.4, 1.0, 0.5, 1.0, 5.0, 0.1, 0.1, 1e-3)

    outcomes = ["success"] * 7 + ["collision"] * 2 + ["timeout"]
    result = EvaluationResult(tuple(episode(i, o) for i, o in enumerate(outcomes)))
    data = result.to_json()
    assert (data["episodes"], data["success"], data["collision"], data["timeout"]) == (
        10,
        0.7,
        0.2,
        0.1,
    )
    assert data["interval"]["success"] == list(wilson_interval(7, 10))
    assert np.isclose(data["real_time_factor"], 44) and len(data["rows"]) == 10


def test_the_result_does_not_depend_on_the_number_of_processes(robot):
    told = []
    results = [
        evaluate(
            robot,
            samples.surrogate(),
            NAVIGATION,
            Fixed(0),
            scenes(),
            shield=False,
            workers=workers,
            progress=lambda message, fraction: told.append(fraction),
        )
        for workers in (1, 2)
    ]
    one, two = ([facts(episode) for episode in result.episodes] for result in results)
    assert one == two
    assert [episode["outcome"] for episode in one] == ["success", "collision", "timeout"]
    assert [episode["index"] for episode in one] == [0, 1, 2]
    assert told == sorted(told[:3]) * 2 and told[-1] == 1


def test_the_shield_turns_a_collision_away(robot):
    surrogate = fit_surrogate(robot.dynamics, robot.gait, 20)
    ahead = scenes()[1:2]
    bare, shielded = (
        evaluate(robot, surrogate, NAVIGATION, Fixed(0), ahead, shield=shield, workers=1)
        for shield in (False, True)
    )
    assert bare.episodes[0].outcome == "collision"
    assert shielded.episodes[0].outcome == "timeout"
