"""The suite keeps dm_control's contract; the tests follow dm_control/suite/suite_test.py."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any
from unittest import mock

import mujoco
import numpy as np
import pytest
from dm_control.rl import control
from mujoco import rollout

from defplan_mj import suite
from defplan_mj.base.errors import DefplanError
from defplan_tasks import environments
from tests.samples import host as samples

KWARGS: dict[tuple[str, str], Callable[[], dict[str, Any]]] = {
    ("fish", "swim"): lambda: {"body": samples.fish()},
    ("fish", "navigate"): lambda: {"body": samples.fish(), "gait": samples.gait()},
    ("quadruped", "swim"): lambda: {"body": samples.quadruped()},
    ("quadruped", "walk"): lambda: {"body": samples.walker()},
    ("quadruped", "navigate"): lambda: {"body": samples.walker(), "gait": samples.walker_gait()},
    ("tee", "walk"): lambda: {"body": samples.tee()},
    ("tee", "navigate"): lambda: {"body": samples.tee(), "gait": samples.tee_gait()},
    ("quadruped", "navigate3d"): lambda: {
        "body": samples.quadruped(),
        "gait": samples.quadruped_gait(),
    },
}
DOMAINS = {
    "fish": {"swim", "navigate"},
    "quadruped": {"swim", "navigate3d", "walk", "navigate"},
    "tee": {"walk", "navigate"},
}
PACKAGED = [
    names for names in KWARGS if names[0] in ("fish", "tee") or names[1] in ("walk", "navigate")
]
TASKS = [pytest.param(*names, id="-".join(names)) for names in KWARGS]
BENCHMARKS = [names for names in KWARGS if names[1] in ("swim", "walk")]
OBJECTS = {
    "body": "nbody",
    "joint": "njnt",
    "geom": "ngeom",
    "site": "nsite",
    "camera": "ncam",
    "light": "nlight",
    "texture": "ntex",
    "material": "nmat",
    "skin": "nskin",
    "actuator": "nu",
    "sensor": "nsensor",
    "numeric": "nnumeric",
    "text": "ntext",
}


# A fresh interpreter, as a spawned worker is.
ELSEWHERE = """
import pathlib, pickle, sys
import numpy as np
folder = pathlib.Path(sys.argv[1])
environment, actions = pickle.loads((folder / "environment.pickle").read_bytes())
out = {}
for i, action in enumerate(actions):
    for name, value in environment.step(action).observation.items():
        out[f"{name}{i}"] = value
np.savez(folder / "out.npz", **out)
"""


def _load(domain: str, task: str, random=None, **kwargs) -> control.Environment:
    task_kwargs = {**KWARGS[domain, task](), "random": random}
    return suite.load(domain, task, task_kwargs=task_kwargs, **kwargs)


def _policy(spec, seed):
    """Return a policy that acts uniformly at random within the spec."""
    generator = np.random.RandomState(seed)
    if np.issubdtype(spec.dtype, np.integer):
        return lambda: generator.randint(spec.minimum, spec.maximum + 1)
    return lambda: generator.uniform(spec.minimum, spec.maximum)


def _trajectory(environment, policy, episodes=3, steps=10):
    for _ in range(episodes):
        time_step = environment.reset()
        yield time_step
        for _ in range(steps):
            if time_step.last():
                break
            time_step = environment.step(policy())
            yield time_step


def test_all_tasks_are_listed():
    assert set(KWARGS) <= set(suite.ALL_TASKS)
    assert sum(len(tasks) for tasks in suite.TASKS_BY_DOMAIN.values()) == len(suite.ALL_TASKS)
    for domain, tasks in DOMAINS.items():
        assert set(suite.TASKS_BY_DOMAIN[domain]) == tasks
        for task in tasks & {"swim", "walk"}:
            assert (domain, task) in suite.BENCHMARKING


@pytest.mark.parametrize(("domain", "task"), PACKAGED)
def test_packaged_body_and_gait_load(domain, task):
    environment = suite.load(domain, task, task_kwargs={"random": 0})
    for time_step in _trajectory(environment, _policy(environment.action_spec(), 0), 1, 3):
        assert all(np.isfinite(array).all() for array in time_step.observation.values())


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_missing_packaged_file_is_one_sentence(domain, task, monkeypatch, tmp_path):
    monkeypatch.setattr(environments, "ASSETS", tmp_path)
    with pytest.raises(
        DefplanError, match=rf"{domain}\w*_body.npz is missing: reinstall defplan, or"
    ):
        suite.load(domain, task)


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_components_have_names(domain, task):
    model = _load(domain, task).physics.model
    for kind, size in OBJECTS.items():
        names = [model.id2name(index, kind) for index in range(getattr(model, size))]
        assert all(names), kind


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_model_has_at_least_two_cameras(domain, task):
    assert _load(domain, task).physics.model.ncam >= 2


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_task_conforms_to_its_spec(domain, task):
    environment = _load(domain, task)
    benchmark = (domain, task) in suite.BENCHMARKING
    observation_spec, action_spec = environment.observation_spec(), environment.action_spec()
    if benchmark:
        assert (action_spec.minimum == -1).all() and (action_spec.maximum == 1).all()
        assert action_spec.shape == (environment.physics.model.nu,)
    for time_step in _trajectory(environment, _policy(action_spec, 0)):
        assert set(time_step.observation) == set(observation_spec)
        for name, spec in observation_spec.items():
            array = time_step.observation[name]
            assert array.shape == spec.shape and array.dtype == spec.dtype == np.float64
            assert np.isfinite(array).all()
        if time_step.first():
            assert time_step.reward is None and time_step.discount is None
        else:
            assert isinstance(time_step.reward, float) and isinstance(time_step.discount, float)
            assert 0 <= time_step.discount <= 1
            assert not benchmark or 0 <= time_step.reward <= 1


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_environment_is_deterministic(domain, task):
    runs = []
    for _ in range(2):
        environment = _load(domain, task, random=5)
        runs.append(list(_trajectory(environment, _policy(environment.action_spec(), 5))))
    assert len(runs[0]) == len(runs[1])
    for one, two in zip(*runs, strict=True):
        assert (one.step_type, one.reward, one.discount) == (
            two.step_type,
            two.reward,
            two.discount,
        )
        for name, array in one.observation.items():
            assert np.array_equal(array, two.observation[name]), name


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_initial_state_is_randomised(domain, task):
    environment = _load(domain, task, random=42)
    first, second = environment.reset().observation, environment.reset().observation
    assert any((first[name] != second[name]).any() for name in first)


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_observations_share_no_memory(domain, task):
    environment = _load(domain, task)
    first, action = environment.reset(), _policy(environment.action_spec(), 0)()
    before = copy.deepcopy(first.observation)
    second = environment.step(action)
    for name, array in first.observation.items():
        assert not np.may_share_memory(array, second.observation[name])
        assert np.array_equal(array, before[name])
        for data in (environment.physics.data.qpos, environment.physics.data.qvel):
            assert not np.may_share_memory(array, data)


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_observations_have_no_constant_elements(domain, task):
    environment = _load(domain, task, random=0)
    policy = _policy(environment.action_spec(), 0)
    steps = list(_trajectory(environment, policy, episodes=100, steps=4))
    for name in environment.observation_spec():
        stacked = np.array([step.observation[name] for step in steps])
        assert (stacked != stacked[0]).any(axis=0).all(), name


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_environment_kwargs_are_passed_on(domain, task):
    environment = _load(domain, task, environment_kwargs={"flat_observation": True})
    assert set(environment.observation_spec()) == {control.FLAT_OBSERVATION_KEY}
    flat = environment.reset().observation[control.FLAT_OBSERVATION_KEY]
    whole = _load(domain, task).observation_spec()
    assert flat.shape == (sum(int(np.prod(spec.shape)) for spec in whole.values()),)


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_saved_states_replay_to_the_bit(domain, task):
    environment = _load(domain, task, random=1)
    environment.reset()
    physics = environment.physics
    shapes = np.random.default_rng(0).uniform(-1, 1, (40, physics.model.nu))

    def replay() -> np.ndarray:
        states = []
        for shape in shapes:
            physics.set_control(shape)
            physics.step()
            states.append(physics.get_state())
        return np.array(states)

    physics.step(7)
    saved = physics.get_state()
    first = replay()
    physics.set_state(saved)
    assert np.array_equal(replay(), first)
    with physics.reset_context():
        physics.set_state(saved)
    assert np.array_equal(replay(), first)


@pytest.mark.parametrize("domain, task", TASKS)
def test_whole_environments_go_on_alike_in_another_process(domain, task, tmp_path):
    environment = _load(domain, task, random=3)
    environment.reset()
    policy = _policy(environment.action_spec(), 0)
    actions = [policy() for _ in range(4)]
    environment.step(actions[0])
    (tmp_path / "environment.pickle").write_bytes(pickle.dumps((environment, actions[1:])))
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, tmp_path], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "out.npz") as out:
        for i, action in enumerate(actions[1:]):
            for name, value in environment.step(action).observation.items():
                np.testing.assert_array_equal(out[f"{name}{i}"], value)


@pytest.mark.parametrize(("domain", "task"), TASKS)
def test_copies_and_pickles_go_on_alike(domain, task):
    environment = _load(domain, task, random=1)
    environment.reset()
    physics = environment.physics
    physics.step(3)
    twins = [physics.copy(), physics.copy(share_model=True), pickle.loads(pickle.dumps(physics))]
    for one in (physics, *twins):
        assert type(one) is type(physics)
        one.set_control(np.full(one.model.nu, 0.3))
        one.step(9)
    for twin in twins:
        assert np.array_equal(twin.get_state(), physics.get_state())
        assert np.array_equal(twin.laser(), physics.laser())
        assert twin.clearance() == physics.clearance()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("domain", "task"), BENCHMARKS)
def test_rollout_of_the_model_equals_env_step(domain, task, threads):
    environment = _load(domain, task, random=3)
    environment.reset()
    model, full = environment.physics.model.ptr, mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = environment.physics.get_state(full)
    actions = np.random.default_rng(0).uniform(-1, 1, (50, model.nu))
    states, _ = rollout.rollout(
        model,
        [mujoco.MjData(model) for _ in range(threads)],
        np.tile(start, (4, 1)),
        np.tile(actions, (4, 1, 1)),
    )
    for index, action in enumerate(actions):
        environment.step(action)
        now = environment.physics.get_state(full)
        assert np.array_equal(states[:, index], np.tile(now, (4, 1)))


@pytest.mark.parametrize("names", [names for names in suite.REWARD_VIZ if names in KWARGS])
def test_reward_is_shown_as_colour(names):
    environment = _load(*names, visualize_reward=True)
    colours = environment.physics.named.model.mat_rgba
    for reward in (-3.0, 0.5, 2.0, 0.25):
        with mock.patch.object(environment.task, "get_reward", return_value=reward):
            environment.reset()
        blend = np.clip(reward, 0, 1) ** 4
        for name in ("self", "effector", "target"):
            expected = (
                blend * colours[f"{name}_highlight"] + (1 - blend) * colours[f"{name}_default"]
            )
            assert colours[name] == pytest.approx(expected, abs=1e-6)


def test_unknown_names_list_what_there_is():
    with pytest.raises(DefplanError, match=r"no domain fsh, did you mean fish\? There is: fish"):
        suite.load("fsh", "swim")
    with pytest.raises(
        DefplanError, match=r"fish has no task swin, did you mean swim\? There is: nav"
    ):
        suite.load("fish", "swin")
    with pytest.raises(DefplanError, match="has no task fly; there is: navigate, swim"):
        suite.load("fish", "fly")
