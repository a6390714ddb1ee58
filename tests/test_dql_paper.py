"""Planner dql-paper: the paper's networks and figures, and a training that repeats itself."""

import dataclasses

import numpy as np
import planning_samples as samples
import pytest
import torch

from defplan_mj.errors import DefplanError
from defplan_mj.planning.scenes import training_scenes
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.task import Navigation
from defplan_solvers import dql
from defplan_solvers.dql_paper import DqlPaperSolver, PaperConfiguration
from defplan_solvers.dql_paper_training import PaperNetwork, nearest_obstacles, pretrain

NAVIGATION = Navigation()
SMALL = PaperConfiguration(
    iterations=2,
    cycles=20,
    updates=5,
    pretraining=5,
    pretraining_batch=16,
    checkpoints=2,
    novel=3,
)


def observation():
    generator = np.random.default_rng(3)
    return {"laser": generator.uniform(0, 10, 64), "target": generator.normal(0, 8, 3)}


def test_the_configuration_is_the_papers():
    paper = PaperConfiguration()
    assert paper.iterations == 10_000 and paper.batch == 32 and paper.hidden == (64, 64, 64)
    # Table II: memory bank of K2 x N2 x 10 = 20k samples.
    assert NAVIGATION.k2 * paper.cycles * paper.memory == 20_000


def test_the_cnn_has_the_papers_filters_and_sees_a_ring():
    torch.manual_seed(0)
    network = PaperNetwork(64, 10.0, 3, (64, 64, 64))
    assert [tuple(f.weight.shape) for f in network.cnn.filters] == [
        (16, 1, 8),
        (16, 16, 4),
        (16, 16, 4),
    ]
    assert network.cnn.dense.out_features == 32
    # A scan turned by a beam gives the same filter outputs, turned by a beam.
    seen = []
    network.cnn.dense.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    laser = torch.rand(1, 64) * 10
    network.cnn(laser)
    network.cnn(laser.roll(1, 1))
    first, second = (x.view(16, 64) for x in seen)
    assert torch.allclose(first.roll(1, 1), second, atol=1e-6)


def test_the_nearest_obstacles_are_where_the_laser_sees_them():
    env = SurrogateEnv(
        samples.surrogate(),
        NAVIGATION,
        training_scenes(NAVIGATION, 50, 0),
        50,
        np.random.default_rng(0),
    )
    laser = env.step(np.ones(50, int)).laser
    wanted, visible = nearest_obstacles(env)
    assert visible[:, 0].sum() > 10
    for i in np.flatnonzero(visible[:, 0]):
        x, y = wanted[i, 0]
        beam = round(np.arctan2(y, x) / (2 * np.pi / 64)) % 64
        assert laser[i, beam] < np.hypot(x, y)


def test_pretraining_learns_where_obstacles_are():
    torch.manual_seed(0)
    network = PaperNetwork(64, 10.0, 3, (8,))
    arguments = (samples.surrogate(), NAVIGATION, 0)

    def error(steps):
        configuration = dataclasses.replace(SMALL, pretraining=steps, pretraining_batch=64)
        return pretrain(network.cnn, *arguments, configuration, np.inf, lambda m, f: None)

    start = error(3)
    assert error(250) < 0.85 * start


def test_training_repeats_itself_and_saves_what_it_learned(tmp_path):
    solver = DqlPaperSolver(SMALL)
    surrogate = samples.surrogate()
    first = solver.train(surrogate, NAVIGATION, 0)
    torch.manual_seed(7)
    again = solver.train(surrogate, NAVIGATION, 0)
    values = first.planner.values(observation())
    assert values.shape == (3,) and np.array_equal(values, again.planner.values(observation()))
    assert list(first.curves["transitions"]) == [200, 400]
    assert np.all(first.curves["k2_reward_min"] <= first.curves["k2_reward_mean"])
    path = tmp_path / "policy.npz"
    solver.save(first.planner, path)
    loaded = solver.load(path, surrogate, NAVIGATION)
    assert np.array_equal(loaded.values(observation()), values)
    with pytest.raises(DefplanError, match="a policy of dql-paper, not of dql"):
        dql.SOLVER.load(path, surrogate, NAVIGATION)
    with pytest.raises(DefplanError, match="trained for 64 beams"):
        solver.load(path, surrogate, Navigation(beams=32))


def test_training_stops_at_the_limit_of_time():
    result = DqlPaperSolver(SMALL).train(samples.surrogate(), NAVIGATION, 0, seconds=0.0)
    assert result.planner.meta["iterations"] == 1 and len(result.curves["k2_success"]) == 1
