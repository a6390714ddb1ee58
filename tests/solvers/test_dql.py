"""Planner dql: training that learns and repeats itself, files that are refused when they do not fit."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from defplan_mj.base.errors import DefplanError
from defplan_mj.planning.observation import Senses
from defplan_mj.planning.outcome import COLLISION, RUNNING, SUCCESS
from defplan_mj.planning.places import POST
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import k2_scenes, novel_scenes
from defplan_mj.planning.sensors.laser import beam_directions
from defplan_mj.planning.surrogate_env import run_on_surrogate
from defplan_mj.task import Navigation
from defplan_solvers.dql.ablations import CHANGES, ablate
from defplan_solvers.dql.dql import CNN, SOLVER, DqlPlanner, QNetwork
from defplan_solvers.dql.laser_cnn import LaserCnn
from defplan_solvers.dql.training import Recipe, _build, _Checkpoints, _reward, _Robots, train
from tests.samples import planning as samples
from tests.samples.leftovers import left_in

NAVIGATION = Navigation()
SPATIAL = Navigation(k2=30, beams=128, space="spatial")
SMALL = Recipe(
    transitions=4000,
    robots=32,
    scenes=200,
    batch=32,
    buffer=4000,
    checkpoints=2,
    targets=5,
    standing=6,
    moving=4,
)


def silent(message, fraction):
    pass


def random_network(seed=0, inputs=149):
    generator = np.random.default_rng(seed)
    sizes = [inputs, 8, 8, 3]
    return QNetwork(
        tuple(
            generator.normal(size=(b, a)).astype(np.float32) for a, b in itertools.pairwise(sizes)
        ),
        tuple(generator.normal(size=b).astype(np.float32) for b in sizes[1:]),
    )


def planner(**kwargs):
    return DqlPlanner(random_network(**kwargs), samples.surrogate(), NAVIGATION, {"seed": 0})


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
    inputs = np.random.default_rng(1).normal(size=(20, 149)).astype(np.float32)
    with torch.no_grad():
        expected = torch.nn.Sequential(*layers[:-1])(torch.from_numpy(inputs)).numpy()
    assert np.allclose(network(inputs), expected, rtol=1e-5, atol=1e-5)


def test_the_cnn_in_numpy_is_the_one_in_torch_and_its_file_gives_it_again(tmp_path):
    small = dataclasses.replace(SMALL, convolutions=True, transitions=400)
    network, _, meta = train(samples.surrogate(), NAVIGATION, 0, small, 60, silent)
    torch.manual_seed(1)
    cnn = LaserCnn(64, "planar", 10.0)
    seen = np.random.default_rng(1).uniform(0, 1, (7, 64)).astype(np.float32)
    with torch.no_grad():
        expected = cnn.see(torch.from_numpy(seen)).numpy()
    assert np.allclose(cnn.frozen()(seen), expected, rtol=1e-5, atol=1e-5)
    made = DqlPlanner(network, samples.surrogate(), NAVIGATION, meta)
    assert network.inputs == made.senses.size and network.weights[0].shape == (64, 149 - 64 + 32)
    path = tmp_path / "policy.npz"
    CNN.save(made, path)
    again = CNN.load(path, samples.surrogate(), NAVIGATION)
    assert np.array_equal(again.values(observation()), made.values(observation()))
    with pytest.raises(DefplanError, match="policy"):
        CNN.load(path, samples.surrogate(), dataclasses.replace(NAVIGATION, beams=32))
    with pytest.raises(DefplanError, match="dql-cnn"):
        SOLVER.load(path, samples.surrogate(), NAVIGATION)


def test_a_training_leaves_no_temporary_file(temporary_files):
    before = left_in(temporary_files)
    train(samples.surrogate(), NAVIGATION, 0, dataclasses.replace(SMALL, transitions=64), 0, silent)
    assert left_in(temporary_files) == before


def test_the_cnn_is_trained_with_all_else():
    small = dataclasses.replace(SMALL, convolutions=True)
    model = _build(_Robots(samples.surrogate(), NAVIGATION, 0, small), 0, small)
    first = model.q_net.features_extractor.cnn.frozen()
    model.learn(3000)
    last = model.q_net.features_extractor.cnn.frozen()
    moved = [np.abs(a - b).max() for a, b in zip(first.filters, last.filters, strict=True)]
    assert min(moved) > 1e-3


def test_in_scenes_of_a_place_all_scenes_of_a_training_are_of_that_place():
    tunnel = Navigation(scenes="tunnel", room=samples.surrogate().radius)
    small = dataclasses.replace(SMALL, scenes=4, transitions=200)
    robots = _Robots(samples.surrogate(), tunnel, 0, small)
    robots.reset()
    radii = robots.robots.radii
    assert np.allclose(radii[radii > 0], POST)
    _, curves, _ = train(samples.surrogate(), tunnel, 0, small, 60, silent)
    assert "moving_success" not in curves


def test_features_tell_near_and_far_targets_sides_and_the_room_of_gaits_apart():
    senses = Senses(samples.walker(radius=0.9), Navigation(beams=4))
    laser = np.array([1.4, 10.0, 1.0, 10.0])  # ahead and behind
    row = senses(laser, np.array([3.0, -4.0]))
    sideways = np.hypot(1.0, 0.0) - 0.9  # the start of a cycle is the nearest to what is behind
    room = np.array([0.1, 1.0 - 0.4 - 0.9, sideways, sideways])
    expected = [0.86, 0, 0.9, 0, *4 * [0], 0.6, -0.8, np.log(6) / 3, 0.25, np.exp(-2.5)]
    expected = [*expected, 0, 0, 0, 0, 1, *np.tanh(room / 0.2), *np.exp(-np.maximum(room, -0.5))]
    assert row.dtype == np.float32 and len(row) == senses.size == len(expected) + 8
    assert np.allclose(row[:-8], expected, atol=1e-5)
    assert np.all(row[-8:-4] <= row[-16:-12])  # a sequence has no more room than its first cycle


def test_features_tell_what_comes_nearer_and_that_it_will_hit():
    senses, target = Senses(samples.surrogate(), NAVIGATION), np.array([8.0, 0.0])
    laser, drift = np.full(64, 10.0), np.zeros((64, 2))
    ahead = np.arange(-3, 4)
    laser[ahead] = 4.0
    standing = senses(laser, target, 0, drift)
    drift[ahead] = [-0.88, 0]  # 2 m/s in cycles of 0.44 s
    coming = senses(laser, target, 0, drift)
    assert not standing[64:128].any() and coming[64] == pytest.approx(1)
    assert np.all(standing[-6:-3] > 0.9) and np.all(coming[-6:-3] < 0)  # the best sequences' room
    assert list(standing[133:137]) == [1, 0, 0, 0]  # the gait before


@pytest.mark.parametrize(
    ("robot", "navigation"),
    [
        pytest.param(samples.surrogate, NAVIGATION, id="turning"),
        pytest.param(samples.walker, NAVIGATION, id="walking"),
        pytest.param(samples.swimmer, SPATIAL, id="spatial"),
    ],
)
def test_the_room_of_a_gait_is_what_its_way_sampled_finely_leaves(robot, navigation):
    surrogate = robot()
    laser = np.random.default_rng(0).uniform(0.3, 4, (5, navigation.beams)).astype(np.float32)
    directions = beam_directions(navigation.beams, navigation.space)
    ways = surrogate.motions(navigation.space).translations
    along = np.linspace(0, 1, 501)[:, None, None] * ways
    points = laser[:, :, None] * directions
    expected = [
        np.linalg.norm(along[:, :, None] - scan, axis=3).min((0, 2)) - surrogate.radius
        for scan in points
    ]
    senses, rest = Senses(surrogate, navigation), np.full(5, surrogate.rest)
    seen = np.ones(points.shape[:2], bool), np.zeros_like(points), rest
    assert np.allclose(senses.room(points, *seen)[:, : len(ways)], expected, atol=2e-3)
    none = [part[:0] for part in (points, *seen)]
    assert len(senses.room(*none)) == 0


@pytest.mark.parametrize(
    ("robot", "navigation", "layer"),
    [
        pytest.param(samples.surrogate, NAVIGATION, (64, 149), id="planar"),
        pytest.param(samples.swimmer, SPATIAL, (64, 288), id="spatial"),
    ],
)
def test_training_repeats_itself_to_the_bit_whatever_was_drawn_before(robot, navigation, layer):
    surrogate = robot()
    first, curves, meta = train(surrogate, navigation, 0, SMALL, 600, silent)
    np.random.seed(5)  # noqa: NPY002 (stable-baselines3 draws from the global generator)
    torch.manual_seed(5)
    again, _, _ = train(surrogate, navigation, 0, SMALL, 600, silent)
    other, _, _ = train(surrogate, navigation, 1, SMALL, 600, silent)
    assert all(np.array_equal(a, b) for a, b in zip(first.weights, again.weights, strict=True))
    assert not np.array_equal(first.weights[0], other.weights[0])
    assert first.weights[0].shape == layer
    assert meta["transitions"] == 4000 and not meta["stopped_early"]
    # the untrained planner, and two checkpoints
    assert {len(curve) for curve in curves.values()} == {3} and curves["transitions"][0] == 0


def test_rewards_of_a_cycle_are_those_the_recipe_names():
    robots = _Robots(samples.swimmer(), SPATIAL, 0, SMALL)
    step = dataclasses.replace(
        robots.robots.step(np.zeros(SMALL.robots, int)),
        progress=np.array([0.45, -0.9, 0.0], np.float32),
        reward=np.array([9.0, -18.0, -1000.0], np.float32),
        outcome=np.array([RUNNING, SUCCESS, COLLISION]),
    )
    rewards = {
        name: _reward(step, dataclasses.replace(SMALL, reward=name), 0.45)
        for name in ("progress", "goal", "eq2")
    }
    assert np.allclose(rewards["progress"], [1 - 0.05, -2 + 5 - 0.05, -10 - 0.05], atol=1e-6)
    assert np.allclose(rewards["goal"], [-0.05, 5 - 0.05, -10 - 0.05], atol=1e-6)
    assert np.array_equal(rewards["eq2"], step.reward)


def test_robots_train_in_varied_scenes_or_in_the_k2_scenes_alone():
    varied = _Robots(samples.swimmer(), SPATIAL, 3, SMALL).robots.batch
    fixed = _Robots(samples.swimmer(), SPATIAL, 3, dataclasses.replace(SMALL, k2_only=True))
    assert len(varied) == SMALL.scenes and len(fixed.robots.batch) == 30
    wanted = SceneBatch.of(k2_scenes(SPATIAL, 3))
    assert np.array_equal(fixed.robots.batch.targets, wanted.targets)


def test_the_network_is_chosen_by_scenes_that_no_evaluation_uses():
    chooses = _Checkpoints(samples.surrogate(), NAVIGATION, 0, SMALL, 60, silent).batch
    circles = np.dstack([chooses.centres, chooses.radii])
    known = {tuple(circle) for circle in circles.reshape(-1, 3) if circle[2] > 0}
    assert len(known) > 100
    for seed in range(4):  # the validation's own seed and those next to it
        for speed in (0.0, 0.25, 2.0):
            for scene in (
                *k2_scenes(NAVIGATION, seed, 40, obstacle_speed=speed),
                *novel_scenes(NAVIGATION, 200, seed, obstacle_speed=speed),
            ):
                circles = np.column_stack([scene.centres[:, :2], scene.radii])
                assert not known & {tuple(circle) for circle in circles}


def test_an_ablation_tries_the_chosen_network_on_k2_and_novel_scenes():
    recipe = dataclasses.replace(SMALL, **CHANGES["raw Eq. 2"])
    row = ablate(samples.swimmer(), SPATIAL, 0, recipe)
    again = ablate(samples.swimmer(), SPATIAL, 0, recipe)
    assert row.pop("cpu_seconds") > 0 and again.pop("cpu_seconds") > 0
    assert row == again and set(row) == {"k2", "novel", "novel_timeouts"}
    assert 0 <= row["novel"] + row["novel_timeouts"] <= 1


def test_training_stops_at_the_limit_of_time_and_still_gives_a_network():
    network, curves, meta = train(samples.surrogate(), NAVIGATION, 0, SMALL, 0.0, silent)
    assert meta["stopped_early"] and network.weights[0].shape == (64, 149)


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


def success(surrogate, navigation, network, scenes):
    senses = Senses(surrogate, navigation)

    def act(laser, target, robots):
        return network(senses(laser, target)).argmax(1)

    return run_on_surrogate(surrogate, navigation, SceneBatch.of(scenes), act).rate()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_training_learns_to_reach_k2_and_most_novel_targets(seed):
    recipe = Recipe(transitions=150_000, buffer=150_000, checkpoints=8)
    surrogate = samples.surrogate()
    network, _, _ = train(surrogate, NAVIGATION, seed, recipe, 600, silent)
    assert success(surrogate, NAVIGATION, network, k2_scenes(NAVIGATION, seed)) == 1
    novel = novel_scenes(NAVIGATION, 200, seed + 50)
    assert success(surrogate, NAVIGATION, network, novel) > 0.85


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1))
@pytest.mark.parametrize(
    ("robot", "navigation"),
    [
        pytest.param(samples.walker, NAVIGATION, id="wide walker"),
        pytest.param(samples.swimmer, SPATIAL, id="in space"),
    ],
)
def test_the_whole_training_learns_to_reach_k2_and_most_novel_targets(robot, navigation, seed):
    surrogate = robot()
    network, _, meta = train(surrogate, navigation, seed, Recipe(), 3600, silent)
    assert not meta["stopped_early"]
    assert success(surrogate, navigation, network, k2_scenes(navigation, seed)) == 1
    novel = novel_scenes(navigation, 200, seed + 50)
    assert success(surrogate, navigation, network, novel) > 0.85


@pytest.mark.slow
def test_without_a_reward_for_progress_a_robot_that_turns_in_place_learns_nothing():
    budget = Recipe(transitions=60_000, buffer=60_000, checkpoints=4)
    kept = ablate(samples.swimmer(), SPATIAL, 0, budget)
    lost = ablate(samples.swimmer(), SPATIAL, 0, dataclasses.replace(budget, reward="goal"))
    assert kept["k2"] > 0.8 and kept["novel"] > 0.7
    assert lost["k2"] < 0.1 and lost["novel"] < 0.1


def test_a_saved_planner_gives_the_same_values_to_the_bit(tmp_path):
    path = tmp_path / "policy.npz"
    SOLVER.save(planner(), path)
    loaded = SOLVER.load(path, samples.surrogate(), NAVIGATION)
    assert np.array_equal(loaded.values(observation()), planner().values(observation()))
    assert loaded.meta == {"seed": 0}


def test_policies_that_do_not_fit_are_refused_in_one_sentence(tmp_path):
    path = tmp_path / "policy.npz"
    SOLVER.save(planner(), path)
    with pytest.raises(DefplanError, match="wants 149 inputs, this task's laser, .* gaits give 85"):
        SOLVER.load(path, samples.surrogate(), Navigation(beams=32))
    renamed = dataclasses.replace(samples.surrogate(), task_names=("forward", "port", "right"))
    with pytest.raises(DefplanError, match="forward, left, right, not for forward, port, right"):
        SOLVER.load(path, renamed, NAVIGATION)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(DefplanError, match="cut short or damaged"):
        SOLVER.load(path, samples.surrogate(), NAVIGATION)
    with pytest.raises(DefplanError, match="does not exist"):
        SOLVER.load(tmp_path / "nothing.npz", samples.surrogate(), NAVIGATION)


@pytest.mark.parametrize(("seconds", "limit"), [(None, float("inf")), (5.0, 5.0)])
def test_the_clock_ends_a_training_only_if_that_is_asked_for_and_then_it_is_told(
    monkeypatch, seconds, limit
):
    def trained(surrogate, navigation, seed, recipe, allowed, progress):
        assert allowed == limit
        return None, {}, {"stopped_early": allowed < float("inf")}

    monkeypatch.setattr("defplan_solvers.dql.training.train", trained)
    result = SOLVER.train(samples.surrogate(), Navigation(), 0, seconds)
    assert result.cut_short is (seconds is not None)
