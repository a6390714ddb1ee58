"""The motion tree against rollouts of the rigid dynamics, and what the shield lets pass."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.planning.frames import attitude_frames, turns
from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.outcome import COLLISION
from defplan_mj.planning.planner import Planner, carried_out
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import novel_scenes
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate_env import run_on_surrogate
from defplan_mj.task import Navigation
from tests.samples import planning as samples

NAVIGATION = Navigation()
SPATIAL = Navigation(space="spatial", beams=128, k2=30)
BOTH = pytest.mark.parametrize(
    ("navigation", "surrogate"),
    [(NAVIGATION, samples.surrogate()), (SPATIAL, samples.swimmer())],
    ids=["planar", "spatial"],
)


class Stubborn:
    """Prefers gaits in a fixed order."""

    def __init__(self, *values):
        self.fixed = np.array(values, float)
        self.resets = 0

    def reset(self):
        self.resets += 1

    def values(self, observation):
        self.seen = observation
        return self.fixed


def looking_at(*points):
    """Return an observation whose laser sees points (m, left of forward is positive y)."""
    laser = np.full(64, 10.0)
    for x, y in points:
        beam = round(np.arctan2(y, x) / (2 * np.pi / 64)) % 64
        laser[beam] = min(laser[beam], np.hypot(x, y))
    return {"laser": laser, "target": np.array([10.0, 0, 0]), "state": np.zeros(3)}


@BOTH
def test_the_tree_ends_where_the_rigid_dynamics_ends(navigation, surrogate):
    d, gaits, depth = navigation.dimension, len(surrogate.task_names), 3
    tree, dynamics = (
        MotionTree(surrogate.motions(navigation.space), (1,) * depth),
        RigidDynamics(surrogate),
    )
    last = gaits + gaits**2
    assert len(tree.end) == last + gaits**3
    for index, sequence in enumerate(itertools.product(range(gaits), repeat=depth)):
        pose = dynamics.rollout(dynamics.rest_state(), np.array(sequence))
        assert np.allclose(tree.end[last + index], pose[-1, :d], atol=1e-5)
        assert np.allclose(tree.start[last + index], pose[-2, :d], atol=1e-5)
        assert np.allclose(
            tree.end_frames[last + index], attitude_frames(pose[-1:, 3:], d)[0], atol=1e-5
        )


@BOTH
def test_distances_to_the_tree_agree_with_the_way_sampled_finely(navigation, surrogate):
    tree = MotionTree(surrogate.motions(navigation.space), (1, 1, 1))
    points = np.random.default_rng(0).uniform(-3, 3, (30, navigation.dimension))
    start, end, way = tree.distances2(points)
    share = np.linspace(0, 1, 2001)[:, None, None]
    ways = tree.start + share * (tree.end - tree.start)
    for i, point in enumerate(points):
        distance = np.linalg.norm(ways - point, axis=2)
        assert np.allclose(np.sqrt(way[i]), distance.min(0), atol=1e-3)
        assert np.allclose(np.sqrt(start[i]), distance[0], atol=1e-3)
        assert np.allclose(np.sqrt(end[i]), distance[-1], atol=1e-3)


def test_a_turned_world_leaves_the_shields_choice_as_it_is():
    # The robot is turned about its own axis by a quarter: its four turns change places.
    shield = Shield(Stubborn(*5 * [0]), samples.swimmer(), SPATIAL)
    quarter = turns(np.array([0, 0, np.pi / 2]))
    generator = np.random.default_rng(0)
    places = {"front": "left", "left": "back", "back": "right", "right": "front"}
    names = samples.swimmer().task_names
    moved = [names.index(places.get(name, name)) for name in names]
    decided = 0
    for _ in range(30):
        points = generator.uniform(-1.5, 1.5, (4, 3))
        safe = shield.safe(points)
        assert np.array_equal(shield.safe(points @ quarter.T)[moved], safe)
        decided += not safe.all()
    assert decided >= 10


def test_a_first_gait_counts_only_if_a_whole_sequence_is_free():
    tree = MotionTree(samples.surrogate().motions("planar"), (1, 1))
    free = np.zeros(12, bool)
    free[[0, 1, 3 + 4]] = True  # gaits 0 and 1 first; after them only the sequence 1, 1
    assert list(tree.first_gaits(free)) == [False, True, False]
    assert list(tree.first_gaits(free, 1)) == [True, True, False]


def test_nothing_in_sight_leaves_the_values_as_they_are():
    shield = Shield(Stubborn(3, 1, 2), samples.surrogate(), NAVIGATION)
    assert np.array_equal(shield.values(looking_at()), [3, 1, 2])


def test_a_wall_ahead_devalues_the_gait_that_swims_into_it():
    shield = Shield(Stubborn(3, 1, 2), samples.surrogate(), NAVIGATION)
    wall = [(1.1, y) for y in np.linspace(-0.8, 0.8, 17)]
    values = shield.values(looking_at(*wall))
    assert np.argmax(values) == 2  # the best of those that turn away
    assert values[0] < values[1:].min()


@BOTH
def test_points_out_of_reach_have_no_say(navigation, surrogate):
    shield = Shield(Stubborn(0), surrogate, navigation)
    everything = Shield(Stubborn(0), surrogate, navigation)
    everything.reach = np.inf
    generator, decided = np.random.default_rng(1), 0
    for spread in np.repeat([1.5, 2.5, 4.0, 8.0], 15):
        points = generator.uniform(-spread, spread, (20, navigation.dimension))
        safe = shield.safe(points)
        assert np.array_equal(safe, everything.safe(points))
        decided += not safe.all()
    assert decided >= 10


def test_the_planner_is_told_what_is_safe_and_so_what_is_done():
    pilot = Stubborn(3, 1, 2)
    shield = Shield(pilot, samples.surrogate(), NAVIGATION)
    values = shield.values(looking_at(*((1.1, y) for y in np.linspace(-0.8, 0.8, 17))))
    assert list(pilot.seen["safe"]) == [False, True, True]
    assert carried_out(pilot.fixed, pilot.seen) == np.argmax(values) == 2
    assert carried_out(pilot.fixed, {}) == 0


@BOTH
@pytest.mark.parametrize("seed", range(20))
def test_at_least_one_gait_is_always_allowed_and_never_a_hit_if_one_misses(
    navigation, surrogate, seed
):
    generator = np.random.default_rng(seed)
    gaits = len(surrogate.task_names)
    shield = Shield(Stubborn(*gaits * [0]), surrogate, navigation)
    points = generator.uniform(-2, 2, (generator.integers(1, 40), navigation.dimension))
    safe = shield.safe(points)
    assert safe.any()
    # Whether a cycle hits, by brute force along its way.
    ways = np.linspace(0, 1, 200)[:, None, None] * surrogate.motions(navigation.space).translations
    distance = np.linalg.norm(ways[:, :, None] - points, axis=3).min((0, 2))
    touches = distance < surrogate.radius - 1e-3
    if not touches.all():
        assert not (safe & touches).any()


def test_a_robot_that_turns_in_place_may_do_so_before_a_wall_but_not_creep_into_it():
    surrogate = samples.swimmer()
    shield = Shield(Stubborn(*5 * [0]), surrogate, SPATIAL)
    across = np.linspace(-0.6, 0.6, 7)
    wall = np.array([(x, y, 0.75) for x in across for y in across])  # 0.2 m from the body
    assert list(shield.safe(wall)) == [True, True, True, True, False]
    beside = wall[:, [2, 0, 1]] - [0.13, 0, 0]  # in front, 0.07 m from the body
    safe = shield.safe(beside)
    assert not safe[0]  # its slip leads towards the wall
    assert safe[1]


@BOTH
def test_the_shield_keeps_a_blind_planner_from_colliding(navigation, surrogate):
    batch = SceneBatch.of(novel_scenes(navigation, 30, 0))
    ahead = surrogate.translations[np.linalg.norm(surrogate.translations, axis=1).argmax()]
    towards = np.pad(batch.targets, ((0, 0), (0, 3 - navigation.dimension)))
    facing = [Rotation.align_vectors(one[None], ahead[None])[0] for one in towards]
    attitudes = np.array([rotation.as_quat(scalar_first=True) for rotation in facing])
    scenes = replace(batch, orientations=attitudes)
    straight = surrogate.task_names.index("forward")
    values = [float(i == straight) - 0.1 * i for i in range(len(surrogate.task_names))]
    pilots: list[Planner] = [Stubborn(*values) for _ in range(len(scenes))]
    shields: list[Planner] = [Shield(pilot, surrogate, navigation) for pilot in pilots]
    rates = {}
    for shielded, robot in ((False, pilots), (True, shields)):

        def act(laser, target, robots, robot=robot):
            seen = zip(robots, laser, target, strict=True)
            return np.array(
                [robot[i].values({"laser": a, "target": b}).argmax() for i, a, b in seen]
            )

        rates[shielded] = run_on_surrogate(surrogate, navigation, scenes, act).rate(COLLISION)
    assert rates[False] > 0.6 and rates[True] <= 0.05


def test_a_new_episode_resets_the_wrapped_planner():
    pilot = Stubborn(0, 0, 0)
    Shield(pilot, samples.surrogate(), NAVIGATION).reset()
    assert pilot.resets == 1


def test_an_obstacle_that_comes_nearer_is_unsafe_before_it_is_near():
    shield = Shield(Stubborn(3, 1, 2), samples.surrogate(), NAVIGATION)
    ahead = np.array([[5.0, y] for y in np.linspace(-1.0, 1.0, 9)])
    assert shield.safe(ahead).all()
    coming = np.tile([-0.9, 0.0], (9, 1))
    assert list(shield.safe(ahead, coming)) == [False, True, True]  # it has to turn at once
    assert shield.safe(ahead, -coming).all()


def test_distances_to_moving_points_agree_with_the_way_sampled_finely():
    tree = MotionTree(samples.surrogate().motions("planar"), (1, 2))
    generator = np.random.default_rng(3)
    points, drift = generator.uniform(-3, 3, (12, 2)), generator.uniform(-1, 1, (12, 2))
    _, _, way = tree.distances2(points, drift)
    share = np.linspace(0, 1, 2001)[:, None, None]
    robot = tree.start + share * (tree.end - tree.start)
    when = tree.begun[:, None] + share
    for i in range(len(points)):
        distance = np.linalg.norm(robot - (points[i] + when * drift[i]), axis=2)
        assert np.allclose(np.sqrt(way[i]), distance.min(0), atol=2e-3)


def test_a_choice_that_is_kept_for_some_cycles_is_their_rollout():
    surrogate = samples.surrogate()
    tree, dynamics = MotionTree(surrogate.motions("planar"), (2, 3)), RigidDynamics(surrogate)
    for branch, (one, two) in enumerate(itertools.product(range(3), repeat=2)):
        pose = dynamics.rollout(dynamics.rest_state(), np.array([one] * 2 + [two] * 3))
        assert np.allclose(tree.end[-9 + branch], pose[-1, :2], atol=1e-5)
    room = np.arange(3 * 2 + 9 * 3, dtype=float)
    best = [
        max(min(room[[k, 3 + k, *(6 + 3 * k + j + 9 * i for i in range(3))]]) for j in range(3))
        for k in range(3)
    ]
    assert list(tree.best_room(room)) == best
