"""Obstacles that are followed from scan to scan: their velocities against the true ones."""

from dataclasses import replace

import numpy as np
import pytest

from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import novel_scenes
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.planning.tracking import Tracker
from defplan_mj.task import Navigation
from tests.samples import planning as samples

NAVIGATION = Navigation()
SPATIAL = Navigation(space="spatial", beams=128, k2=30)


def follow(surrogate, navigation, batch, gaits, noise=0.0):
    """Drive one robot a scene; return (steps, n) what its tracker sees, and the true drifts of the points."""
    env = SurrogateEnv(
        surrogate, navigation, batch, generator=np.random.default_rng(0), noise=noise
    )
    trackers = [Tracker(surrogate, navigation) for _ in range(env.n)]
    told, true, sight = [], [], env.observe()
    for gait in gaits:
        told.append(
            [
                t.update(sight.laser[i], sight.target[i].astype(float))
                for i, t in enumerate(trackers)
            ]
        )
        true.append(sight.drift)
        for tracker in trackers:
            tracker.chose(int(gait))
        sight = env.step(np.full(env.n, gait)).sight
    return told, true, trackers


def test_a_cylinder_s_place_size_and_velocity_are_found_in_two_looks():
    surrogate = samples.surrogate(scatter=0.002)
    scene = samples.scene([(6.0, 1.0, 1.3)], target=(20.0, 0.0), velocities=[(-0.5, 0.3)])
    told, _, (tracker,) = follow(surrogate, NAVIGATION, samples.batch(scene), [0, 1, 0])
    assert not told[0][0].drift.any()  # one look tells no velocity
    assert np.allclose(
        np.linalg.norm(told[1][0].drift, axis=1), 0.44 * np.hypot(0.5, 0.3), atol=0.03
    )
    balls = tracker.balls()
    assert len(balls.radii) == 1 and balls.radii[0] == pytest.approx(1.3, abs=0.03)


def test_what_stands_still_has_no_velocity_though_the_robot_moves_and_turns():
    surrogate = samples.surrogate(scatter=0.01)
    batch = SceneBatch.of(novel_scenes(NAVIGATION, 8, 3))
    told, _, _ = follow(surrogate, NAVIGATION, batch, [0, 1, 1, 0, 2, 0, 0], noise=1.0)
    speeds = [np.linalg.norm(seen.drift, axis=1) for row in told for seen in row]
    assert np.mean(np.concatenate(speeds) > 0.1) < 0.06


def test_most_of_what_moves_in_a_crowd_is_followed():
    surrogate = samples.surrogate(scatter=0.005)
    batch = SceneBatch.of(novel_scenes(NAVIGATION, 6, 5, obstacle_speed=1.0))
    told, true, _ = follow(surrogate, NAVIGATION, batch, [0, 1, 0, 0, 2, 0, 0, 0])
    wrong = []
    for seen, drifts in zip(told[1:], true[1:], strict=True):
        for one, drift in zip(seen, drifts, strict=True):
            moves = np.linalg.norm(drift, axis=1) > 0
            wrong += list(np.linalg.norm(one.drift_of_all - drift, axis=1)[moves] > 0.1)
    assert len(wrong) > 200 and np.mean(wrong) < 0.3


def test_a_sphere_that_is_near_is_followed_in_space():
    surrogate = samples.swimmer(scatter=0.002)
    scene = samples.spheres([(2.5, 0, 1.0, 1.2)], target=(15.0, 0, 0))
    scene = replace(scene, velocities=np.array([[0.0, 0.4, 0.3]]))
    told, true, _ = follow(surrogate, SPATIAL, samples.batch(scene), [4, 0, 4, 4])
    there = np.linalg.norm(true[-1][0], axis=1) > 0
    assert there.sum() >= 5
    assert np.allclose(told[-1][0].drift_of_all[there], true[-1][0][there], atol=0.04)


def test_a_ball_out_of_sight_is_remembered_a_while_and_a_reset_forgets_it():
    tracker = Tracker(samples.surrogate(scatter=0.002), NAVIGATION)
    seen, nothing = np.full(64, 10.0), np.full(64, 10.0)
    seen[:3] = [4.0, 4.1, 4.3]
    tracker.update(seen, np.array([15.0, 0.0]))
    assert len(tracker.balls().radii) == 1
    for _ in range(3):
        tracker.update(nothing, np.array([15.0, 0.0]))
    assert len(tracker.balls().radii) == 0 or tracker.unseen[0] <= 8
    tracker.reset()
    assert len(tracker.balls().radii) == 0


def test_most_of_a_wall_of_posts_along_which_the_robot_swims_stands_still():
    posts = [(x, y, 0.4) for x in np.arange(-6, 14, 0.75) for y in (-1.9, 1.9)]
    batch = samples.batch(samples.scene(posts, target=(20.0, 0.0)))
    told, _, _ = follow(samples.surrogate(scatter=0.005), NAVIGATION, batch, [0] * 10, noise=1.0)
    speeds = np.concatenate([np.linalg.norm(row[0].drift, axis=1) for row in told])
    assert (
        len(speeds) > 400 and np.mean(speeds > 0.1) < 0.15
    )  # 0.39 if each post is a ball of its own
