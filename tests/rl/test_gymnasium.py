"""The suite for Gymnasium: one robot by MuJoCo, many by the kernel, and what they refuse."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import defplan_mj  # noqa: F401  registers the ids
from defplan_mj import suite
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.batch import Batch

SHAPES = ["defplan/FishSwim-v0", "defplan/QuadrupedSwim-v0", "defplan/QuadrupedWalk-v0"]
ALL = [*SHAPES, "defplan/FishNavigate-v0", "defplan/TeeWalk-v0", "defplan/TeeNavigate-v0"]
ALL += ["defplan/QuadrupedNavigate-v0", "defplan/QuadrupedNavigate3d-v0"]


def test_every_task_of_the_suite_has_an_id():
    names = {name for name in gymnasium.registry if name.startswith("defplan/")}
    assert names == set(ALL)
    assert len(names) == len(suite.ALL_TASKS)


@pytest.mark.parametrize("order", ["defplan_mj, gymnasium", "gymnasium, defplan_mj"])
def test_the_ids_are_there_in_whatever_order_things_are_imported(order):
    code = f"import {order}; assert gymnasium.spec('defplan/FishSwim-v0').id"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.filterwarnings("ignore:.*infinity")
@pytest.mark.parametrize("name", ALL)
def test_gymnasiums_checker_finds_nothing(name):
    env = gymnasium.make(name).unwrapped
    check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("name", SHAPES)
def test_many_robots_do_to_the_bit_what_each_does_in_mujoco(name):
    one, many = gymnasium.make(name), gymnasium.make_vec(name, num_envs=3)
    observation, _ = one.reset(seed=8)
    observations, _ = many.reset(seed=7)
    assert np.array_equal(observation, observations[1])
    random = np.random.default_rng(0)
    for _ in range(25):
        actions = random.uniform(-0.7, 0.7, many.action_space.shape)
        observation, reward, *ends, _ = one.step(actions[1])
        observations, rewards, *all_ends, _ = many.step(actions)
        assert np.array_equal(observation, observations[1])
        assert reward == rewards[1]
        assert ends == [bool(end[1]) for end in all_ends]
    one.close()
    many.close()


def test_a_seed_gives_the_same_episodes_whatever_the_threads(monkeypatch):
    runs = []
    for workers in (1, 2):
        env = gymnasium.make_vec("defplan/FishSwim-v0", num_envs=20, workers=workers)
        env.reset(seed=1)
        shape = env.action_space.shape
        assert shape is not None
        actions = np.random.default_rng(1).uniform(-1, 1, (5, *shape))
        runs.append([env.step(each)[0] for each in actions])
        env.close()
    assert np.array_equal(runs[0], runs[1])


def test_an_episode_ends_with_its_time_and_begins_anew_with_the_next_step():
    kwargs = {"time_limit": 0.05}
    env = gymnasium.make_vec("defplan/FishSwim-v0", num_envs=2, task_kwargs=kwargs)
    one = gymnasium.make("defplan/FishSwim-v0", task_kwargs=kwargs)
    env.reset(seed=0), one.reset(seed=0)
    still, ended = np.zeros((2, 5)), []
    alone: list[bool] = []
    for _ in range(5):
        observations, rewards, terminated, truncated, _ = env.step(still)
        ended.append(truncated.tolist())
        assert not terminated.any()
        if len(alone) < 4:
            alone.append(one.step(still[0])[3])
    assert ended == [[False] * 2] * 3 + [[True] * 2, [False] * 2]
    assert alone == [False] * 3 + [True]
    assert (rewards == 0).all()
    assert np.array_equal(observations[0], one.reset()[0])
    env.close()
    one.close()


@pytest.mark.parametrize(
    "action, words",
    [
        (np.full(5, 1.5), "1.5"),
        (np.full(5, np.nan), "nan"),
        (np.zeros(4), "shape"),
        ("left", "shape"),
    ],
)
def test_what_is_no_target_shape_is_refused_in_one_sentence(action, words):
    env = gymnasium.make("defplan/FishSwim-v0", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    with pytest.raises(DefplanError, match=words) as told:
        env.step(action)
    assert "\n" not in str(told.value)
    many = gymnasium.make_vec("defplan/FishSwim-v0", num_envs=2)
    many.reset(seed=0)
    with pytest.raises(DefplanError):
        many.step(np.full((2, 5), 1.5))
    env.close()
    many.close()


@pytest.mark.parametrize("action", [3, -1, 0.5, np.zeros(2), "left", None, True])
def test_what_is_no_gait_is_refused_in_one_sentence(action):
    env = gymnasium.make("defplan/FishNavigate-v0", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    with pytest.raises(DefplanError, match="0 to 2"):
        env.step(action)
    env.close()


@pytest.mark.parametrize("name", ALL)
def test_a_pickled_environment_goes_on_as_it_was(name):
    env = gymnasium.make(name).unwrapped
    env.reset(seed=4)
    action = env.action_space.sample()
    env.step(action)
    again = pickle.loads(pickle.dumps(env))
    assert np.array_equal(again.step(action)[0], env.step(action)[0])
    env.close()


def test_a_batch_steps_as_single_robots_and_says_who_failed():
    dynamics = suite.load("fish", "swim").task.dynamics
    batch, random = Batch(dynamics, 9), np.random.default_rng(2)
    batch.states[:, 7:12] = random.uniform(-0.3, 0.3, (9, 5))
    batch.states[4, 0] = np.inf
    before, shapes = copy.deepcopy(batch.states), random.uniform(-0.5, 0.5, (9, 5))
    assert np.flatnonzero(batch.step(shapes)).tolist() == [4]
    for i in (0, 3, 8):
        assert np.array_equal(batch.states[i], dynamics.step(before[i], shapes[i]))
    with pytest.raises(DefplanError, match="need"):
        batch.step(shapes[:3])


@pytest.mark.filterwarnings("ignore:.*infinity", "ignore:.*DISPLAY")
@pytest.mark.parametrize("task", ["swim", "navigate"])
def test_shimmy_makes_an_environment_of_the_suites_own(task):
    from shimmy import DmControlCompatibilityV0

    env = DmControlCompatibilityV0(suite.load("fish", task, task_kwargs={"random": 0}))
    check_env(env, skip_render_check=True)
    observation, *_ = env.step(env.action_space.sample())
    assert (
        set(observation) >= {"swim": {"shape", "velocity"}, "navigate": {"laser", "target"}}[task]
    )
    env.close()
