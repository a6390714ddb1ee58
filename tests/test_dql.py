"""Planner dql: training that learns and repeats itself, files that are refused when they do not fit."""

import dataclasses
import itertools

import numpy as np
import planning_samples as samples
import pytest
import torch

from defplan_mj.errors import DefplanError
from defplan_mj.planning.observation import features
from defplan_mj.planning.scenes import SceneBatch, k2_scenes, novel_scenes
from defplan_mj.planning.surrogate_env import run_on_surrogate
from defplan_mj.task import Navigation
from defplan_solvers.dql import SOLVER, DqlPlanner, QNetwork
from defplan_solvers.dql_training import Recipe, train

NAVIGATION = Navigation()
SMALL = Recipe(
    transitions=4000,
    robots=32,
    scenes=200,
    batch=32,
    buffer=4000,
    checkpoints=2,
    validation=10,
    novel=5,
)


def silent(message, fraction):
    pass


def random_network(seed=0, inputs=69):
    generator = np.random.default_rng(seed)
    sizes = [inputs, 8, 8, 3]
    return QNetwork(
        tuple(
            generator.normal(size=(b, a)).astype(np.float32) for a, b in itertools.pairwise(sizes)
        ),
        tuple(generator.normal(size=b).astype(np.float32) for b in sizes[1:]),
    )


def planner(**kwargs):
    return DqlPlanner(random_network(**kwargs), ("forward", "left", "right"), 10.0, 2, {"seed": 0})


def observation():
    generator = np.random.default_rng(3)
    return {"laser": generator.uniform(0, 10, 64), "target": generator.normal(0, 8, 3)}


def test_the_network_in_numpy_is_the_one_in_torch():
    network = random_network()
    layers = []
    for weight, bias in zip(network.weights, network.biases, strict=True):
        linear = torch.nn.Linear(*weight.shape[::-1])
        linear.load_state_dict({"weight": torch.tensor(weight), "bias": torch.tensor(bias)})
        layers += [linear, torch.nn.Softplus()]
    inputs = np.random.default_rng(1).normal(size=(20, 69)).astype(np.float32)
    with torch.no_grad():
        expected = torch.nn.Sequential(*layers[:-1])(torch.from_numpy(inputs)).numpy()
    assert np.allclose(network(inputs), expected, rtol=1e-5, atol=1e-5)


def test_features_tell_near_and_far_targets_and_sides_apart():
    laser = np.array([10.0, 2.5, 0.0])
    row = features(laser, np.array([3.0, -4.0]), 10.0)
    expected = [0, 0.75, 1, 0.6, -0.8, np.log(6) / 3, 0.25, np.exp(-2.5)]
    assert row.dtype == np.float32 and np.allclose(row, expected, atol=1e-6)


def test_training_repeats_itself_to_the_bit_whatever_was_drawn_before():
    surrogate = samples.surrogate()
    first, curves, meta = train(surrogate, NAVIGATION, 0, SMALL, 60, silent)
    np.random.seed(5)  # noqa: NPY002 (stable-baselines3 draws from the global generator)
    torch.manual_seed(5)
    again, _, _ = train(surrogate, NAVIGATION, 0, SMALL, 60, silent)
    other, _, _ = train(surrogate, NAVIGATION, 1, SMALL, 60, silent)
    assert all(np.array_equal(a, b) for a, b in zip(first.weights, again.weights, strict=True))
    assert not np.array_equal(first.weights[0], other.weights[0])
    assert meta["transitions"] == 4000 and not meta["stopped_early"]
    assert {len(curve) for curve in curves.values()} == {2}


def test_training_stops_at_the_limit_of_time_and_still_gives_a_network():
    network, curves, meta = train(samples.surrogate(), NAVIGATION, 0, SMALL, 0.0, silent)
    assert meta["stopped_early"] and network.weights[0].shape == (64, 69)


def test_training_tells_its_progress_up_to_the_end():
    told = []
    train(samples.surrogate(), NAVIGATION, 0, SMALL, 60, lambda message, done: told.append(done))
    assert told == sorted(told) and told[-1] == 1


def test_training_leaves_the_number_of_torch_threads_as_it_was():
    before = torch.get_num_threads()
    train(
        samples.surrogate(), NAVIGATION, 0, dataclasses.replace(SMALL, transitions=200), 60, silent
    )
    assert torch.get_num_threads() == before


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_training_learns_to_reach_k2_and_most_novel_targets(seed):
    recipe = Recipe(transitions=150_000, buffer=150_000, checkpoints=8)
    surrogate = samples.surrogate()
    network, _, _ = train(surrogate, NAVIGATION, seed, recipe, 600, silent)

    def act(laser, target, robots):
        return network(features(laser, target, 10.0)).argmax(1)

    k2 = SceneBatch.of(k2_scenes(NAVIGATION, seed))
    novel = SceneBatch.of(novel_scenes(NAVIGATION, 200, seed + 50))
    assert run_on_surrogate(surrogate, NAVIGATION, k2, act).rate() == 1
    assert run_on_surrogate(surrogate, NAVIGATION, novel, act).rate() > 0.85


def test_a_saved_planner_gives_the_same_values_to_the_bit(tmp_path):
    path = tmp_path / "policy.npz"
    SOLVER.save(planner(), path)
    loaded = SOLVER.load(path, samples.surrogate(), NAVIGATION)
    assert np.array_equal(loaded.values(observation()), planner().values(observation()))
    assert loaded.meta == {"seed": 0}


def test_policies_that_do_not_fit_are_refused_in_one_sentence(tmp_path):
    path = tmp_path / "policy.npz"
    SOLVER.save(planner(), path)
    with pytest.raises(DefplanError, match="wants 69 inputs, this task's laser .* give 37"):
        SOLVER.load(path, samples.surrogate(), Navigation(beams=32))
    renamed = dataclasses.replace(samples.surrogate(), task_names=("forward", "port", "right"))
    with pytest.raises(DefplanError, match="forward, left, right, not for forward, port, right"):
        SOLVER.load(path, renamed, NAVIGATION)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(DefplanError, match="cut short or damaged"):
        SOLVER.load(path, samples.surrogate(), NAVIGATION)
    with pytest.raises(DefplanError, match="does not exist"):
        SOLVER.load(tmp_path / "nothing.npz", samples.surrogate(), NAVIGATION)
