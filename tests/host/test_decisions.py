"""The navigation environment with more decisions than one a cycle, its logs, and what the surrogate says of it."""

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.dynamics.world import World
from defplan_mj.host.evaluation import evaluate
from defplan_mj.host.navigation import navigation_environment
from defplan_mj.log.compare import compare_logs
from defplan_mj.log.reader import read_log
from defplan_mj.log.recorder import Recorder
from defplan_mj.log.replay import replay_log
from defplan_mj.log.run_files import RunFiles
from defplan_mj.log.tables import table
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.outcome import Outcome
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.task import Navigation
from defplan_solvers.feedback.following import Follower
from tests.conftest import ASSETS
from tests.samples import host as samples
from tests.samples import planning

TWICE = Navigation(decisions_per_cycle=2)


@pytest.fixture(scope="module")
def robot(fish_gait):
    body = Body.load(ASSETS / "fish_body.npz")
    return Robot(body, fish_gait, World(body.medium))


@pytest.fixture(scope="module")
def halves(robot):
    return fit_surrogate(robot.dynamics, robot.gait, 40, decisions=2)


def environment(robot, navigation, scene):
    return navigation_environment(
        robot.body, robot.gait, navigation, lambda random: scene, scene=scene
    )


class Drawn:
    """Chooses gaits at random, the same ones in every episode."""

    def reset(self):
        self.generator = np.random.default_rng(0)

    def values(self, observation):
        return self.generator.random(3)


def test_a_gait_that_is_kept_gives_the_bits_of_one_decision_a_cycle(robot):
    scene = planning.scene(target=(20.0, 0.0), max_cycles=3)
    once, twice = (environment(robot, there, scene) for there in (Navigation(), TWICE))
    once.reset()
    twice.reset()
    for gait in (1, 0, 2):
        whole = once.step(gait)
        parts = [twice.step(gait) for _ in range(2)]
        assert np.array_equal(once.physics.reduced_state(), twice.physics.reduced_state())
        assert np.isclose(whole.reward, sum(part.reward for part in parts))
        assert np.array_equal(whole.observation["laser"], parts[1].observation["laser"])
    assert (once.task.cycles, twice.task.cycles, twice.task.decisions) == (3, 3, 6)
    assert once.task.outcome == twice.task.outcome == Outcome.TIMEOUT


def test_a_decision_plays_the_part_of_the_gait_that_comes_next(robot):
    env = environment(robot, Navigation(decisions_per_cycle=4), planning.scene(target=(20.0, 0.0)))
    env.reset()
    table_, x = robot.gait.table(), env.physics.reduced_state()
    for decision, gait in enumerate((0, 2, 1, 1, 0, 2)):
        env.step(gait)
        part = slice(decision % 4 * 8, (decision % 4 + 1) * 8)
        x = robot.dynamics.rollout(x, table_[gait, part])[-1]
        assert np.array_equal(env.physics.reduced_state(), x)


def test_a_cycle_that_has_no_such_parts_is_refused():
    body = samples.fish()
    with pytest.raises(DefplanError, match="11 steps has no 2 equal parts"):
        environment(Robot(body, samples.gait(), World(body.medium)), TWICE, planning.scene())


def test_what_follows_mean_cycles_does_not_begin_within_one():
    with pytest.raises(DefplanError, match="mean cycles follows whole ones"):
        Follower.begin(object.__new__(Follower), 0, np.zeros(28), 16)


def test_an_episode_of_half_cycles_is_logged_replayed_and_predicted(robot, halves, tmp_path):
    scene = planning.scene(
        [(4.0, 3.0, 0.5)], target=(20.0, 0.0), velocities=[(0.1, 0)], max_cycles=6
    )
    files = RunFiles.of_robot(robot, halves)
    result = evaluate(
        robot,
        halves,
        TWICE,
        Drawn(),
        [scene],
        shield=False,
        recorder=lambda index, there: Recorder(tmp_path / "half.mcap", files),
        context={"task": "fish-swim", "seed": 0, "navigation": TWICE, "feedback": "none"},
    )
    assert result.episodes[0].cycles == 6
    log = read_log(tmp_path / "half.mcap")
    assert not log.fault and log.decisions_per_cycle == 2 and len(log.gait_index) == 12
    assert np.all(np.diff(log.cycle_steps) == 16)
    assert replay_log(log).identical
    phase = table("steps", [log])["phase"]
    assert np.allclose(phase[:33], np.append(np.arange(32) / 32, 0))
    comparison = compare_logs([log])
    assert len(comparison.gait) == 12 and comparison.cycle.tolist() == sorted([*range(6)] * 2)
    assert comparison.position.max() < 0.1 and np.sqrt((comparison.position**2).mean()) < 0.03
    # the surrogate's environment goes the same way
    env = SurrogateEnv(halves, TWICE, SceneBatch.of([scene]))
    for i, gait in enumerate(log.gait_index):
        env.step(np.array([gait]))
        there = log.states[log.cycle_steps[i + 1], :2]
        assert np.linalg.norm(env.position[0] - there) < 0.05 + 0.05 * i


def test_a_surrogate_of_whole_cycles_does_not_judge_parts(robot, halves):
    with pytest.raises(DefplanError, match="the surrogate is of 2 decisions a gait cycle"):
        evaluate(robot, halves, Navigation(), Drawn(), [planning.scene()])
