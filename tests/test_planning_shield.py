"""The motion tree against rollouts of the rigid dynamics, and what the shield lets pass."""

import itertools
from dataclasses import replace

import numpy as np
import planning_samples as samples
import pytest

from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.scenes import SceneBatch, level_attitude, novel_scenes
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate_env import COLLISION, run_on_surrogate
from defplan_mj.task import Navigation

NAVIGATION = Navigation()


class Stubborn:
    """Prefers gaits in a fixed order."""

    def __init__(self, *values):
        self.fixed = np.array(values, float)
        self.resets = 0

    def reset(self):
        self.resets += 1

    def values(self, observation):
        return self.fixed


def looking_at(*points):
    """Return an observation whose laser sees points (m, left of forward is positive y)."""
    laser = np.full(64, 10.0)
    for x, y in points:
        beam = round(np.arctan2(y, x) / (2 * np.pi / 64)) % 64
        laser[beam] = min(laser[beam], np.hypot(x, y))
    return {"laser": laser, "target": np.array([10.0, 0, 0]), "state": np.zeros(3)}


def test_the_tree_ends_where_the_rigid_dynamics_ends():
    surrogate = samples.surrogate()
    tree, dynamics = MotionTree(surrogate.planar(), 4), RigidDynamics(surrogate)
    last = 3 + 9 + 27
    for index, sequence in enumerate(itertools.product(range(3), repeat=4)):
        pose = dynamics.rollout(dynamics.rest_state(), np.array(sequence))
        assert np.allclose(tree.end[last + index], pose[-1, :2], atol=1e-5)
        assert np.allclose(tree.start[last + index], pose[-2, :2], atol=1e-5)


def test_distances_to_the_tree_agree_with_the_way_sampled_finely():
    tree = MotionTree(samples.surrogate().planar(), 3)
    points = np.random.default_rng(0).uniform(-3, 3, (50, 2))
    start, end, way = tree.distances2(points)
    share = np.linspace(0, 1, 2001)[:, None, None]
    ways = tree.start + share * (tree.end - tree.start)
    for i, point in enumerate(points):
        distance = np.linalg.norm(ways - point, axis=2)
        assert np.allclose(np.sqrt(way[i]), distance.min(0), atol=1e-3)
        assert np.allclose(np.sqrt(start[i]), distance[0], atol=1e-3)
        assert np.allclose(np.sqrt(end[i]), distance[-1], atol=1e-3)


def test_a_first_gait_counts_only_if_a_whole_sequence_is_free():
    tree = MotionTree(samples.surrogate().planar(), 2)
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


@pytest.mark.parametrize("seed", range(20))
def test_at_least_one_gait_is_always_allowed_and_never_a_hit_if_one_misses(seed):
    generator = np.random.default_rng(seed)
    surrogate = samples.surrogate()
    shield = Shield(Stubborn(0, 0, 0), surrogate, NAVIGATION)
    points = generator.uniform(-2, 2, (generator.integers(1, 40), 2))
    safe = shield.safe(points)
    assert safe.any()
    touches = (shield.tree.distances2(points)[2][:, :3] < surrogate.radius**2).any(0)
    if not touches.all():
        assert not (safe & touches).any()


def test_the_shield_keeps_a_blind_planner_from_colliding():
    batch = SceneBatch.of(novel_scenes(NAVIGATION, 30, 0))
    bearing = np.arctan2(batch.targets[:, 1], batch.targets[:, 0])
    scenes = replace(batch, orientations=level_attitude(bearing))
    rates = {}
    for shielded in (False, True):
        pilot = Stubborn(3, 1, 2)
        if shielded:
            pilot = Shield(pilot, samples.surrogate(), NAVIGATION)

        def act(laser, target, robots, pilot=pilot):
            return np.array([pilot.values({"laser": one}).argmax() for one in laser])

        runs = run_on_surrogate(samples.surrogate(), NAVIGATION, scenes, act)
        rates[shielded] = runs.rate(COLLISION)
    assert rates[False] > 0.8 and rates[True] <= 0.05


def test_a_new_episode_resets_the_wrapped_planner():
    pilot = Stubborn(0, 0, 0)
    Shield(pilot, samples.surrogate(), NAVIGATION).reset()
    assert pilot.resets == 1
