"""Planner dql-paper: the paper's networks and figures, and a training that repeats itself."""

import dataclasses

import numpy as np
import pytest
import torch
from torch.nn import functional

from defplan_mj.base.errors import DefplanError
from defplan_mj.planning.scenes import training_scenes
from defplan_mj.planning.sensors.laser import beam_directions
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.task import Navigation
from defplan_solvers.dql import dql
from defplan_solvers.dql.beams import taps
from defplan_solvers.dql.paper import DqlPaperSolver, PaperConfiguration
from defplan_solvers.dql.paper_training import PaperNetwork, nearest_obstacles, pretrain
from tests.samples import planning as samples

NAVIGATION = Navigation()
SPATIAL = Navigation(k2=30, beams=128, space="spatial")
ROBOTS = [
    pytest.param(samples.surrogate, NAVIGATION, id="planar"),
    pytest.param(samples.swimmer, SPATIAL, id="spatial"),
]
SMALL = PaperConfiguration(
    iterations=2,
    cycles=20,
    updates=5,
    pretraining=5,
    pretraining_batch=16,
    checkpoints=2,
    novel=3,
)


def observation(beams):
    generator = np.random.default_rng(3)
    return {"laser": generator.uniform(0, 10, beams), "target": generator.normal(0, 8, 3)}


def test_the_configuration_is_the_papers():
    paper = PaperConfiguration()
    assert paper.iterations == 10_000 and paper.batch == 32 and paper.hidden == (64, 64, 64)
    # Table II: memory bank of K2 x N2 x 10 = 20k samples.
    assert NAVIGATION.k2 * paper.cycles * paper.memory == 20_000


def test_the_cnn_has_the_papers_filters_and_sees_a_ring():
    torch.manual_seed(0)
    network = PaperNetwork(NAVIGATION, 3, (64, 64, 64))
    cnn = network.cnn
    assert [tuple(f.weight.shape) for f in cnn.filters] == [(16, 8), (16, 64), (16, 64)]
    assert cnn.dense.out_features == 32
    seen = []
    cnn.dense.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    laser = torch.rand(5, 64) * 10
    with torch.no_grad():
        cnn(laser)
        expected = 1 - laser[:, None] / 10
        for filters in cnn.filters:  # an ordinary convolution of the scan, repeated around
            ring = torch.cat([expected, expected], -1)
            width = filters.weight.shape[1] // expected.shape[1]
            weight = filters.weight.reshape(16, width, -1).transpose(1, 2)
            around = functional.conv1d(ring, weight, filters.bias)
            expected = functional.softplus(around[..., :64])
    assert torch.allclose(seen[0], expected.transpose(1, 2).flatten(1), atol=1e-6)


def test_filters_look_at_different_neighbours_of_each_beam_in_the_same_directions():
    beams, width = 128, 8
    directions = beam_directions(beams, "spatial")
    looks = taps(beams, "spatial", width)
    assert looks.shape == (beams, width) and np.array_equal(looks[:, 0], np.arange(beams))
    assert all(len(set(row)) == width for row in looks)
    apart = np.sqrt(4 * np.pi / beams)
    angle = np.arccos(np.clip(np.einsum("bwd,bd->bw", directions[looks], directions), -1, 1))
    assert angle.max() < 2.5 * apart and angle.mean() < 1.5 * apart
    # Each weight looks a golden angle further round than the last, from the east to the north.
    steps = directions[looks[:, 1:]] - directions[:, None]
    east = np.column_stack([-directions[:, 1], directions[:, 0], np.zeros(beams)])
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(directions, east)
    bearing = np.arctan2(
        np.einsum("bwd,bd->bw", steps, north), np.einsum("bwd,bd->bw", steps, east)
    )
    golden = np.pi * (3 - np.sqrt(5))
    assert (np.cos(bearing - golden * np.arange(1, width)) > 0.7).mean() > 0.9


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


@pytest.mark.parametrize(("robot", "navigation"), ROBOTS)
def test_pretraining_learns_where_obstacles_are(robot, navigation):
    torch.manual_seed(0)
    network = PaperNetwork(navigation, 3, (8,))
    arguments = (robot(), navigation, 0)

    def error(steps):
        configuration = dataclasses.replace(SMALL, pretraining=steps, pretraining_batch=64)
        return pretrain(network.cnn, *arguments, configuration, np.inf, lambda m, f: None)

    start = error(3)
    assert error(250) < 0.85 * start


@pytest.mark.parametrize(("robot", "navigation"), ROBOTS)
def test_training_repeats_itself_and_saves_what_it_learned(tmp_path, robot, navigation):
    solver = DqlPaperSolver(SMALL)
    surrogate, scene = robot(), observation(navigation.beams)
    first = solver.train(surrogate, navigation, 0)
    torch.manual_seed(7)
    again = solver.train(surrogate, navigation, 0)
    values = first.planner.values(scene)
    assert values.shape == (len(surrogate.task_names),)
    assert np.array_equal(values, again.planner.values(scene))
    stored = navigation.k2 * SMALL.cycles
    assert list(first.curves["transitions"]) == [stored, 2 * stored]
    assert np.all(first.curves["k2_reward_min"] <= first.curves["k2_reward_mean"])
    path = tmp_path / "policy.npz"
    solver.save(first.planner, path)
    loaded = solver.load(path, surrogate, navigation)
    assert np.array_equal(loaded.values(scene), values)
    with pytest.raises(DefplanError, match="a policy of dql-paper, not of dql"):
        dql.SOLVER.load(path, surrogate, navigation)
    fewer = dataclasses.replace(navigation, beams=32)
    with pytest.raises(DefplanError, match=f"for {navigation.beams} beams .* not for 32 in"):
        solver.load(path, surrogate, fewer)
    renamed = dataclasses.replace(surrogate, task_names=surrogate.task_names[::-1])
    with pytest.raises(DefplanError, match="was trained for the gaits"):
        solver.load(path, renamed, navigation)


def test_training_stops_at_the_limit_of_time():
    result = DqlPaperSolver(SMALL).train(samples.surrogate(), NAVIGATION, 0, seconds=0.0)
    assert result.planner.meta["iterations"] == 1 and len(result.curves["k2_success"]) == 1
